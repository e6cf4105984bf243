"""Options of a wrap.

Property annotations are read by Blender as they are, so this module does without postponed evaluation.
"""

from typing import Any

from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty

from .once import ONCE


class WrapOptions:
    """How the shape of one mesh is given to the other one's topology."""

    wrap_result: EnumProperty(
        name="Result",
        description="Where the new shape goes",
        items=(
            ("SHAPE_KEY", "Shape Key", "A shape key with the name of the mesh whose shape it is, shown at once"),
            (
                "MESH",
                "Mesh",
                "The vertices of the mesh itself are moved, and its shape keys with them; the match is kept",
            ),
            ("OBJECT", "New Object", "A copy of the mesh, placed on the one whose shape it has"),
        ),
        default="SHAPE_KEY",
        options=ONCE,
    )
    wrap_reverse: BoolProperty(
        name="Reverse",
        description="Give the source's topology the shape of the target instead",
        default=False,
        options=ONCE,
    )
    wrap_smoothness: FloatProperty(
        name="Smoothness",
        description=(
            "How evenly edges flow: at 0 vertices stay near where the match sends them, at 1 faces keep their form as "
            "far as the surface lets them"
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
            "How far the detail of the shape is followed: at 0 its coarse form alone, with the detail that the mesh "
            "has, at 1 onto its surface"
        ),
        default=1,
        min=0,
        max=1,
        subtype="FACTOR",
        options=ONCE,
    )
    wrap_mask: StringProperty(
        name="Mask",
        description=(
            "A vertex group of the mesh that is wrapped; outside of it vertices keep their form and move along smoothly"
        ),
        options=ONCE,
    )
    wrap_landmarks: BoolProperty(
        name="Hit Landmarks",
        description="Landmarks that both meshes have come to lie exactly on each other",
        default=True,
        options=ONCE,
    )
    wrap_subdivided: BoolProperty(
        name="Through Subdivision",
        description=(
            "Where a Subdivision modifier is the last one, the smooth surface that it shows comes to lie on the shape, "
            "instead of the mesh itself"
        ),
        default=True,
        options=ONCE,
    )

    def wrap_options(self) -> dict[str, Any]:
        """Arguments of `wrap`."""
        chosen = {name.removeprefix("wrap_"): getattr(self, name) for name in WrapOptions.__annotations__}
        return {**chosen, "result": chosen["result"].lower()}
