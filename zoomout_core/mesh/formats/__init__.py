# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh files: readers and writers of each format."""
