# SPDX-License-Identifier: GPL-3.0-or-later
"""Prepare a surface for a match: proxy, basis, samples and features, which are cached in memory and on disk."""
