# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of a wrap.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from typing import Any

from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty

from .once import ONCE


class WrapOptions:
    """How to wrap one mesh onto the other."""

    wrap_result: EnumProperty(
        name="Result",
        description="Where to store the new shape",
        items=(
            ("SHAPE_KEY", "Shape Key", "Add a shape key named after the mesh with that shape, and show it"),
            (
                "MESH",
                "Mesh",
                "Move the vertices of the mesh itself, together with its shape keys; the match is kept",
            ),
            ("OBJECT", "New Object", "Create a copy of the mesh at the position of the one with that shape"),
        ),
        default="SHAPE_KEY",
        options=ONCE,
    )
    wrap_reverse: BoolProperty(
        name="Reverse",
        description="Deform the source to the shape of the target instead",
        default=False,
        options=ONCE,
    )
    wrap_smoothness: FloatProperty(
        name="Smoothness",
        description=(
            "How evenly edges flow: at 0 vertices stay close to their matched positions, at 1 faces keep their shape "
            "as far as possible"
        ),
        default=0.5,
        min=0,
        max=1,
        subtype="FACTOR",
        options=ONCE,
    )
    wrap_detail: FloatProperty(
        name="Detail",
        description=(
            "How closely to follow the detail of the shape: 0 follows only its coarse form and keeps the detail of "
            "the mesh, 1 follows its surface exactly"
        ),
        default=1,
        min=0,
        max=1,
        subtype="FACTOR",
        options=ONCE,
    )
    wrap_mask: StringProperty(
        name="Mask",
        description="Vertex group of the wrapped mesh; vertices outside it keep their shape and follow smoothly",
        options=ONCE,
    )
    wrap_landmarks: BoolProperty(
        name="Fit Landmarks",
        description="Make the landmarks of both meshes coincide exactly",
        default=True,
        options=ONCE,
    )
    wrap_subdivided: BoolProperty(
        name="Fit Subdivision",
        description=(
            "If the last modifier is Subdivision Surface, fit its smooth surface to the shape instead of the mesh "
            "itself"
        ),
        default=True,
        options=ONCE,
    )

    def wrap_options(self) -> dict[str, Any]:
        """Arguments of `wrap`."""
        chosen = {name.removeprefix("wrap_"): getattr(self, name) for name in WrapOptions.__annotations__}
        return {**chosen, "result": chosen["result"].lower()}
