# SPDX-License-Identifier: GPL-3.0-or-later
"""Bones: weights, poses and their inverses, and rigs that move into other bodies."""
