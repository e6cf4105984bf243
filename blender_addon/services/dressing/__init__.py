# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress a target in copies of the objects that its source wears: read, fit, write."""
