# SPDX-License-Identifier: GPL-3.0-or-later
"""Bind a target to the armature of its source: move it to the rest pose, and bind it like the source.

The armature and its animation are not changed. For a target of another build, a copy of the armature is moved into it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from bpy.types import Context, Object
from scipy.sparse import csc_array, csr_array

import zoomout_core as zo
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.messages import Message, message, warning
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.transfer import Attribute, map_target
from zoomout_core.transfer.rigging.poses import distinct_poses, extreme_poses, poses_about
from zoomout_core.transfer.rigging.rest_pose import PosedTarget, align, find_pose
from zoomout_core.transfer.rigging.rig import follow_longer_bones, joints_of_bones
from zoomout_core.transfer.rigging.skinning import skinning_matrices
from zoomout_core.transfer.rigging.stretch import check_weights
from zoomout_core.transfer.rigging.unpose import Rest, unpose

from .. import mesh_data
from ..adapters import Binding, Settings, TransferJob
from ..adapters.key_drivers import notes_on_drivers
from ..adapters.shape_keys import ShapeKeyAdapter
from ..adapters.vertex_groups import WeightAdapter
from ..jobs import compute
from ..mesh_data import Bones, ObjectPair, RigBones
from ..mesh_data.matrices import transform_points
from ..scene.pair import evaluated_sources, find_mesh, fingerprint_target, users_of_mesh
from ..storage import stored_match

# Name of the shape key with the target's original shape.
POSED_SHAPE = "Posed Shape"
# Fractions of the progress at which weights are transferred, the target is moved to rest, keys are transferred, and the
# rig is moved and played.
READING, TAKING, KEYS, CHECKING, MOVED = 0.6, 0.7, 0.75, 0.8, 0.9


@dataclass(frozen=True, eq=False)
class Bound:
    """A target, ready to be bound.

    Attributes:
        shape: "rest_pose" or "keep_shape".
        seen: (n_t, 3) its present positions, in world space.
        rest: its rest pose.
        notes: sentences for the user.
        stretched: (n_t,) vertices at edges that stretch too far when the bones turn.
        rig: the bones of a copy of the armature; None to bind it to the armature itself.
    """

    shape: str
    seen: Floats
    rest: Rest
    notes: tuple[str, ...]
    stretched: Booleans
    rig: _MovedRig | None


@dataclass(frozen=True, eq=False)
class _MovedRig:
    """An armature, moved into a target.

    Attributes:
        armature: its name.
        bones: its bones in their new places, in world space.
        motion: (4, 4) the similarity from the place of the source to that of the target.
    """

    armature: str
    bones: RigBones
    motion: Floats


@dataclass(frozen=True, eq=False)
class Rigged:
    """Sources that armatures deform.

    Attributes:
        rest: their surface at rest, in world space.
        bones: bones of the first source's armatures.
        weights: (n_s, b) weights of these bones.
        poses: (f, b, 3, 4) transforms of these bones in frames of the armatures' animation.
        preserves_volume: whether the armatures preserve volume.
    """

    rest: zo.Surface
    bones: Bones
    weights: csr_array
    poses: Floats
    preserves_volume: bool


def check_binding(context: Context, source_name: str, target_name: str, binding: Binding, settings: Settings) -> None:
    """Raise a MeshError if a target cannot be bound to the armature of a source.

    Args:
        context: Blender's.
        source_name: name of the source, which has the armature.
        target_name: name of the target.
        binding: how to bind it.
        settings: how to transfer its weights.
    """
    source, target = find_mesh(context, source_name), find_mesh(context, target_name)
    _check_rig(source)
    if binding.move_rig:
        _check_movable(source, target)
    if settings.flip_names:
        raise zo.MeshError("Flip Group Names cannot be used with Bind to Rig: turn it off.")
    if target.parent is not None and target.parent_type == "BONE":
        raise zo.MeshError(
            "'{target}' is already parented to a bone: clear its parent to bind it to the armature.", target=target.name
        )
    if mesh_data.armatures_of(target) and not binding.replace:
        raise zo.MeshError(
            "'{target}' is already bound to {armatures}: turn on Replace Binding, or remove its Armature modifier.",
            target=target.name,
            armatures=_names(target),
        )
    if (users := users_of_mesh(context, target)) > 1:
        raise zo.MeshError(
            "The mesh of '{target}' is shared by {users} objects, which would all change: make it single-user.",
            target=target.name,
            users=users,
        )
    if target.data.shape_keys is not None and not target.data.shape_keys.use_relative:
        raise zo.MeshError(
            "The shape keys of '{name}' are absolute: turn on Relative in its shape keys.", name=target.name
        )
    if mesh_data.is_flat(source):
        raise zo.MeshError(
            "'{source}' has a scale of zero, so nothing can be bound to its armature: change its scale.",
            source=source.name,
        )
    if mesh_data.moves_by_itself(target):
        raise zo.MeshError(
            "'{target}' has an animation of its own, which would move it off the rig: clear its location, rotation and "
            "scale animation, or bind a copy without it.",
            target=target.name,
        )
    if not mesh_data.can_be_put(source, target):
        raise zo.MeshError(
            "Constraints, drivers or animation control the transform of '{target}': remove them, so "
            "that it can be parented to the armature.",
            target=target.name,
        )


def _check_rig(source: Object) -> None:
    """Raise a MeshError unless an armature deforms an object by vertex groups."""
    if not mesh_data.armatures_of(source):
        raise zo.MeshError(
            "'{source}' has no Armature modifier: choose a source that an armature deforms.", source=source.name
        )
    if not mesh_data.deforming_bones(source) & {group.name for group in source.vertex_groups}:
        raise zo.MeshError(
            "No deform bone of {armatures} is named like a vertex group of '{source}': add bone "
            "weights to the source first.",
            armatures=_names(source),
            source=source.name,
        )


def _check_movable(source: Object, target: Object) -> None:
    """Raise a MeshError if the armature of a source cannot be moved into a target."""
    first, *others = mesh_data.armatures_of(source)
    if others:
        raise zo.MeshError(
            "'{source}' is deformed by several armatures ({armatures}), and only one can be moved: join them first, or "
            "use Bind to Rig.",
            source=source.name,
            armatures=_names(source),
        )
    if first.mode == "EDIT":
        raise zo.MeshError("'{armature}' is in Edit Mode: leave it first.", armature=first.name)
    if mesh_data.moves_by_itself(first):
        raise zo.MeshError(
            "The location, rotation or scale of '{armature}' is animated, so a copy of it would not stay at the "
            "target: animate its root bone instead, or clear that animation.",
            armature=first.name,
        )
    if mesh_data.worn_copies(target):
        raise zo.MeshError(
            "'{target}' wears copies of clothes, which would stay on the source's rig: move the rig first, and dress "
            "the target then.",
            target=target.name,
        )


def _names(obj: Object) -> str:
    """The names of an object's armatures, for a message."""
    return ", ".join(f"'{armature.name}'" for armature in mesh_data.armatures_of(obj))


async def prepare_binding(
    context: Context, job: TransferJob, weights: WeightAdapter, keys: ShapeKeyAdapter | None, binding: Binding
) -> Bound:
    """Find the pose of a target, transfer data from the source at rest, and move the target to rest.

    Args:
        context: Blender's.
        job: the transfer.
        weights: the source's vertex groups, which are transferred.
        keys: the source's shape keys, which are transferred to the target at rest; None for none.
        binding: how to bind the target.

    Raises:
        MeshError: the target cannot be bound; nothing was written.
    """
    pair = job.pair
    _check_keys_of_posed(find_mesh(context, pair.target_name), pair.target.vertices)
    rigged = read_rigged(context, pair)
    posed, job = await compute(partial(_pose, job, rigged, weights))
    own = _weights_of_target(context, pair, rigged.bones, weights.weights)
    keeps_shape = binding.shape == "keep_shape" or (binding.shape == "automatic" and posed.pose.is_rest)
    notes = []
    if keeps_shape:
        rest = align(pair.target, posed.pose)
    else:
        with stage("Unposing", TAKING, KEYS):
            rest = await compute(partial(_at_rest, pair.target, posed, own, rigged))
        notes.append(
            message(
                "'{target}' was in a different pose, with its bones rotated by {angle:.0f}° on average, "
                "and was moved to Rest Position. Its shape key '{key}' keeps the original shape.",
                target=pair.target_name,
                angle=posed.pose.bend,
                key=POSED_SHAPE,
            )
        )
    if rest.smoothed:
        notes.append(
            message(
                "Rest pose: {count:,} vertices were moved with their neighbors, to avoid tears.", count=rest.smoothed
            )
        )
    if keys is not None:
        with portion(KEYS, CHECKING):
            await compute(partial(keys.transfer_to_rest, job, rest))
    moved, rig = rigged.bones.heads, None
    if binding.move_rig:
        (armature,) = mesh_data.armatures_of(find_mesh(context, pair.source_name))
        bones, name = mesh_data.read_rig_bones(armature), armature.name
        notes += _note_on_constraints(armature)
        with stage("Moving the rig", CHECKING, MOVED):
            at_rest = pair.target.with_vertices(rest.positions)
            bones = await compute(partial(_move_bones, bones, posed, rigged.rest, at_rest))
        moved = bones.heads[[bones.names.index(each) for each in rigged.bones.names]]
    with stage("Playing the rig", MOVED, 1):
        stretched, of_check = await compute(partial(_check_weights, job, posed, rigged, rest, own, weights, moved))
    if binding.move_rig:
        motion = _motion(posed, pair.target, rest)
        rig = _MovedRig(name, _move_as_a_whole(bones, motion), motion)
        rest = Rest(transform_points(motion, rest.positions), motion[:3, :3] @ rest.linear, rest.smoothed)
        if keys is not None:
            keys.turn(motion[:3, :3])
    shape = "keep_shape" if keeps_shape else "rest_pose"
    return Bound(shape, pair.target.vertices, rest, (*notes, *of_check), stretched, rig)


def _move_bones(bones: RigBones, posed: PosedTarget, rest: zo.Surface, target: zo.Surface) -> RigBones:
    """The bones of a rig in the target at rest, at the place and size of the source at rest."""
    joints, parents = joints_of_bones(bones.heads, bones.tails, bones.parents)
    moved = zo.move_rig(posed.mapped, rest, target, joints, parents)
    heads, tails = np.split(moved.positions, 2)
    rotations = moved.rotations[: len(heads)]
    heads, tails, rotations = follow_longer_bones(bones.heads, bones.tails, heads, tails, rotations)
    upright = np.einsum("bxy,by->bx", rotations, bones.upright)
    return replace(bones, heads=heads, tails=tails, upright=upright)


def _motion(posed: PosedTarget, target: zo.Surface, rest: Rest) -> Floats:
    """(4, 4) the similarity that takes a target at rest back to its own place and size."""
    motion = np.eye(4)
    if not np.array_equal(rest.positions, target.vertices):
        motion[:3, :3], motion[:3, 3] = posed.pose.common.linear, posed.pose.common.translation
    return motion


def _move_as_a_whole(bones: RigBones, motion: Floats) -> RigBones:
    heads, tails = (transform_points(motion, each) for each in (bones.heads, bones.tails))
    return replace(bones, heads=heads, tails=tails, upright=bones.upright @ motion[:3, :3].T)


def _note_on_constraints(armature: Object) -> list[Message]:
    """A warning about constraints that depend on the rest position of the original."""
    names = mesh_data.child_of_constraints(armature)
    if not names:
        return []
    return [
        warning(
            "Child Of constraints of {count} bones have an inverse of the old rest position, such as that of '{bone}': "
            "set it again on the copy.",
            count=len(names),
            bone=names[0],
        )
    ]


def _check_weights(
    job: TransferJob,
    posed: PosedTarget,
    rigged: Rigged,
    rest: Rest,
    own: csr_array,
    weights: WeightAdapter,
    moved: Floats,
) -> tuple[Booleans, tuple[str, ...]]:
    """Turn the bones to extremes, play their animation, and smooth weights that would tear the target.

    The bones of the target turn about other heads (b, 3) if they are moved.

    Returns:
        (n_t,) vertices that stretch too far still, and sentences for the user.
    """
    target, bones = job.pair.target.with_vertices(rest.positions), rigged.bones
    poses = np.concatenate([extreme_poses(bones.heads, bones.parents), distinct_poses(rigged.poses, bones.heads)])
    of_target = poses_about(poses, bones.heads, moved, bones.parents)
    checked = check_weights(rigged.rest, rigged.weights, target, own, posed.mapped.surface_map, poses, of_target)
    notes = []
    if checked.smoothed.any():
        weights.smooth(target, checked.smoothed, job.settings.limit)
        notes.append(
            message(
                "The weights of {count:,} vertices would have torn the mesh when bones turn: they were smoothed.",
                count=int(checked.smoothed.sum()),
            )
        )
    if checked.stretched.any():
        notes.append(
            warning(
                "{count:,} vertices stretch far more than on the source when bones turn: Select Stretched shows them.",
                count=int(checked.stretched.sum()),
            )
        )
    return checked.stretched, tuple(notes)


def _pose(job: TransferJob, rigged: Rigged, weights: WeightAdapter) -> tuple[PosedTarget, TransferJob]:
    """The pose of a target, and the transfer along the map to the source in that pose, by which weights come."""
    mapped = map_target(job.match, job.pair.source, job.pair.target, job.settings.fill_below)
    with stage("Finding the pose", 0, READING):
        posed = find_pose(mapped, rigged.rest, rigged.weights, rigged.bones.parents)
    if posed.mapped.surface_map is not mapped.surface_map:
        anew = stored_match.StoredMatch(
            posed.mapped.surface_map, posed.mapped.confidence, (), has_partner=job.match.has_partner
        )
        job = job.along(anew)
    with portion(READING, TAKING):
        weights.transfer(job)
    return posed, job


def write_bound(context: Context, pair: ObjectPair, bound: Bound) -> list[Message]:
    """Bind the target, in `writing`, after its vertex groups were written, and before transferred shape keys are.

    Returns:
        Sentences for the user.
    """
    source, target = find_mesh(context, pair.source_name), find_mesh(context, pair.target_name)
    place, armature = mesh_data.place_beside(source, target), None
    if bound.rig is not None:
        place, original = bound.rig.motion @ place, context.scene.objects[bound.rig.armature]
        armature = mesh_data.copy_rig(context, original, target, bound.rig.bones, bound.rig.motion)
    read = [*mesh_data.armatures_of(target), *mesh_data.armatures_of(source)]
    mesh_data.unbind(target)
    mesh_data.reshape(target, bound.seen, bound.rest.positions, bound.rest.linear, place)
    mesh_data.bind_like(source, target)
    if armature is not None:
        mesh_data.bind_to_other(target, original, armature, {}, place)
    context.view_layer.update()
    notes = _redirect_drivers(target, read)
    return notes if armature is None else notes + _note_on_bends(mesh_data.bends_at_rest(original, armature))


def _redirect_drivers(target: Object, read: Iterable[Object]) -> list[Message]:
    """Let drivers of the keys that a target has already read its armature, where it has what they read of others.

    Args:
        target: the object, bound.
        read: armatures that they may read.
    """
    if target.data.shape_keys is None:
        return []
    own = mesh_data.armatures_of(target)
    blocks = {part: part for each in own for part in (each, each.data)}
    others = {block: other for each in read for block, other in mesh_data.counterpart_armatures(each, own[0]).items()}
    counterparts = mesh_data.Counterparts(blocks, if_present=others)
    return list(notes_on_drivers(mesh_data.redirect_drivers(target.data.shape_keys, counterparts), target))


def write_posed_shape(target: Object, bound: Bound) -> None:
    """Keep the original shape of a target that was moved to rest as a key, after all others were written."""
    if bound.shape == "rest_pose":
        mesh_data.write_shape(target, POSED_SHAPE, mesh_data.positions_in_object(target, bound.seen))


def _note_on_bends(turned: Mapping[str, float]) -> list[Message]:
    """A warning about bones that do not fit the constraints of a moved rig."""
    if not turned:
        return []
    worst = max(turned, key=lambda name: turned[name])
    return [
        warning(
            "At rest, constraints turn {count} deforming bones of the copy, '{bone}' by {angle:.0f}°: move control "
            "bones that no longer fit in Edit Mode.",
            count=len(turned),
            bone=worst,
            angle=turned[worst],
        )
    ]


def is_at_source(report: Mapping[str, Any]) -> bool:
    """Whether a transfer bound the target, and moved it to the place of its source."""
    return bool(report["bound"]) and "moved" not in report["bound"]


def hide_sources(context: Context, reports: Iterable[Mapping[str, Any]]) -> None:
    """Hide the sources of targets that were bound at their place.

    Args:
        context: Blender's.
        reports: reports of transfers.
    """
    for report in reports:
        for name in (report["source"], *report["others"]) if is_at_source(report) else ():
            find_mesh(context, name).hide_set(True)


def keep_match(context: Context, pair: ObjectPair, match: stored_match.Match, settings: Mapping[str, Any]) -> None:
    """Store the match again for the reshaped mesh."""
    target = find_mesh(context, pair.target_name)
    now = replace(pair, target_fingerprint=fingerprint_target(context, target.name))
    stored_match.write(target.data, match, now, settings)


def _check_keys_of_posed(target: Object, seen: Floats) -> None:
    """Raise a MeshError if a target that an armature poses has shape keys, because these belong to another pose."""
    if target.data.shape_keys is None or not mesh_data.armatures_of(target):
        return
    if not mesh_data.stands_as_modelled(target, seen):
        raise zo.MeshError(
            "'{target}' has shape keys and is posed by {armatures}: set that armature to Rest "
            "Position, and match again.",
            target=target.name,
            armatures=_names(target),
        )


def read_rigged(context: Context, pair: ObjectPair) -> Rigged:
    """The sources at rest, with the weights of the first one's bones."""
    with evaluated_sources(context, pair) as sources:
        weights, _ = mesh_data.read_joined_weights(sources)
    source = find_mesh(context, pair.source_name)
    bones = mesh_data.read_bones(source)
    rest = pair.source.with_vertices(read_sources_at_rest(context, pair))
    poses = mesh_data.read_animation(source)
    return Rigged(rest, bones, weights_of_bones([weights], bones), poses, mesh_data.preserves_volume(source))


def read_sources_at_rest(context: Context, pair: ObjectPair) -> Floats:
    """(n_s, 3) undeformed vertices of the sources, in world space.

    Raises:
        MeshError: the undeformed vertices cannot be read.
    """
    with evaluated_sources(context, pair) as sources:
        faces = [mesh_data.read_faces(source.mesh) for source in sources]
    rest = []
    for name, each in zip(pair.source_names, faces, strict=True):
        source = find_mesh(context, name)
        positions = mesh_data.read_undeformed_positions(source, each)
        if positions is None:
            raise zo.MeshError(
                "Modifiers of '{name}' change its faces when the armature is off, so its rest pose "
                "cannot be read: disable those that add or remove vertices, and match again.",
                name=name,
            )
        rest.append(mesh_data.positions_in_world(source, positions))
    return np.concatenate(rest)


def _weights_of_target(context: Context, pair: ObjectPair, bones: Bones, weights: Attribute) -> csr_array:
    """(n_t, b) bone weights that the target will have: transferred ones, else its own."""
    target = find_mesh(context, pair.target_name)
    return weights_of_bones([weights, mesh_data.read_weights(target, target.data)], bones)


def weights_of_bones(groups: list[Attribute], bones: Bones) -> csr_array:
    """(n, b) weights of bones, each from the first attribute with a group of its name."""
    count = groups[0].values.shape[0]
    entries: list[tuple[Floats, np.ndarray, np.ndarray]] = []
    for number, name in enumerate(bones.names):
        having = next((each for each in groups if name in each.labels), None)
        if having is not None:
            column = csc_array(having.values[:, [having.labels.index(name)]])
            entries.append((column.data.astype(np.float64), column.indices, np.full(column.nnz, number)))
    data, row, column_number = (np.concatenate(part) for part in zip(*entries, strict=True))
    return csr_array((data, (row, column_number)), shape=(count, len(bones.names)))


def _at_rest(target: zo.Surface, posed: PosedTarget, weights: csr_array, rigged: Rigged) -> Rest:
    """The rest pose of the target."""
    transforms = posed.pose.transforms
    matrices = skinning_matrices(transforms, weights, preserve_volume=rigged.preserves_volume)
    return unpose(target, matrices, posed.pose.scale, posed.mapped.confidence)
