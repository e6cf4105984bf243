# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress a target in copies of what its source wears: read, fit, write."""
