"""Options: each is defined once, and is a setting of the scene as well as a property of the operators.

Property annotations are read by Blender as they are, so this module does without postponed evaluation.
"""

import math
from typing import Any

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty
from bpy.types import Object, Operator, PropertyGroup

from zoomout_core.correspondence.proximity import MOST_ANGLE, MOST_DISTANCE

from .cargo import FILL_BELOW, Settings, parse_group_names, parse_names

# An operator's own options hold for one call only; what is left open comes from the scene.
ONCE = {"SKIP_SAVE"}
# Options that say which evidence an automatic start weighs.
EVIDENCE = ("names", "same_up", "from_last")
# Options that say which nearest points are a match.
NEARNESS = ("most_distance", "most_angle", "either_side")


class MatchOptions:
    """How to match."""

    initial: EnumProperty(
        name="Start",
        description="What the match starts from",
        items=(
            ("AUTO", "Automatic", "The shapes alone: poses and placements may differ"),
            ("PROXIMITY", "Nearest Points", "The nearest points in space: for meshes that lie over each other"),
            (
                "NEAREST",
                "Clothes on a Body",
                "The nearest points are the match, as far as they are near and face the same way, "
                "and what has none is filled in: for clothes, in the pose of the body that they are on",
            ),
        ),
        default="AUTO",
        options=ONCE,
    )
    k_final: IntProperty(
        name="Detail",
        description=(
            "How many eigenfunctions of each shape the match is refined to: more follow smaller features, "
            "and take longer"
        ),
        default=120,
        min=20,
        soft_max=300,
        max=1000,
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
        chosen = {name: getattr(self, name) for name in ("k_final", *EVIDENCE)}
        return {"initial": self.initial.lower(), **chosen}


def option_label(name: str) -> str:
    """What an argument of `match_objects` is called in the interface, or its name if it is not there."""
    option = MatchOptions.__annotations__.get(name)
    return option.keywords["name"] if option else name


class TransferOptions:
    """What to transfer."""

    uv_maps: BoolProperty(
        name="UV Maps",
        description="Transfer all UV maps; seams stay where the source has them",
        default=True,
        options=ONCE,
    )
    vertex_groups: BoolProperty(
        name="Vertex Groups",
        description=(
            "Transfer all vertex groups; groups that deform keep their sum, "
            "and locked groups of the target are left alone"
        ),
        default=True,
        options=ONCE,
    )
    shape_keys: BoolProperty(
        name="Shape Keys",
        description=(
            "Transfer all shape keys with their settings and drivers; they turn and grow with the target, "
            "and keys of the same name are overwritten"
        ),
        default=True,
        options=ONCE,
    )
    color_attributes: BoolProperty(
        name="Color Attributes",
        description="Transfer all colour attributes, mixed as scene-linear colours",
        default=True,
        options=ONCE,
    )
    attributes: BoolProperty(
        name="Attributes",
        description="Transfer the other attributes; vectors arrive as they are, unless they are said to turn",
        default=True,
        options=ONCE,
    )
    materials: BoolProperty(
        name="Materials",
        description="Give each face the material of the source; slots that the target lacks are appended",
        default=True,
        options=ONCE,
    )

    edges: BoolProperty(
        name="Seams & Sharps",
        description=(
            "Trace seams, sharp edges, creases, bevel weights and Freestyle edges as lines along the target's edges, "
            "and creases and bevel weights of vertices. Of each kind that the source has, the target's own are replaced"
        ),
        default=True,
        options=ONCE,
    )
    custom_normals: BoolProperty(
        name="Custom Normals",
        description=(
            "Transfer the normals of face corners where the source has custom ones, turned with the surface. "
            "Blender marks edges as sharp where they jump"
        ),
        default=True,
        options=ONCE,
    )

    shape: BoolProperty(
        name="Shape as Key",
        description="Add a shape key, with the name of the source, that gives the target the source's shape",
        default=False,
        options=ONCE,
    )

    def data(self) -> list[str]:
        """Names of the kinds of data that are chosen."""
        return [name for name in TransferOptions.__annotations__ if getattr(self, name)]


class BlendOptions:
    """How to transfer."""

    fill_below: FloatProperty(
        name="Fill Below",
        description=(
            "Weights, colours and numbers at vertices of less confidence than this are filled in from around them; "
            "at 0 all are taken as they are mapped"
        ),
        default=FILL_BELOW,
        min=0,
        max=1,
        subtype="FACTOR",
        options=ONCE,
    )
    mode: EnumProperty(
        name="Where",
        description="Where the target receives what it may have already",
        items=(
            ("MIX", "Everywhere", "Replace what the target has, as far as factor and mask say"),
            (
                "MISSING",
                "Only Missing",
                "Keep what the target has: add weights to vertices that have none, and other data where it is zero",
            ),
        ),
        default="MIX",
        options=ONCE,
    )
    factor: FloatProperty(
        name="Factor",
        description=(
            "How much is taken of what is transferred, the rest being what the target has; of labels and UVs, "
            "which cannot be mixed, all above one half"
        ),
        default=1,
        min=0,
        max=1,
        subtype="FACTOR",
        options=ONCE,
    )
    mask_group: StringProperty(
        name="Mask",
        description="A vertex group of the target, by which the factor is multiplied",
        options=ONCE,
    )
    limit: IntProperty(
        name="Limit Weights",
        description=(
            "How many weights of groups that deform a vertex may have, of which the largest are kept; "
            "at 0 as many as on the source"
        ),
        default=0,
        min=0,
        soft_max=8,
        options=ONCE,
    )
    flip_names: BoolProperty(
        name="Flip Group Names",
        description="Vertex groups change sides, as from Arm.L to Arm.R: for a match of left with right",
        default=False,
        options=ONCE,
    )
    group_names: StringProperty(
        name="Rename Groups",
        description="New names of vertex groups on the target: old = new, old = new",
        options=ONCE,
    )

    turning: StringProperty(
        name="Turning",
        description=(
            "Names, between commas, of attributes that turn with the surface: "
            "directions and rotations, in the mesh's own space"
        ),
        options=ONCE,
    )

    def settings(self) -> Settings:
        """What is chosen here.

        Raises:
            MeshError: new names of groups are not given as pairs.
        """
        chosen = {name: getattr(self, name) for name in BlendOptions.__annotations__}
        names, turning = parse_group_names(self.group_names), parse_names(self.turning)
        return Settings(**{**chosen, "mode": self.mode.lower(), "group_names": names, "turning": turning})


class SourceName:
    """Which object an operator takes as the source."""

    source: StringProperty(
        name="Source",
        description=(
            "Name of the object that has the data; if empty, the one chosen in the sidebar, "
            "else the mesh that is selected besides the active one"
        ),
        options=ONCE,
    )


def _may_be_source(settings: PropertyGroup, obj: Object) -> bool:
    return obj.type == "MESH"


class ZOOMOUT_PG_settings(MatchOptions, TransferOptions, BlendOptions, PropertyGroup):
    """The scene's settings."""

    source: PointerProperty(
        name="Source",
        description=(
            "The mesh that has the data; the active mesh receives it. "
            "If none is chosen, the mesh that is selected besides the active one"
        ),
        type=Object,
        poll=_may_be_source,
    )


def take_settings(operator: Operator, settings: ZOOMOUT_PG_settings) -> None:
    """Give an operator the scene's settings for all options that its caller left open."""
    for options in (MatchOptions, TransferOptions, BlendOptions):
        for name in options.__annotations__ if isinstance(operator, options) else ():
            if not operator.properties.is_property_set(name):
                setattr(operator, name, getattr(settings, name))
