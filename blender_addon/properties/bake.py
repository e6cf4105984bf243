# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of baking textures.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from typing import Any

from bpy.props import BoolProperty, IntProperty, StringProperty

from .once import ONCE


class BakeOptions:
    """How textures are baked."""

    bake_size: IntProperty(
        name="Image Size",
        description="Width and height of the new images, and of each UDIM tile, in pixels",
        default=2048,
        min=4,
        max=16384,
        options=ONCE,
    )
    bake_uv_map: StringProperty(
        name="UV Map",
        description="UV map of the target to bake to; if empty, the active one",
        options=ONCE,
    )
    bake_relief: BoolProperty(
        name="Include Relief",
        description=(
            "Let normal maps show relief of the source's mesh that the target's lacks. Use it for the same shape with "
            "fewer vertices, not for another body"
        ),
        default=False,
        options=ONCE,
    )
    bake_save: BoolProperty(
        name="Save Images",
        description="Save the images beside the .blend file, in the folder textures, instead of packing them",
        default=False,
        options=ONCE,
    )

    def bake_options(self) -> dict[str, Any]:
        """Arguments of `Baking`."""
        return {name.removeprefix("bake_"): getattr(self, name) for name in BakeOptions.__annotations__}
