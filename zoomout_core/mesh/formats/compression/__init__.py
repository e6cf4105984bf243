# SPDX-License-Identifier: GPL-3.0-or-later
"""Compressed glTF buffers: Draco and meshopt."""
