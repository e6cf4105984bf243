"""Options of a transfer.

Property annotations are read by Blender as they are, so this module does without postponed evaluation.
"""

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ..adapters import FILL_BELOW, Binding, Settings, parse_group_names, parse_names
from .once import ONCE

# Options that say where and how much, and those that say what becomes of groups and attributes.
BLENDING = ("fill_below", "without_partner", "mode", "factor", "mask_group")
NAMING = ("limit", "flip_names", "group_names", "turning")


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
    without_partner: EnumProperty(
        name="No Partner",
        description="What becomes of the target where nothing on the source corresponds to it",
        items=(
            (
                "FILL",
                "Fill In",
                "Weights, colours, numbers and shape keys go on smoothly from around it, other data as what is nearest",
            ),
            ("KEEP", "Keep", "The target keeps what it has there"),
        ),
        default="FILL",
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
        name="Directions",
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
        for name in ("mode", "without_partner"):
            chosen[name] = chosen[name].lower()
        return Settings(**{**chosen, "group_names": names, "turning": turning})


class BindChoice:
    """Whether a transfer binds the target, too."""

    bind: BoolProperty(
        name="Bind to Rig",
        description=(
            "Bind the target to the source's armature as well: it is taken to the rest pose, gets the vertex groups "
            "and the Armature modifier, and is posed by the bones at once. This moves its vertices"
        ),
        default=False,
        options=ONCE,
    )


class BindOptions:
    """How to bind a target to the source's armature."""

    binding: EnumProperty(
        name="Stands",
        description="What becomes of the target's shape",
        items=(
            (
                "AUTOMATIC",
                "Automatic",
                "Find out in which pose the target stands, and take it to the rest pose if needed",
            ),
            (
                "REST_POSE",
                "In a Pose",
                "Take the target to the rest pose; a shape key, Posed Shape, keeps it as it stood",
            ),
            ("KEEP_SHAPE", "At Rest", "Keep the target's shape, moved and scaled to where the source is"),
        ),
        default="AUTOMATIC",
        options=ONCE,
    )
    replace_binding: BoolProperty(
        name="Replace Binding",
        description="Take the target off the armature that it is bound to, as it is posed; else it is refused",
        default=False,
        options=ONCE,
    )

    def how_to_bind(self) -> Binding:
        """What is chosen here."""
        return Binding(self.binding.lower(), self.replace_binding)
