# SPDX-License-Identifier: GPL-3.0-or-later
"""Bones that belong to an outfit, such as those of skirts, ribbons and tails, in the armature of another wearer."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.types import ArmatureEditBones, Bone, Context, EditBone, Object
from mathutils import Matrix, Vector

from zoomout_core.arrays import Floats
from zoomout_core.transfer.rigging.humanoid import humanoid_bones

from ..attributes.vertex_groups import read_weights
from ..matrices import transform_points, world_matrix
from .armatures import armature_modifiers, set_parent

# A custom property of bones that were copied: the name of the armature that they come from.
COPIED_FROM = "zoomout_dressed"
# Properties of a bone besides its place, its parent and its name.
SETTINGS = (
    "use_connect",
    "use_deform",
    "use_inherit_rotation",
    "inherit_scale",
    "use_local_location",
    "envelope_distance",
    "envelope_weight",
    "head_radius",
    "tail_radius",
)


@dataclass(frozen=True, eq=False)
class OutfitBones:
    """Bones of an armature that move worn objects but not the body.

    Attributes:
        names: their names, parents before children.
        parents: names of their parents, which may be bones of the body; empty for none.
        ends: (b, 2, 3) heads and tails at rest, in world space.
        upright: (b, 3) their z axes, in world space.
        wearer: for each the name of the worn object that it moves most.
        of_body: names of the bones of the body that move worn objects.
    """

    names: tuple[str, ...]
    parents: tuple[str, ...]
    ends: Floats
    upright: Floats
    wearer: tuple[str, ...]
    of_body: tuple[str, ...]


def weight_of_bones(obj: Object) -> dict[str, float]:
    """The sum of the weights of each vertex group that has any, by name."""
    if obj.type != "MESH" or not obj.vertex_groups:
        return {}
    weights = read_weights(obj, obj.data)
    sums = np.asarray(weights.values.sum(axis=0)).ravel()
    return {name: float(total) for name, total in zip(weights.labels, sums, strict=True) if total > 0}


def bones_copied_from(armature: Object, source: str) -> set[str]:
    """The names of an armature's bones that were copied from another one, named `source`."""
    return {bone.name for bone in armature.data.bones if bone.get(COPIED_FROM) == source}


def read_outfit_bones(
    armature: Object, target: Object, bodies: Iterable[Object], worn: Sequence[Object]
) -> OutfitBones:
    """The bones of an armature that move worn objects but not the bodies, and those between them and the body's.

    Bones that the target armature has itself, by name or as humanoid bones, are left out. Bodies often lack the skin
    below clothes, so that bones such as those of legs move only worn objects.
    """
    present = {bone.name for bone in target.data.bones} - bones_copied_from(target, armature.name)
    humanoid, others = humanoid_bones(armature.data.bones.keys()), humanoid_bones(sorted(present))
    present |= {name for bone, name in humanoid.items() if bone in others}
    of_body = {name for body in bodies for name in weight_of_bones(body)}
    of_worn = {obj.name: weight_of_bones(obj) for obj in worn}
    of_any = {name for weights in of_worn.values() for name in weights}
    moving = of_any - of_body
    # A bone belongs to the outfit if it or one below it moves only worn objects, and none of the body.
    chosen = [
        bone
        for bone in armature.data.bones
        if bone.name not in present
        and {bone.name, *(child.name for child in bone.children_recursive)} & moving
        and not {bone.name, *(child.name for child in bone.children_recursive)} & of_body
    ]
    world = world_matrix(armature)
    ends = np.array([[bone.head_local, bone.tail_local] for bone in chosen], np.float64).reshape(-1, 2, 3)
    upright = np.array([bone.matrix_local.col[2][:3] for bone in chosen], np.float64).reshape(-1, 3)
    return OutfitBones(
        tuple(bone.name for bone in chosen),
        tuple(bone.parent.name if bone.parent else "" for bone in chosen),
        transform_points(world, ends),
        upright @ world[:3, :3].T,
        tuple(_wearer(bone, of_worn) for bone in chosen),
        tuple(bone.name for bone in armature.data.bones if bone.name in of_any and bone not in chosen),
    )


def add_outfit_bones(
    context: Context, source: Object, target: Object, bones: OutfitBones, pairs: Mapping[str, str]
) -> None:
    """Copy an outfit's bones into another armature, with their constraints; earlier copies are replaced.

    If that fails, the armature is as before.

    Args:
        context: Blender's.
        source: the armature of the bones.
        target: the armature that receives them.
        bones: the bones, in their new places.
        pairs: names of the target's bones by those of the source's.
    """
    to_target = np.linalg.inv(world_matrix(target))
    ends = transform_points(to_target, bones.ends)
    upright = bones.upright @ to_target[:3, :3].T
    with _restore_on_failure(target, source.name):
        with edit_bones(context, target) as made:
            for earlier in [bone for bone in made if bone.get(COPIED_FROM) == source.name]:
                made.remove(earlier)
            for number, name in enumerate(bones.names):
                bone = made.new(name)
                bone.head, bone.tail = (Vector(end) for end in ends[number])
                bone.align_roll(Vector(upright[number]))
                above = bones.parents[number]
                bone.parent = made.get(above if above in bones.names else pairs.get(above, above))
                _copy_settings(source.data.bones[name], bone)
                bone[COPIED_FROM] = source.name
        for name in bones.names:
            _copy_constraints(source, target, name, pairs)


def bind_to_other(obj: Object, source: Object, target: Object, pairs: Mapping[str, str], place: Floats) -> None:
    """Bind an object to another armature than that of its original: its vertex groups take the names of its bones.

    Args:
        obj: the object, bound to the source.
        source: the armature that its original is bound to.
        target: the other armature.
        pairs: names of the target's bones by those of the source's.
        place: (4, 4) the object's world matrix at rest.
    """
    for modifier in armature_modifiers(obj):
        if modifier.object == source:
            modifier.object = target
    bone = pairs.get(obj.parent_bone, "") if obj.parent_type == "BONE" else ""
    set_parent(obj, target, place)
    if bone:
        rest = target.data.bones[bone]
        end = world_matrix(target) @ np.array(rest.matrix_local @ Matrix.Translation((0, rest.length, 0)))
        obj.parent_type, obj.parent_bone = "BONE", bone
        obj.matrix_parent_inverse = Matrix((np.linalg.inv(end) @ place).tolist())
    renamed = [
        (group, pairs[group.name]) for group in obj.vertex_groups if pairs.get(group.name, group.name) != group.name
    ]
    for number, (group, _) in enumerate(renamed):  # names may be exchanged
        group.name = f"zoomout renamed {number}"
    for group, name in renamed:
        group.name = name


def _wearer(bone: Bone, of_worn: Mapping[str, Mapping[str, float]]) -> str:
    """The name of the object that a bone moves most or, if it moves none, those below it."""
    below = [child.name for child in bone.children_recursive]

    def moves(name: str) -> tuple[float, float]:
        weights = of_worn[name]
        return weights.get(bone.name, 0.0), sum(weights.get(each, 0.0) for each in below)

    return max(of_worn, key=moves)


@contextmanager
def _restore_on_failure(armature: Object, source: str) -> Iterator[None]:
    """A context that restores the bones of an armature if it fails, with the constraints of those from a source."""
    before = armature.copy()
    before.data = armature.data.copy()
    try:
        yield
    except BaseException:
        changed, name = armature.data, armature.data.name
        changed.user_remap(before.data)
        bpy.data.armatures.remove(changed)
        armature.data.name = name
        bpy.context.view_layer.update()
        for bone in armature.data.bones:
            if bone.get(COPIED_FROM) == source:
                _copy_constraints(before, armature, bone.name, {})
        bpy.data.objects.remove(before)
        raise
    bpy.data.batch_remove([before, before.data])


@contextmanager
def edit_bones(context: Context, armature: Object) -> Iterator[ArmatureEditBones]:
    """A context in which an armature is in Edit Mode, with its bones; the active object stays the same.

    The armature may be hidden or disabled, itself or with its collections.
    """
    layer, shown = context.view_layer, context.scene.collection
    active, disabled, is_added = layer.objects.active, armature.hide_viewport, armature.name not in shown.objects
    armature.hide_viewport = False
    if is_added:
        shown.objects.link(armature)  # the only collection that cannot be hidden or excluded
    hidden = armature.hide_get()
    armature.hide_set(False)
    layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        yield armature.data.edit_bones
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
        layer.objects.active = active
        armature.hide_set(hidden)
        if is_added:
            shown.objects.unlink(armature)
        armature.hide_viewport = disabled


def _copy_settings(bone: Bone, made: EditBone) -> None:
    for name in SETTINGS:
        setattr(made, name, getattr(bone, name))
    for name, value in bone.items():
        made[name] = value


def _copy_constraints(source: Object, target: Object, name: str, pairs: Mapping[str, str]) -> None:
    """Copy the constraints of a bone; those on the source armature act on the partners in the target."""
    constraints = target.pose.bones[name].constraints
    for earlier in list(constraints):
        constraints.remove(earlier)
    for given in source.pose.bones[name].constraints:
        made = constraints.new(given.type)
        for option in given.bl_rna.properties:
            if not option.is_readonly and option.identifier != "name":
                setattr(made, option.identifier, getattr(given, option.identifier))
        made.name = given.name
        if getattr(made, "target", None) == source:
            made.target = target
            made.subtarget = pairs.get(made.subtarget, made.subtarget)
