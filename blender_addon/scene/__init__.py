# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects of the scene: which are meant, reading them, recognising edits, and what was cached of their meshes."""
