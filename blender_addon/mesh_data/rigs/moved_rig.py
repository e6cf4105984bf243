# SPDX-License-Identifier: GPL-3.0-or-later
"""Copies of an armature whose bones are at other places, with everything that makes it a rig.

Constraints, drivers, custom shapes, bone collections, locks and the action are copied; what refers to the armature
refers to the copy. Poses, the action included, are relative to the new rest position.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from bpy.types import ArmatureEditBones, Constraint, Context, KinematicConstraint, Object, PoseBone
from mathutils import Matrix, Vector

import zoomout_core as zo
from zoomout_core.arrays import Floats, Integers

from ..matrices import transform_points, world_matrix
from .armatures import ROUNDING
from .outfit_bones import edit_bones

# The lengths in constraints that fit the rest position, by type, and those that are in the unit of the world.
LENGTHS = {"STRETCH_TO": "rest_length", "LIMIT_DISTANCE": "distance"}
IN_WORLD = ("LIMIT_DISTANCE",)


# Angles in degrees: above the first, constraints visibly turn a bone at rest; below the second, a bone is at rest.
MAX_TURN, STILL = 5.0, 0.5


@dataclass(frozen=True, eq=False)
class RigBones:
    """All bones of an armature at rest, in world space.

    Attributes:
        names: (b,) their names.
        parents: (b,) the number of each bone's parent, -1 for none.
        heads: (b, 3) where they begin.
        tails: (b, 3) where they end.
        upright: (b, 3) their z axes, which determine their rolls.
    """

    names: tuple[str, ...]
    parents: Integers
    heads: Floats
    tails: Floats
    upright: Floats


def read_rig_bones(armature: Object) -> RigBones:
    """Read all bones of an armature."""
    bones, world = list(armature.data.bones), world_matrix(armature)
    number = {bone.name: each for each, bone in enumerate(bones)}
    parents = np.array([-1 if bone.parent is None else number[bone.parent.name] for bone in bones], dtype=np.int64)
    heads, tails = (
        transform_points(world, np.array([getattr(bone, end) for bone in bones], np.float64).reshape(-1, 3))
        for end in ("head_local", "tail_local")
    )
    upright = np.array([bone.matrix_local.col[2][:3] for bone in bones], np.float64).reshape(-1, 3)
    return RigBones(tuple(number), parents, heads, tails, upright @ world[:3, :3].T)


def copy_rig(context: Context, armature: Object, beside: Object, bones: RigBones, motion: Floats) -> Object:
    """Copy an armature with its bones at other places.

    Args:
        context: Blender's, in Object Mode.
        armature: the armature.
        beside: an object whose name the copy's name contains, and whose collections it is in.
        bones: all bones in their new places, in world space.
        motion: (4, 4) the similarity from the place of the armature to that of the copy.

    Raises:
        MeshError: constraints or drivers determine the place of the copy; `all_or_nothing` removes it.
    """
    made = armature.copy()
    made.data = armature.data.copy()
    made.name = made.data.name = f"{armature.name} {beside.name}"
    made.hide_viewport = False  # a disabled one is not evaluated, and its place could not be checked
    for collection in beside.users_collection:
        collection.objects.link(made)
    wanted = motion @ world_matrix(armature)
    made.matrix_world = Matrix(wanted.tolist())
    _redirect(armature, made)
    context.view_layer.update()
    if (np.abs(world_matrix(made) - wanted) > ROUNDING * np.abs(wanted).max()).any():
        raise zo.MeshError(
            "Constraints, drivers or a sheared parent determine the transform of '{armature}', so a copy of it cannot "
            "be placed at the target: remove them.",
            armature=armature.name,
        )
    poles = list(_poles(armature))
    with edit_bones(context, made) as edited:
        before = {bone.name: bone.matrix.copy() for bone in edited}
        ends = {bone.name: (bone.head.copy(), bone.tail.copy()) for bone in edited}
        _place(edited, bones, np.linalg.inv(wanted))
        for pole in poles:
            _place_pole(edited, pole, before, ends)
    for bone in made.pose.bones:
        for constraint in bone.constraints:
            _adjust_length(armature, made, bone.name, constraint)
    context.view_layer.update()
    return made


def child_of_constraints(armature: Object) -> tuple[str, ...]:
    """The names of bones with *Child Of* constraints whose inverse was set in the present rest position."""
    return tuple(
        bone.name
        for bone in armature.pose.bones
        if any(each.type == "CHILD_OF" and each.inverse_matrix != Matrix() for each in bone.constraints)
    )


def bends_at_rest(armature: Object, made: Object) -> dict[str, float]:
    """The deforming bones of a copy that constraints rotate at rest, unlike on the original, in degrees.

    Bones that are rotated on the original at present are ignored.
    """
    before, after = (
        {bone.name: _turn(bone) for bone in each.pose.bones if bone.bone.use_deform} for each in (armature, made)
    )
    return {name: angle for name, angle in after.items() if angle > MAX_TURN and before[name] < STILL}


def _turn(bone: PoseBone) -> float:
    """The angle between a bone and its rest position, in degrees."""
    turn = bone.bone.matrix_local.to_quaternion().rotation_difference(bone.matrix.to_quaternion())
    return float(np.degrees(abs(turn.angle)))


def _place(edited: ArmatureEditBones, bones: RigBones, to_local: Floats) -> None:
    """Place edit bones; rolls are set last, because they depend on the ends."""
    heads, tails = (transform_points(to_local, each) for each in (bones.heads, bones.tails))
    upright = bones.upright @ to_local[:3, :3].T
    for number, name in enumerate(bones.names):
        edited[name].head, edited[name].tail = Vector(heads[number]), Vector(tails[number])
    for number, name in enumerate(bones.names):
        edited[name].align_roll(Vector(upright[number]))


@dataclass(frozen=True)
class _Pole:
    """The pole target of a chain of inverse kinematics, by names of bones."""

    target: str
    first: str
    last: str


def _poles(armature: Object) -> Iterator[_Pole]:
    """The pole targets of an armature that are bones of it."""
    for bone in armature.pose.bones:
        for constraint in bone.constraints:
            if isinstance(constraint, KinematicConstraint) and constraint.pole_target == armature:
                above = [bone, *bone.parent_recursive]
                chained = above[: constraint.chain_count or None]
                if constraint.pole_subtarget in armature.data.bones:
                    yield _Pole(constraint.pole_subtarget, chained[-1].name, bone.name)


def _place_pole(
    edited: ArmatureEditBones, pole: _Pole, before: dict[str, Matrix], ends: dict[str, tuple[Vector, Vector]]
) -> None:
    """Place a pole target where the first bone of its chain sees it as before, so that the pole angle still fits."""
    first, last, target = (edited[name] for name in (pole.first, pole.last, pole.target))
    then = _frame(ends[pole.first][0], ends[pole.last][1], before[pole.first].col[0].xyz)
    now = _frame(first.head, last.tail, first.matrix.col[0].xyz)
    motion = now @ then.inverted_safe()
    moved = [motion @ end for end in ends[pole.target]]
    shift = moved[0] - target.head
    target.head, target.tail = target.head + shift, target.tail + shift


def _frame(start: Vector, end: Vector, side: Vector) -> Matrix:
    """A frame at the start of a chain, of its length, along it and to one side."""
    along = end - start
    across = (side - side.project(along)).normalized() * along.length
    rows = Matrix((along, across, along.normalized().cross(across))).transposed().to_4x4()
    rows.translation = start
    return rows


def _constraints(armature: Object) -> Iterator[Constraint]:
    """The constraints of an armature and of its bones."""
    yield from chain(armature.constraints, *(bone.constraints for bone in armature.pose.bones))


def _adjust_length(armature: Object, made: Object, name: str, constraint: Constraint) -> None:
    """Scale the length in a constraint of a copy's bone with the distance at rest from the bone that it refers to."""
    if constraint.type not in LENGTHS or constraint.target != made:
        return
    before, after = (_distance(each, name, constraint) for each in (armature, made))
    if before > 0:
        of_object = made.matrix_world.median_scale / armature.matrix_world.median_scale
        growth = after / before * (of_object if constraint.type in IN_WORLD else 1)
        setattr(constraint, LENGTHS[constraint.type], growth * getattr(constraint, LENGTHS[constraint.type]))


def _distance(armature: Object, name: str, constraint: Constraint) -> float:
    """The distance at rest from a bone to the one that its constraint refers to, in the armature's space; 0 without."""
    bone, goal = armature.data.bones[name], armature.data.bones.get(constraint.subtarget)
    if goal is None:
        return 0.0
    return (goal.head_local.lerp(goal.tail_local, constraint.head_tail) - bone.head_local).length


def _redirect(armature: Object, made: Object) -> None:
    """Make a copy's constraints and drivers refer to the copy, where the original's refer to the original."""
    for constraint in _constraints(made):
        for holder in (constraint, *getattr(constraint, "targets", ())):
            for name in ("target", "pole_target"):
                if getattr(holder, name, None) == armature:
                    setattr(holder, name, made)
    copies: dict[Any, Any] = {armature: made, armature.data: made.data}
    for owner in (made, made.data):
        for driver in owner.animation_data.drivers if owner.animation_data else ():
            for variable in driver.driver.variables:
                for target in variable.targets:
                    if target.id in copies:
                        target.id = copies[target.id]
