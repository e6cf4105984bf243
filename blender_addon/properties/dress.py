# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of dressing.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from typing import Any

from bpy.props import BoolProperty, EnumProperty, FloatProperty, PointerProperty, StringProperty
from bpy.types import Collection, Context

from ..mesh_data import groups_to_keep
from .once import ONCE


def _search_groups(_: Any, context: Context, _text: str) -> list[str]:
    """Names of vertex groups of the objects to fit."""
    chosen = context.scene.zoomout.dress_collection
    return groups_to_keep(context.selected_objects if chosen is None else chosen.all_objects)


class DressOptions:
    """How to dress the target."""

    dress_manner: EnumProperty(
        name="Parts",
        description="How the parts of the objects follow the body",
        items=(
            (
                "AUTOMATIC",
                "Automatic",
                "Keep small solid parts, such as eyes, teeth and buttons, and objects parented to a bone rigid; "
                "treat objects named like hair as hair; deform everything else with the body",
            ),
            ("SOFT", "Soft", "Deform everything with the body"),
            ("RIGID", "Rigid", "Rotate and scale each object as a whole"),
            ("HAIR", "Hair", "Deform the objects with the body near its skin only; farther away, they move as a whole"),
        ),
        default="AUTOMATIC",
        options=ONCE,
    )
    dress_stiffness: FloatProperty(
        name="Stiffness",
        description="How rigidly soft parts follow the body, from cloth that follows each detail to armor",
        default=0.5,
        min=0,
        max=1,
        subtype="FACTOR",
        options=ONCE,
    )
    dress_gap: FloatProperty(
        name="Minimum Gap",
        description="Minimum distance from the skin, for parts that were outside it",
        default=0,
        min=0,
        subtype="DISTANCE",
        options=ONCE,
    )
    dress_keep: StringProperty(
        name="Keep Form",
        description=(
            "Vertex group of the objects, such as of buckles, plates and soles. Each of its connected patches moves "
            "and scales as a whole; weights below 1 blend with the cloth"
        ),
        search=_search_groups,
        options=ONCE,
    )
    dress_follow_keys: BoolProperty(
        name="Follow Body Keys",
        description=(
            "Add a shape key to each copy for each shape key of the target that moves it. Drivers give it the value of "
            "the target's key"
        ),
        default=True,
        options=ONCE,
    )

    def dress_options(self) -> dict[str, Any]:
        """Arguments of `Dressing`."""
        chosen = {name.removeprefix("dress_"): getattr(self, name) for name in DressOptions.__annotations__}
        return {**chosen, "manner": chosen["manner"].lower()}


class DressCollection:
    """The collection of worn objects."""

    dress_collection: PointerProperty(
        name="Collection",
        description=(
            "Collection of the objects that the source wears; if none is chosen, all objects selected besides the "
            "source and the target"
        ),
        type=Collection,
    )
