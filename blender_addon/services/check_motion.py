# SPDX-License-Identifier: GPL-3.0-or-later
"""Play the animation of a rig on the source and on the target that it was moved to, and compare the two."""

from __future__ import annotations

from functools import partial

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.runtime.progress import stage
from zoomout_core.transfer.rigging.motion import MotionCheck, PlayedMotion, SkinnedBody, check_motions

from .. import mesh_data
from ..jobs import compute, run
from ..mesh_data.matrices import transform_points, world_matrix
from ..scene.pair import find_mesh, name_of
from ..scene.stored_pair import read_stored_match
from .binding.read import read_rigged, weights_of_bones

# The upward direction of Blender's world.
UP = np.array([0.0, 0.0, 1.0])


def check_motion(context: Context, target: Object) -> MotionCheck:
    """Compare how a target plays the animation of its rig with how its source does, in leg lengths of each.

    Both armatures are played in a temporary scene with all constraints; nothing is changed.

    Args:
        context: Blender's; the target and its source are in its scene.
        target: a matched object that *Move Rig* or *Bind to Rig* has bound.

    Raises:
        MeshError: the target is not matched, not bound to bones like the source's, or nothing animates these.
    """
    return run(check_motion_async(context, name_of(target)))


async def check_motion_async(context: Context, target_name: str) -> MotionCheck:
    """`check_motion` as a coroutine, which keeps no Blender data across an `await`."""
    pair, match = await read_stored_match(context, target_name)
    source, target = find_mesh(context, pair.source_name), find_mesh(context, target_name)
    frames, bones = mesh_data.frames_of_animation(source), mesh_data.read_bones(target)
    if not bones.names or bones.names != mesh_data.read_bones(source).names:
        raise zo.MeshError(
            "'{target}' is not bound to the bones of '{source}': use Move Rig first.",
            target=target_name,
            source=pair.source_name,
        )
    if len(frames) < 2:
        raise zo.MeshError(
            "Nothing animates the armature of '{source}': give it an action first.", source=pair.source_name
        )
    with stage("Playing the rig", 0.1, 0.8):
        rigged = read_rigged(context, pair)
        (armature, *_), (own, *_) = mesh_data.armatures_of(source), mesh_data.armatures_of(target)
        # From the place of the target to that of the source, so that both face the same way.
        motion = world_matrix(armature) @ np.linalg.inv(world_matrix(own))
        positions = mesh_data.positions_in_world(target, mesh_data.read_rest_positions(target.data))
        weights = weights_of_bones([mesh_data.read_weights(target, target.data)], bones)
        poses = np.tile(np.eye(4), (len(frames), len(bones.names), 1, 1))
        poses[:, :, :3] = mesh_data.read_animation(target, frames)
        name = armature.animation_data.action.name if armature.animation_data.action else armature.name
        step = float(np.diff(frames).mean()) * context.scene.render.fps_base / context.scene.render.fps
    moved = (motion @ poses @ np.linalg.inv(motion))[:, :, :3]
    bodies = (
        SkinnedBody(rigged.rest.vertices, rigged.weights, rigged.bones.heads),
        SkinnedBody(transform_points(motion, positions), weights, transform_points(motion, bones.heads)),
    )
    played = [PlayedMotion(name, step, rigged.poses, moved)]
    with stage("Playing the rig", 0.8, 1.0):
        (found,) = await compute(partial(check_motions, *bodies, match.surface_map, bones.parents, UP, played))
    return found
