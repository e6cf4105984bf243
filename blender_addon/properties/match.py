"""Options of a match.

Property annotations are read by Blender as they are, so this module does without postponed evaluation.
"""

import math
from typing import Any

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from zoomout_core.matching.proximity import MOST_ANGLE, MOST_DISTANCE

from ..translations import CONTEXT
from .once import ONCE

# Options that say which constraints an automatic start weighs.
CONSTRAINTS = ("use_landmarks", "names", "same_up", "from_last")
# What other starts have in place of constraints.
OF_START = {"LANDMARKS": (), "SAME_ORDER": (), "FILE": ("map_file",)}
# The presets of the core's `DETAIL` that suit a panel, and what they are for.
OFFERED_DETAIL = {
    "fast": "A quick look: for coarse meshes, and to try options",
    "balanced": "As fine as most characters need",
    "fine": "Follows fingers and wrinkles more closely, and takes some times as long",
}
# Options that say which nearest points are a match.
NEARNESS = ("most_distance", "most_angle", "either_side")


class MatchOptions:
    """How to match."""

    initial: EnumProperty(
        name="Method",
        description="How the match is found",
        items=(
            ("AUTO", "Automatic", "The shapes alone: poses and placements may differ"),
            ("LANDMARKS", "Landmarks", "The landmarks of both objects: where the shapes alone lead astray"),
            ("PROXIMITY", "Nearest Points", "The nearest points in space: for meshes that lie over each other"),
            (
                "NEAREST",
                "Clothes on a Body",
                "The nearest points are the match, as far as they are near and face the same way, "
                "and what has none is filled in: for clothes, in the pose of the body that they are on",
            ),
            (
                "SAME_ORDER",
                "Same Order",
                "The vertices are the same ones in the same order, as where one mesh is a sculpted copy of the other",
            ),
            ("FILE", "From File", "A map that the command `zoomout match` wrote for these two meshes"),
        ),
        default="AUTO",
        options=ONCE,
    )
    detail: EnumProperty(
        name="Detail",
        description="How small the features are that the match follows, and how long it takes",
        items=tuple((name.upper(), name.title(), what) for name, what in OFFERED_DETAIL.items()),
        default="BALANCED",
        translation_context=CONTEXT,
        options=ONCE,
    )
    k_final: IntProperty(
        name="Eigenfunctions",
        description=(
            "How many eigenfunctions of each shape the match is refined to: more follow smaller features, "
            "and take longer; at 0 as many as the detail says"
        ),
        default=0,
        min=0,
        soft_max=300,
        max=1000,
        options=ONCE,
    )
    map_file: StringProperty(
        name="Map",
        description="The map.npz to start from",
        subtype="FILE_PATH",
        options=ONCE,
    )
    exact_landmarks: BoolProperty(
        name="Hit Exactly",
        description="Bend the match so that each landmark lands on its partner; else landmarks draw it near",
        default=False,
        options=ONCE,
    )
    use_landmarks: BoolProperty(
        name="Landmarks",
        description="Landmarks on both objects lie at corresponding places; a single one tells the sides apart",
        default=True,
        options=ONCE,
    )
    names: BoolProperty(
        name="Names",
        description=(
            "Vertex groups, and materials, of the same name lie at corresponding places. "
            "Turn this off where names mean something else on either mesh"
        ),
        default=True,
        options=ONCE,
    )
    same_up: BoolProperty(
        name="Same Up Axis",
        description="Both objects stand upright in the scene, along its Z axis",
        default=False,
        options=ONCE,
    )
    from_last: BoolProperty(
        name="Last Match",
        description="The match of these two that was made before is about right: after a small change of options",
        default=False,
        options=ONCE,
    )

    most_distance: FloatProperty(
        name="Distance",
        description=(
            "How far the nearest point of a body may be, over the square root of the body's area, "
            "which is about 1.4 m for a human"
        ),
        default=MOST_DISTANCE,
        min=1e-3,
        soft_max=0.5,
        options=ONCE,
    )
    most_angle: FloatProperty(
        name="Angle",
        description="By how much the directions that clothes and body face may differ",
        default=math.radians(MOST_ANGLE),
        min=0,
        max=math.pi,
        subtype="ANGLE",
        options=ONCE,
    )
    either_side: BoolProperty(
        name="Either Side",
        description="Clothes and body may also face each other: for clothes that have an inner side of their own",
        default=False,
        options=ONCE,
    )

    def match_options(self) -> dict[str, Any]:
        """The arguments of `operators.match.match_objects` that are chosen here."""
        if self.initial == "NEAREST":
            return {
                "initial": "nearest",
                "most_distance": self.most_distance,
                "most_angle": round(
                    math.degrees(self.most_angle), 3
                ),  # a half turn in single precision is more than one
                "either_side": self.either_side,
            }
        others = OF_START.get(self.initial, CONSTRAINTS)
        chosen = {name: getattr(self, name) for name in ("k_final", "exact_landmarks", *others)}
        return {"initial": self.initial.lower(), "detail": self.detail.lower(), **chosen}


class RedoOptions:
    """Where a target that was matched is matched again."""

    redo_group: StringProperty(
        name="Redo Only",
        description=(
            "Vertex group of the target where matching again replaces the match, which stays elsewhere, with a smooth "
            "transition; if empty, all of it is replaced"
        ),
        options=ONCE,
    )
    redo_keeps: BoolProperty(
        name="Keep",
        description="The vertex group says what is kept, and all else is matched again",
        default=False,
        options=ONCE,
    )

    def redo_options(self) -> dict[str, Any]:
        """The arguments of `match_objects` that are chosen here."""
        return {"redo_group": self.redo_group, "redo_keeps": self.redo_keeps}


def option_label(name: str) -> str:
    """What an argument of `match_objects` is called in the interface, or its name if it is not there."""
    option = MatchOptions.__annotations__.get(name)
    return option.keywords["name"] if option else name
