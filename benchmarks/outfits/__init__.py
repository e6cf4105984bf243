# SPDX-License-Identifier: GPL-3.0-or-later
"""Outfits moved to other bodies."""
