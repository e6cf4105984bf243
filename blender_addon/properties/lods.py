# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of levels of detail.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from typing import Any

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty

from .once import ONCE


class LevelOptions:
    """Which levels of detail are made."""

    lod_source: EnumProperty(
        name="Made From",
        description="Where the levels come from",
        items=(
            ("RATIOS", "Ratios", "Simplify the mesh to shares of its vertices"),
            (
                "SELECTED",
                "Selected Meshes",
                "Use the other selected meshes, which you made by hand in the place and rest pose of the active one, "
                "and give them its data",
            ),
        ),
        default="RATIOS",
        options=ONCE,
    )
    lod_count: IntProperty(
        name="Levels",
        description="Number of levels to make besides the mesh itself",
        default=3,
        min=1,
        max=8,
        options=ONCE,
    )
    lod_ratio: FloatProperty(
        name="Ratio",
        description="Share of the vertices of each level that the next one keeps",
        default=0.5,
        min=0.05,
        max=0.95,
        subtype="FACTOR",
        options=ONCE,
    )
    lod_keep_uv: BoolProperty(
        name="Keep UV Maps",
        description="Selected meshes keep their own UV maps if they have any; otherwise they receive those of the mesh",
        default=False,
        options=ONCE,
    )
    lod_max_weights: IntProperty(
        name="Bone Limit",
        description="Maximum number of bones that move a vertex of the levels; 0 for as many as in the mesh itself",
        default=4,
        min=0,
        max=64,
        options=ONCE,
    )

    def level_choice(self) -> dict[str, Any]:
        """Arguments of `LevelChoice`."""
        ratios = tuple(self.lod_ratio**number for number in range(1, self.lod_count + 1))
        return {"ratios": ratios, "max_weights": self.lod_max_weights, "keep_uv": self.lod_keep_uv}
