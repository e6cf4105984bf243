"""Options of what is done along a mesh's own symmetry.

Property annotations are read by Blender as they are, so this module does without postponed evaluation.
"""

from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty
from bpy.types import PropertyGroup

from zoomout_core.symmetry.offsets import BLEND

from ..colors import RED_LENGTH, RED_WEIGHT
from .once import ONCE

# Directions in the object's own space, by the names that they have in the interface.
AXES = {
    "X": (1, 0, 0),
    "-X": (-1, 0, 0),
    "Y": (0, 1, 0),
    "-Y": (0, -1, 0),
    "Z": (0, 0, 1),
    "-Z": (0, 0, -1),
}


class DetectOptions:
    """How to find symmetries."""

    left: EnumProperty(
        name="Left Is",
        description=(
            "The axis of the object that points to the character's own left: it tells the two sides apart. "
            "A character that faces you in the front view has its left on the right, at +X"
        ),
        items=tuple((name, name, f"The object's own {name} axis") for name in AXES),
        default="X",
        options=ONCE,
    )


class DirectionOptions:
    """Which side is copied."""

    direction: EnumProperty(
        name="Copy",
        description="Which side gives what it has to the other one",
        items=(
            ("LEFT_TO_RIGHT", "Left to Right", "The right side becomes like the left one"),
            ("RIGHT_TO_LEFT", "Right to Left", "The left side becomes like the right one"),
            ("EXCHANGE", "Exchange", "Each side becomes what the other one was"),
            (
                "AVERAGE",
                "Average",
                "Both sides get the mean of the two; of selections, seams and sharp edges, what either side has",
            ),
        ),
        default="LEFT_TO_RIGHT",
        options=ONCE,
    )


class WeightOptions:
    """Which weights are made symmetric."""

    only_active: BoolProperty(
        name="Active Group Only",
        description="Only the active vertex group and its partner on the other side, as Arm.L and Arm.R",
        default=False,
        options=ONCE,
    )


class KeyOptions:
    """What is done with a shape key."""

    key_mode: EnumProperty(
        name="Make",
        description="What is made of a shape key",
        items=(
            (
                "MIRROR",
                "Other Side's Key",
                "The key of the other side, as Smile.R from Smile.L; made anew, or overwritten if it is there. "
                "Exchange makes each of the two from the other one",
            ),
            ("SPLIT", "Left and Right Keys", "Two keys, as Smile.L and Smile.R, which together are the whole"),
            (
                "SYMMETRISE",
                "Symmetric Key",
                "The key itself, the same on both sides, or with its sides exchanged",
            ),
        ),
        default="MIRROR",
        options=ONCE,
    )
    blend: FloatProperty(
        name="Blend",
        description=(
            "How far from the symmetry line a left key goes over into the right one when a key is split, over the "
            "square root of the surface's area, which is about 1.4 m for a human"
        ),
        default=BLEND,
        min=0,
        soft_max=0.5,
        options=ONCE,
    )


# The options of `LayerOptions` that are kinds of data, in the panel's order.
KINDS_OF_DATA = ("uv_maps", "color_attributes", "attributes", "materials", "edges", "masks", "selection")


class LayerOptions:
    """Which data is made symmetric."""

    uv_maps: BoolProperty(name="UV Maps", description="All UV maps", default=True, options=ONCE)
    color_attributes: BoolProperty(
        name="Color Attributes", description="All color attributes", default=True, options=ONCE
    )
    attributes: BoolProperty(
        name="Attributes", description="All other attributes that hold values", default=True, options=ONCE
    )
    materials: BoolProperty(
        name="Materials",
        description="Which face has which material; Boot.L and Boot.R change places, where there are both",
        default=True,
        options=ONCE,
    )
    edges: BoolProperty(
        name="Seams & Edge Marks",
        description="Seams, sharp edges, creases and bevel weights, drawn anew along the edges of the other side",
        default=True,
        options=ONCE,
    )
    masks: BoolProperty(
        name="Sculpt Masks", description="The mask and the face sets of sculpting", default=False, options=ONCE
    )
    selection: BoolProperty(
        name="Selection",
        description="Which vertices, edges and faces are selected in Edit Mode",
        default=False,
        options=ONCE,
    )
    uv_layout: EnumProperty(
        name="UV Layout",
        description="Where the side that receives UVs has them in the atlas",
        items=(
            ("OWN", "In Place", "Where its faces were before: each island is turned, scaled and mirrored to fit there"),
            ("OVER", "Overlapping", "Over those of the other side, so that both share their texels"),
        ),
        default="OWN",
        options=ONCE,
    )

    def data(self) -> list[str]:
        """Names of the kinds of data that are chosen."""
        return [name for name in KINDS_OF_DATA if getattr(self, name)]


class CheckOptions:
    """What is compared with its other side."""

    check: EnumProperty(
        name="Check",
        description="What is compared with its other side",
        items=(
            ("SHAPE", "Shape", "How far the surface stands off its other side's, whatever the pose"),
            ("WEIGHTS", "Weights", "Which part of a vertex's weights lies in other groups than on the other side"),
            ("KEY", "Active Shape Key", "How far it moves vertices otherwise than its partner, or itself, over there"),
        ),
        default="SHAPE",
        options=ONCE,
    )
    red_length: FloatProperty(
        name="Red At",
        description=(
            "The distance between the sides that red stands for, over the square root of the surface's area; it stays "
            "from one check to the next"
        ),
        default=RED_LENGTH,
        min=1e-5,
        soft_max=0.2,
        precision=3,
        options=ONCE,
    )
    red_weight: FloatProperty(
        name="Red At",
        description="The part of a vertex's weights that red stands for; it stays from one check to the next",
        default=RED_WEIGHT,
        min=1e-3,
        max=1,
        subtype="FACTOR",
        options=ONCE,
    )


class SideOptions:
    """What belongs to the middle."""

    middle_width: FloatProperty(
        name="Middle",
        description=(
            "How far from the symmetry line vertices belong to the middle, over the square root of the surface's area"
        ),
        default=0.01,
        min=0,
        soft_max=0.2,
        options=ONCE,
    )


class KeyName:
    """Which shape key an operator takes."""

    key: StringProperty(name="Shape Key", description="Name of the key; if empty, the active one", options=ONCE)


class ZOOMOUT_PG_symmetry(
    DetectOptions, DirectionOptions, WeightOptions, KeyOptions, LayerOptions, CheckOptions, SideOptions, PropertyGroup
):
    """The scene's settings of what is done along a symmetry."""
