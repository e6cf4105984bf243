# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of a transfer.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ..adapters import FILL_BELOW, Binding, Settings, parse_group_names, parse_names
from .once import ONCE

# Options of blending, and options of groups and attributes.
BLENDING = ("fill_below", "without_partner", "mode", "factor", "mask_group")
NAMING = ("limit", "flip_names", "group_names", "turning")


class TransferOptions:
    """The kinds of data to transfer."""

    uv_maps: BoolProperty(
        name="UV Maps",
        description="Transfer all UV maps, with seams at the same places as on the source",
        default=True,
        options=ONCE,
    )
    vertex_groups: BoolProperty(
        name="Vertex Groups",
        description=(
            "Transfer all vertex groups; deform weights keep their sum, and locked groups of the target are not changed"
        ),
        default=True,
        options=ONCE,
    )
    shape_keys: BoolProperty(
        name="Shape Keys",
        description=(
            "Transfer all shape keys with their settings and drivers, rotated and scaled to fit the target; keys of "
            "the same name are overwritten"
        ),
        default=True,
        options=ONCE,
    )
    color_attributes: BoolProperty(
        name="Color Attributes",
        description="Transfer all color attributes, interpolated as scene-linear colors",
        default=True,
        options=ONCE,
    )
    attributes: BoolProperty(
        name="Attributes",
        description="Transfer all other attributes; vectors are copied unchanged unless listed under Directions",
        default=True,
        options=ONCE,
    )
    materials: BoolProperty(
        name="Materials",
        description="Assign the source's material to each face; missing material slots are added",
        default=True,
        options=ONCE,
    )

    edges: BoolProperty(
        name="Seams & Sharps",
        description=(
            "Trace seams, sharp edges, creases, bevel weights and Freestyle edges along the target's edges, and "
            "transfer creases and bevel weights of vertices. Marks of the same kind on the target are replaced"
        ),
        default=True,
        options=ONCE,
    )
    custom_normals: BoolProperty(
        name="Custom Normals",
        description=(
            "Transfer the source's custom normals, rotated with the surface. Blender marks edges with split normals "
            "as sharp"
        ),
        default=True,
        options=ONCE,
    )

    shape: BoolProperty(
        name="Source Shape Key",
        description="Add a shape key, named after the source, that deforms the target to the source's shape",
        default=False,
        options=ONCE,
    )

    def data(self) -> list[str]:
        """Names of the chosen kinds of data."""
        return [name for name in TransferOptions.__annotations__ if getattr(self, name)]


class BlendOptions:
    """How to transfer."""

    fill_below: FloatProperty(
        name="Fill Below",
        description=(
            "Fill in weights, colors and numbers from their surroundings at vertices with lower confidence than "
            "this; 0 keeps all mapped values"
        ),
        default=FILL_BELOW,
        min=0,
        max=1,
        subtype="FACTOR",
        options=ONCE,
    )
    without_partner: EnumProperty(
        name="No Partner",
        description="How to treat parts of the target without a partner on the source",
        items=(
            (
                "FILL",
                "Fill In",
                "Continue weights, colors, numbers and shape keys smoothly from the surroundings, and copy other "
                "data from the nearest point",
            ),
            ("KEEP", "Keep", "Keep the target's own data there"),
        ),
        default="FILL",
        options=ONCE,
    )
    mode: EnumProperty(
        name="Where",
        description="Which of the target's existing data to replace",
        items=(
            ("MIX", "Everywhere", "Replace the target's data, weighted by Factor and Mask"),
            (
                "MISSING",
                "Only Missing",
                "Keep the target's data: add weights only to vertices without any, and other data only where it is "
                "zero",
            ),
        ),
        default="MIX",
        options=ONCE,
    )
    factor: FloatProperty(
        name="Factor",
        description=(
            "Share of the transferred data that is mixed with the target's own data. UVs and labels cannot be mixed, "
            "and are replaced above 0.5"
        ),
        default=1,
        min=0,
        max=1,
        subtype="FACTOR",
        options=ONCE,
    )
    mask_group: StringProperty(
        name="Mask",
        description="Vertex group of the target that is multiplied with the factor",
        options=ONCE,
    )
    limit: IntProperty(
        name="Limit Weights",
        description=(
            "Maximum number of deform weights per vertex, of which the largest are kept; 0 uses the maximum of the "
            "source"
        ),
        default=0,
        min=0,
        soft_max=8,
        options=ONCE,
    )
    flip_names: BoolProperty(
        name="Flip Group Names",
        description="Rename vertex groups to the other side, such as Arm.L to Arm.R, if the match maps left to right",
        default=False,
        options=ONCE,
    )
    group_names: StringProperty(
        name="Rename Groups",
        description="New names of vertex groups on the target: old = new, old = new",
        options=ONCE,
    )

    turning: StringProperty(
        name="Directions",
        description=(
            "Attributes to rotate with the surface, separated by commas, such as directions and rotations in object "
            "space"
        ),
        options=ONCE,
    )

    def settings(self) -> Settings:
        """The chosen settings.

        Raises:
            MeshError: new names of groups are not pairs.
        """
        chosen = {name: getattr(self, name) for name in BlendOptions.__annotations__}
        names, turning = parse_group_names(self.group_names), parse_names(self.turning)
        for name in ("mode", "without_partner"):
            chosen[name] = chosen[name].lower()
        return Settings(**{**chosen, "group_names": names, "turning": turning})


class BindChoice:
    """Whether a transfer binds the target, too."""

    bind: BoolProperty(
        name="Bind to Rig",
        description=(
            "Also bind the target to the source's armature: move it to Rest Position, and add the vertex groups and "
            "an Armature modifier. This moves its vertices"
        ),
        default=False,
        options=ONCE,
    )


class BindOptions:
    """How to bind a target to the source's armature."""

    binding: EnumProperty(
        name="Target Pose",
        description="Pose that the target is in before binding",
        items=(
            (
                "AUTOMATIC",
                "Automatic",
                "Detect the pose of the target, and move it to Rest Position if needed",
            ),
            (
                "REST_POSE",
                "In a Pose",
                "Move the target to Rest Position; the shape key Posed Shape keeps its current shape",
            ),
            ("KEEP_SHAPE", "At Rest", "Keep the target's shape, moved and scaled to the source"),
        ),
        default="AUTOMATIC",
        options=ONCE,
    )
    replace_binding: BoolProperty(
        name="Replace Binding",
        description=(
            "Remove the target from its current armature, keeping its posed shape; otherwise bound targets are rejected"
        ),
        default=False,
        options=ONCE,
    )

    def how_to_bind(self) -> Binding:
        """The chosen binding."""
        return Binding(self.binding.lower(), self.replace_binding)


class BindView:
    """The objects that stay visible after binding."""

    hide_source: BoolProperty(
        name="Hide Source",
        description=(
            "Hide the source in the viewport after binding, because both meshes are at the same place then; its eye "
            "icon in the Outliner shows it again"
        ),
        default=True,
        options=ONCE,
    )
