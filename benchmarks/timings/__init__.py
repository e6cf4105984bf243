# SPDX-License-Identifier: GPL-3.0-or-later
"""Duration of matches: by stage, by size, in Blender, and beside other programs."""
