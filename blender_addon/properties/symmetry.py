# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the work along a mesh's own symmetry.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty
from bpy.types import PropertyGroup

from zoomout_core.symmetry.sides import BLEND

from ..colors import RED_LENGTH, RED_WEIGHT
from .once import ONCE

# Directions in the object's own space, by their names in the interface.
AXES = {
    "X": (1, 0, 0),
    "-X": (-1, 0, 0),
    "Y": (0, 1, 0),
    "-Y": (0, -1, 0),
    "Z": (0, 0, 1),
    "-Z": (0, 0, -1),
}
# Vertex groups of the sides, with suffixes like other groups.
LEFT_GROUP, RIGHT_GROUP, MIDDLE_GROUP = "Side.L", "Side.R", "Side Middle"


class DetectOptions:
    """How to find symmetries."""

    left: EnumProperty(
        name="Left Axis",
        description=(
            "Axis of the object that points to the character's own left, which decides which side is left. A "
            "character that faces you in the front view has its left at +X"
        ),
        items=tuple((name, name, f"The object's own {name} axis") for name in AXES),
        default="X",
        options=ONCE,
    )


class DirectionOptions:
    """Which side to copy."""

    direction: EnumProperty(
        name="Copy",
        description="Side to copy from",
        items=(
            ("LEFT_TO_RIGHT", "Left to Right", "Copy the left side to the right side"),
            ("RIGHT_TO_LEFT", "Right to Left", "Copy the right side to the left side"),
            ("EXCHANGE", "Exchange", "Exchange the two sides"),
            (
                "AVERAGE",
                "Average",
                "Set both sides to their average; selections, seams and sharp edges of either side are set on both",
            ),
        ),
        default="LEFT_TO_RIGHT",
        options=ONCE,
    )


class WeightOptions:
    """Which weights to make symmetric."""

    only_active: BoolProperty(
        name="Active Group Only",
        description="Change only the active vertex group and its partner on the other side, such as Arm.L and Arm.R",
        default=False,
        options=ONCE,
    )


class KeyOptions:
    """How to mirror a shape key."""

    key_mode: EnumProperty(
        name="Make",
        description="Shape key to create from the active one",
        items=(
            (
                "MIRROR",
                "Other Side's Key",
                "Create or overwrite the key of the other side, such as Smile.R from Smile.L. Exchange creates each "
                "of the two from the other",
            ),
            (
                "SPLIT",
                "Left and Right Keys",
                "Split the key into two, such as Smile.L and Smile.R, which add up to the original",
            ),
            (
                "SYMMETRISE",
                "Symmetric Key",
                "Make the key itself symmetric, or exchange its sides",
            ),
        ),
        default="MIRROR",
        options=ONCE,
    )
    blend: FloatProperty(
        name="Blend",
        description=(
            "Width of the blend between the left and the right key on either side of the symmetry line, relative to "
            "the square root of the surface area, which is about 1.4 m for a human"
        ),
        default=BLEND,
        min=0,
        soft_max=0.5,
        options=ONCE,
    )


# The kinds of data among `LayerOptions`, in the panel's order.
KINDS_OF_DATA = ("uv_maps", "color_attributes", "attributes", "materials", "edges", "masks", "selection")


class LayerOptions:
    """Which data to make symmetric."""

    uv_maps: BoolProperty(name="UV Maps", description="All UV maps", default=True, options=ONCE)
    color_attributes: BoolProperty(
        name="Color Attributes", description="All color attributes", default=True, options=ONCE
    )
    attributes: BoolProperty(
        name="Attributes", description="All other attributes with values", default=True, options=ONCE
    )
    materials: BoolProperty(
        name="Materials",
        description="Material of each face; Boot.L and Boot.R are exchanged if both exist",
        default=True,
        options=ONCE,
    )
    edges: BoolProperty(
        name="Seams & Edge Marks",
        description="Seams, sharp edges, creases and bevel weights, traced along the edges of the other side",
        default=True,
        options=ONCE,
    )
    masks: BoolProperty(
        name="Sculpt Masks", description="Mask and face sets of Sculpt Mode", default=False, options=ONCE
    )
    selection: BoolProperty(
        name="Selection",
        description="Which vertices, edges and faces are selected in Edit Mode",
        default=False,
        options=ONCE,
    )
    uv_layout: EnumProperty(
        name="UV Layout",
        description="Position of the mirrored UVs in the atlas",
        items=(
            (
                "OWN",
                "In Place",
                "Keep the islands of the receiving side where they are, and rotate, scale and mirror the new UVs to "
                "fit there",
            ),
            ("OVER", "Overlapping", "Place the UVs on top of those of the other side, so that both share the texture"),
        ),
        default="OWN",
        options=ONCE,
    )

    def data(self) -> list[str]:
        """Names of the chosen kinds of data."""
        return [name for name in KINDS_OF_DATA if getattr(self, name)]


class CheckOptions:
    """Which data to compare between the sides."""

    check: EnumProperty(
        name="Check",
        description="Data to compare between the two sides",
        items=(
            ("SHAPE", "Shape", "Distance between the surface and its mirror image, in any pose"),
            ("WEIGHTS", "Weights", "Share of a vertex's weights that differs from the other side"),
            (
                "KEY",
                "Active Shape Key",
                "Difference between the active shape key and its partner, or itself, on the other side",
            ),
        ),
        default="SHAPE",
        options=ONCE,
    )
    red_length: FloatProperty(
        name="Red Threshold",
        description=(
            "Distance between the sides that is shown in red, relative to the square root of the surface area. It "
            "stays the same for later checks"
        ),
        default=RED_LENGTH,
        min=1e-5,
        soft_max=0.2,
        precision=3,
        options=ONCE,
    )
    red_weight: FloatProperty(
        name="Red Threshold",
        description="Share of a vertex's weights that is shown in red. It stays the same for later checks",
        default=RED_WEIGHT,
        min=1e-3,
        max=1,
        subtype="FACTOR",
        options=ONCE,
    )


class SideOptions:
    """How to separate the sides from the middle."""

    middle_width: FloatProperty(
        name="Middle",
        description=(
            "Distance from the symmetry line up to which vertices belong to the middle, relative to the square root "
            "of the surface area"
        ),
        default=0.01,
        min=0,
        soft_max=0.2,
        options=ONCE,
    )


class KeyName:
    """Which shape key an operator takes."""

    key: StringProperty(name="Shape Key", description="Name of the shape key; if empty, the active one", options=ONCE)


class ZOOMOUT_PG_symmetry(
    DetectOptions, DirectionOptions, WeightOptions, KeyOptions, LayerOptions, CheckOptions, SideOptions, PropertyGroup
):
    """The scene's settings of transfers along a symmetry."""
