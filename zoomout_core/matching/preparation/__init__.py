# SPDX-License-Identifier: GPL-3.0-or-later
"""From a surface to what a match computes on: proxy, basis, samples, features; kept in memory and on disk."""
