# SPDX-License-Identifier: GPL-3.0-or-later
"""Outfits of avatar files, fitted to other avatars."""
