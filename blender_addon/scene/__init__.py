# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects of the scene: choosing and reading them, detecting edits, and cached facts about their meshes."""
