# SPDX-License-Identifier: GPL-3.0-or-later
"""Bind a target to the armature of its source: move it to the rest pose, and bind it like the source.

The armature and its animation are not changed. For a target of another build, a copy of the armature is moved into it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from bpy.types import Context, Object
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.messages import Message, message, plural, plural_warning
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.transfer import map_target
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.rigging.poses import distinct_poses, extreme_poses, poses_about
from zoomout_core.transfer.rigging.rest_pose import PosedTarget, align, correct_map, find_pose
from zoomout_core.transfer.rigging.rig import follow_longer_bones, joints_of_bones, note_on_idle_joints
from zoomout_core.transfer.rigging.skinning import skinning_matrices
from zoomout_core.transfer.rigging.stretch import check_weights
from zoomout_core.transfer.rigging.unpose import Rest, unpose

from ... import mesh_data
from ...adapters import Adapter, Binding, TransferJob, transfer_all
from ...adapters.shape_keys import ShapeKeyAdapter
from ...adapters.vertex_groups import WeightAdapter
from ...jobs import compute
from ...mesh_data import ObjectPair, RigBones
from ...mesh_data.matrices import transform_points
from ...scene.pair import find_mesh
from ...storage import stored_match
from .check import check_keys_of_posed
from .read import Rigged, read_rigged, weights_of_target

# Name of the shape key with the target's original shape.
POSED_SHAPE = "Posed Shape"
# Fractions of the progress at which data that is written to any pose is transferred, then weights, the target is moved
# to rest, keys are transferred, and the rig is moved and played.
FOUND, READING, TAKING, KEYS, CHECKING, MOVED = 0.3, 0.65, 0.7, 0.75, 0.8, 0.9


@dataclass(frozen=True, eq=False)
class Bound:
    """A target, ready to be bound.

    Attributes:
        shape: "rest_pose" or "keep_shape".
        seen: (n_t, 3) its present positions, in world space.
        rest: its rest pose.
        notes: sentences for the user.
        stretched: (n_t,) vertices at edges that stretch too far when the bones rotate.
        rig: the bones of a copy of the armature; None to bind it to the armature itself.
        match: the match, corrected by the bones if the target is the source's own body.
    """

    shape: str
    seen: Floats
    rest: Rest
    notes: tuple[str, ...]
    stretched: Booleans
    rig: MovedRig | None
    match: stored_match.Match


@dataclass(frozen=True, eq=False)
class MovedRig:
    """An armature, moved into a target.

    Attributes:
        armature: its name.
        bones: its bones in their new places, in world space.
        motion: (4, 4) the similarity from the place of the source to that of the target.
        metarig: the metarig that it was generated from, moved in the same way; None if it has none.
    """

    armature: str
    bones: RigBones
    motion: Floats
    metarig: MovedRig | None = None


@dataclass(frozen=True, eq=False)
class _NamedBones:
    """The bones of an armature, by its name."""

    name: str
    bones: RigBones

    def heads_of(self, names: Sequence[str]) -> Floats:
        """(b, 3) heads of bones, by name."""
        own = list(self.bones.names)
        return self.bones.heads[[own.index(name) for name in names]]


async def prepare_binding(
    context: Context,
    job: TransferJob,
    others: Sequence[Adapter],
    weights: WeightAdapter,
    keys: ShapeKeyAdapter | None,
    binding: Binding,
) -> Bound:
    """Find the pose of a target, transfer data from the source at rest, and move the target to rest.

    Args:
        context: Blender's.
        job: the transfer.
        others: further data of the source, which follows the match as the bones correct it.
        weights: the source's vertex groups, which are transferred.
        keys: the source's shape keys, which are transferred to the target at rest; None to transfer none.
        binding: how to bind the target.

    Raises:
        MeshError: the target cannot be bound; nothing was written.
    """
    pair = job.pair
    check_keys_of_posed(find_mesh(context, pair.target_name), pair.target.vertices)
    rigged = read_rigged(context, pair)
    posed, corrected = await compute(partial(_find_pose, job, rigged))
    with portion(FOUND, READING):
        await compute(partial(transfer_all, others, job.along(corrected)))
    job = await compute(partial(_transfer_weights, job, posed, weights))
    own = weights_of_target(context, pair, rigged.bones, weights.weights)
    keeps_shape = binding.shape == "keep_shape" or (binding.shape == "automatic" and posed.pose.is_rest)
    if keeps_shape:
        rest = align(pair.target, posed.pose)
    else:
        with stage("Unposing", TAKING, KEYS):
            rest = await compute(partial(_at_rest, pair.target, posed, own, rigged))
    notes = _notes_on_rest(pair.target_name, None if keeps_shape else posed.pose.bend, rest)
    if keys is not None:
        with portion(KEYS, CHECKING):
            await compute(partial(keys.transfer_to_rest, job, rest))
    heads = rigged.bones.heads
    rigs: list[_NamedBones] = []
    if binding.move_rig:
        rigs, on_constraints = await _move_rigs(context, pair, posed, rigged, rest)
        notes += on_constraints
        notes += note_on_idle_joints(rigged.bones.names, rigged.weights, own)
        heads = rigs[0].heads_of(rigged.bones.names)
    with stage("Playing the rig", MOVED, 1):
        stretched, of_check = await compute(partial(_check_weights, job, posed, rigged, rest, own, weights, heads))
    rig = None
    if rigs:
        motion = _motion(posed, pair.target, rest)
        rig = _take_back(rigs, motion)
        rest = Rest(transform_points(motion, rest.positions), motion[:3, :3] @ rest.linear, rest.smoothed)
        if keys is not None:
            keys.turn(motion[:3, :3])
    shape = "keep_shape" if keeps_shape else "rest_pose"
    return Bound(shape, pair.target.vertices, rest, (*notes, *of_check), stretched, rig, corrected)


def _notes_on_rest(target: str, bend: float | None, rest: Rest) -> list[Message]:
    """Notes on the rest pose of a target, by its name, whose bones were rotated by `bend` degrees; None if kept."""
    notes = []
    if bend is not None:
        notes.append(
            message(
                "'{target}' was in a different pose, with its bones rotated by {angle:.0f}° on average, "
                "and was moved to Rest Position. Its shape key '{key}' keeps the original shape. If it was at rest, "
                "bind it with Target Pose set to At Rest.",
                target=target,
                angle=bend,
                key=POSED_SHAPE,
            )
        )
    if rest.smoothed:
        notes.append(
            plural(
                rest.smoothed,
                "Rest pose: 1 vertex was moved with its neighbors, to avoid a tear.",
                "Rest pose: {count:,} vertices were moved with their neighbors, to avoid tears.",
            )
        )
    return notes


def _find_pose(job: TransferJob, rigged: Rigged) -> tuple[PosedTarget, stored_match.Match]:
    """The pose of a target, and the match that the bones correct unless it is probably wrong."""
    mapped = map_target(job.match, job.pair.source, job.pair.target, job.settings.fill_below)
    with stage("Finding the pose", 0, FOUND):
        posed = find_pose(mapped, rigged.rest, rigged.weights, rigged.bones.parents)
        corrected = mapped if stored_match.is_wrong(job.match) else correct_map(mapped, posed, rigged.weights)
    if corrected is mapped:
        return posed, job.match
    return posed, stored_match.along(job.match, corrected.surface_map, corrected.confidence)


def _transfer_weights(job: TransferJob, posed: PosedTarget, weights: WeightAdapter) -> TransferJob:
    """Transfer weights along the map to the source at rest; returns the transfer along that map."""
    in_pose = stored_match.StoredMatch(
        posed.mapped.surface_map, posed.mapped.confidence, (), has_partner=job.match.has_partner
    )
    job = job.along(in_pose)
    with portion(READING, TAKING):
        weights.transfer(job)
    return job


def _at_rest(target: zo.Surface, posed: PosedTarget, weights: csr_array, rigged: Rigged) -> Rest:
    """The rest pose of the target."""
    transforms = posed.pose.transforms
    matrices = skinning_matrices(transforms, weights, preserve_volume=rigged.preserves_volume)
    return unpose(target, matrices, posed.pose.scale, posed.mapped.confidence)


async def _move_rigs(
    context: Context, pair: ObjectPair, posed: PosedTarget, rigged: Rigged, rest: Rest
) -> tuple[list[_NamedBones], list[Message]]:
    """The source's armature, and its metarig if it has one, in the target at rest; and notes on them."""
    (armature,) = mesh_data.armatures_of(find_mesh(context, pair.source_name))
    rigs = [armature, *filter(None, [mesh_data.metarig_of(context, armature)])]
    named = [_NamedBones(each.name, mesh_data.read_rig_bones(each)) for each in rigs]
    notes = note_on_constraints(armature)
    with stage("Moving the rig", CHECKING, MOVED):
        at_rest = pair.target.with_vertices(rest.positions)
        move = partial(move_bones, mapped=posed.mapped, rest=rigged.rest, target=at_rest)
        return [replace(each, bones=await compute(partial(move, each.bones))) for each in named], notes


def move_bones(bones: RigBones, mapped: MappedTarget, rest: zo.Surface, target: zo.Surface) -> RigBones:
    """The bones of a rig inside a source, moved into a mapped target in the same pose, in world space."""
    joints, parents = joints_of_bones(bones.heads, bones.tails, bones.parents)
    moved = zo.move_rig(mapped, rest, target, joints, parents)
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


def _take_back(rigs: list[_NamedBones], motion: Floats) -> MovedRig:
    """An armature, and its metarig if given, after a motion (4, 4) of the target at rest."""
    moved = []
    for name, bones in ((each.name, each.bones) for each in rigs):
        heads, tails = (transform_points(motion, points) for points in (bones.heads, bones.tails))
        bones = replace(bones, heads=heads, tails=tails, upright=bones.upright @ motion[:3, :3].T)
        moved.append(MovedRig(name, bones, motion))
    return replace(moved[0], metarig=moved[1] if len(moved) > 1 else None)


def note_on_constraints(armature: Object) -> list[Message]:
    """A warning about constraints that depend on the rest position of the original."""
    names = mesh_data.child_of_constraints(armature)
    if not names:
        return []
    return [
        plural_warning(
            len(names),
            "The Child Of constraint of '{bone}' has the inverse of the old rest position: use Set Inverse on the "
            "copy.",
            "Child Of constraints of {count} bones, such as '{bone}', have the inverse of the old rest position: use "
            "Set Inverse on the copy.",
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
    """Rotate the bones to extremes, play their animation, and smooth weights that would tear the target.

    If the target's bones are moved, they rotate about other heads (b, 3).

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
            plural(
                int(checked.smoothed.sum()),
                "The weights of 1 vertex would have torn the mesh when bones rotate, and were smoothed.",
                "The weights of {count:,} vertices would have torn the mesh when bones rotate, and were smoothed.",
            )
        )
    if checked.stretched.any():
        notes.append(
            plural_warning(
                int(checked.stretched.sum()),
                "1 vertex stretches far more than on the source when bones rotate: Select Stretched shows it.",
                "{count:,} vertices stretch far more than on the source when bones rotate: Select Stretched shows "
                "them.",
            )
        )
    return checked.stretched, tuple(notes)
