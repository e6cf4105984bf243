# SPDX-License-Identifier: GPL-3.0-or-later
"""Simplification of meshes whose corners have data, along their seams."""
