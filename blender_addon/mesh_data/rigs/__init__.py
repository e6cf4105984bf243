# SPDX-License-Identifier: GPL-3.0-or-later
"""Armatures: their bones, poses and animation, and copies of them."""
