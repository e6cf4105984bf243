# SPDX-License-Identifier: GPL-3.0-or-later
"""Bind a target to the armature of its source: check, read, bind, write."""
