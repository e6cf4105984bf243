# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks of bones and teeth on other specimens, and damaged specimens."""
