"""Options of dressing.

Property annotations are read by Blender as they are, so this module does without postponed evaluation.
"""

from typing import Any

from bpy.props import EnumProperty, FloatProperty, PointerProperty
from bpy.types import Collection

from .once import ONCE


class DressOptions:
    """How what belongs to the source is carried onto the target."""

    dress_manner: EnumProperty(
        name="Parts",
        description="What keeps its form, and what follows the body",
        items=(
            (
                "AUTOMATIC",
                "Automatic",
                "Small solid parts, such as eyes, teeth and buttons, and what hangs from a bone turn and grow as a "
                "whole; all else follows the body",
            ),
            ("SOFT", "Soft", "All follows the body"),
            ("RIGID", "Rigid", "Each object turns and grows as a whole"),
        ),
        default="AUTOMATIC",
        options=ONCE,
    )
    dress_stiffness: FloatProperty(
        name="Stiffness",
        description="How far what follows the body keeps its form, from cloth that follows each detail to armor",
        default=0.5,
        min=0,
        max=1,
        subtype="FACTOR",
        options=ONCE,
    )
    dress_gap: FloatProperty(
        name="Least Gap",
        description="Distance from the skin that is kept at least, where it was outside of it",
        default=0,
        min=0,
        subtype="DISTANCE",
        options=ONCE,
    )

    def dress_options(self) -> dict[str, Any]:
        """Arguments of `Dressing`."""
        chosen = {name.removeprefix("dress_"): getattr(self, name) for name in DressOptions.__annotations__}
        return {**chosen, "manner": chosen["manner"].lower()}


class DressCollection:
    """What is carried."""

    dress_collection: PointerProperty(
        name="Collection",
        description=(
            "The collection of what the source wears; if none is chosen, all objects that are selected besides the "
            "source and the target"
        ),
        type=Collection,
    )
