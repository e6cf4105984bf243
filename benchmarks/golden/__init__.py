# SPDX-License-Identifier: GPL-3.0-or-later
"""Hashes of maps, to find where a change of the code changes them."""
