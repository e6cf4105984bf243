# SPDX-License-Identifier: GPL-3.0-or-later
"""How long matches take: by stage, by size, in Blender, and beside other programs."""
