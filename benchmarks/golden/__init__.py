# SPDX-License-Identifier: GPL-3.0-or-later
"""Hashes of results, which show whether a change to the code alters any of them."""
