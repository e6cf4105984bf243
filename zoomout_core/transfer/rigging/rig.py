# SPDX-License-Identifier: GPL-3.0-or-later
"""Move the joints of a rig into a body of another build.

Each joint first moves with the surface around it, weighted by area and the inverse cube of the distance. Near the
middle of a body, this takes the whole cross-section into account instead of one patch of skin. A joint deep inside is
known less precisely than one below the skin, so the final positions solve a least squares problem: joints stay near
their places, weighted by the inverse square of their depth; a joint between two bones keeps its place between their
other ends (differential coordinates: Lipman et al., Differential coordinates for interactive mesh editing, 2004), which
preserves ratios of lengths and the plane in which a chain bends; and bones keep their directions. If the rig is
symmetric, and so is the target's surface or the result, the result is made exactly symmetric. This halves errors of the
map on one side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, diags_array, eye_array, vstack
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.procrustes import SMALLEST, Similarities, nearest_rotations, procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.shapes import ShapeLike, as_placed_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import Message, plural
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.transfer.dressing.dress import shape_of_source
from zoomout_core.transfer.rigging.joints import MovedJoints, finite_joints
from zoomout_core.transfer.rigging.symmetric_joints import make_symmetric
from zoomout_core.transfer.rules import Match, map_target
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class RigTuning(Tuning, set_by="rigs"):
    """The joints of a rig in another body.

    Attributes:
        between: weight of a joint's place between its neighbours, times the product of its distances from them,
            relative to the weight of its own place, times the square of its depth.
        along: weight of a bone's direction and length, times the square of its length, relative to the same.
        shallow: the depth of joints closer to the surface than this.
        falloff: power of the distance from a joint by which the weight of the surface around it falls.
        coarse: number of vertices below which a target is too coarse for the source to take its shape. Joints then
            follow the images of the target's vertices.
    """

    between: float = tuned(16.0, "1", 0, 1e6)
    along: float = tuned(1.0, "1", 0, 1e6)
    shallow: float = tuned(0.001, "at unit area", 1e-6, 1)
    falloff: float = tuned(3.0, "1", 1, 12)
    coarse: float = tuned(0.5, "of the source's vertices", 0, 1)


RIG = RigTuning()

# Joints closer to each other than this, relative to the largest coordinate, are one joint: rounding of single floats.
SAME_PLACE = 1e-5
# Weight of the surface's rotation, for joints whose bones determine only some axes of their rotation. It decides the
# roll of a bone, and hardly changes its direction.
ROLL = 1e-3
# A bone is along a longer bone if its ends are within the first number of it, relative to the bone's own length, and
# the other is at least the second number times as long.
ON_BONE, LONGER = 0.01, 1.01


class Deformation(NamedTuple):
    """A source's surface in the shape of the target, which joints follow."""

    before: Floats  # (n, 3) points of the source's surface
    after: Floats  # (n, 3) the corresponding points of the target's
    areas: Floats  # (n,) the area around each point
    unit: float  # the square root of the source's area
    target: Surface  # the target itself, whose symmetry does not depend on the map


@on_one_blas_thread
def move_rig(
    result: Match | SurfaceMap, source: ShapeLike, target: ShapeLike, joints: ArrayLike, parents: ArrayLike
) -> MovedJoints:
    """Move the joints of the source's rig into the target.

    Args:
        result: the match, or only its map.
        source: the surface that the rig belongs to, in its rest pose.
        target: the surface that receives the rig, in the same pose.
        joints: (j, 3) joints of the source; those at the same place stay together.
        parents: (j,) the number of each joint's parent, -1 for none.

    Returns:
        Positions of the joints in the target, and rotations of the bones that begin there. They rotate bones to their
        new directions, with a roll that follows the surface.

    Raises:
        MeshError: the map is of other surfaces, or nothing corresponds.
        ValueError: joints are not finite, or parents are no joints or form a cycle.

    Example:
        >>> moved = zo.move_rig(result, source, target, [[0, 0, 0.1], [0, 0, 0.3]], [-1, 0])
        >>> moved.positions.shape, moved.rotations.shape
        ((2, 3), (2, 3, 3))
    """
    source, target = as_placed_surface(source), as_placed_surface(target)
    places, above = check_joints(joints, parents)
    unit = float(np.sqrt(source.area))
    if len(target.vertices) < RIG.coarse * len(source.vertices):
        images = map_target(result, source, target).points
        deformation = Deformation(images, target.vertices, target.vertex_areas, unit, target)
    else:
        after = shape_of_source(result, source, target)
        deformation = Deformation(source.vertices, after, source.vertex_areas, unit, target)
    return place_joints(deformation, places, above)


def joints_of_bones(heads: Floats, tails: Floats, parents: Integers) -> tuple[Floats, Integers]:
    """Heads and tails (b, 3) of bones with parents (b,) as joints (2 b, 3), heads first, and the parents of these.

    A head hangs from the tail of the bone above, and a tail from its own head.
    """
    count = len(heads)
    above = np.where(parents < 0, -1, count + parents)
    return np.concatenate([heads, tails]), np.concatenate([above, np.arange(count)])


def follow_longer_bones(
    heads: Floats, tails: Floats, moved_heads: Floats, moved_tails: Floats, rotations: Floats
) -> tuple[Floats, Floats, Floats]:
    """Moved bones (b), in which those along a longer bone still are along it: halves of a limb, twists and controls.

    Short bones would otherwise take other directions than the bone that they copy or follow by constraints.

    Args:
        heads: (b, 3) where bones begin.
        tails: (b, 3) where they end.
        moved_heads: (b, 3) the moved heads.
        moved_tails: (b, 3) the moved tails.
        rotations: (b, 3, 3) rotations of the bones.

    Returns:
        Heads, tails and rotations.
    """
    arms = tails - heads
    lengths = np.maximum(np.linalg.norm(arms, axis=1), SMALLEST)
    found_heads, found_tails, found_rotations = moved_heads.copy(), moved_tails.copy(), rotations.copy()
    for bone in range(len(heads)):
        ends = np.stack([heads[bone], tails[bone]])
        places = np.einsum("ebx,bx->eb", ends[:, None] - heads, arms) / lengths**2
        off = np.linalg.norm(heads + places[:, :, None] * arms - ends[:, None], axis=2)
        inside = (places > -ON_BONE) & (places < 1 + ON_BONE) & (off < ON_BONE * lengths[bone])
        carriers = np.flatnonzero(inside.all(axis=0) & (lengths > LONGER * lengths[bone]))
        if len(carriers):
            carrier = carriers[np.argmax(lengths[carriers])]
            share = places[:, carrier, None]
            moved = moved_heads[carrier] + share * (moved_tails[carrier] - moved_heads[carrier])
            (found_heads[bone], found_tails[bone]), found_rotations[bone] = moved, rotations[carrier]
    return found_heads, found_tails, found_rotations


def note_on_idle_joints(names: Sequence[str], before: csr_array, after: csr_array) -> list[Message]:
    """A note on joints that move a part of the source which the target lacks, such as the legs of a bust.

    Args:
        names: (b,) the names of the joints.
        before: (n_s, b) their weights on the source.
        after: (n_t, b) their weights on the target.
    """
    idle = np.flatnonzero((before.sum(axis=0) > 0) & (after.sum(axis=0) == 0))
    if not len(idle):
        return []
    return [
        plural(
            len(idle),
            "The joint '{joint}' moves nothing, because the target lacks its part: its place is estimated from the "
            "other joints.",
            "{count} of {all} joints, such as '{joint}', move nothing, because the target lacks their part: their "
            "places are estimated from the other joints.",
            all=len(names),
            joint=names[idle[0]],
        )
    ]


def check_joints(joints: ArrayLike, parents: ArrayLike) -> tuple[Floats, Integers]:
    """Joints (j, 3) and their parents (j,) as arrays, see `move_rig`.

    Raises:
        ValueError: they are not finite, or parents are no joints or form a cycle.
    """
    places, given = finite_joints(joints), np.ravel(np.asarray(parents, dtype=object)).tolist()
    number = range(-1, len(places))
    if len(given) != len(places) or not all(parent in number for parent in given):
        raise ValueError(
            f"parents does not fit {len(places)} joints: give for each the number of its parent, or -1 for none."
        )
    above = np.array(given, dtype=np.int64)
    ancestor = above
    for _ in range(len(places)):
        if (ancestor < 0).all():
            return places, above
        ancestor = np.where(ancestor < 0, -1, above[ancestor])
    if len(places):
        raise ValueError("parents form a cycle: give a parent of -1 to the root.")
    return places, above


def place_joints(deformation: Deformation, joints: Floats, parents: Integers) -> MovedJoints:
    """Move joints (j, 3) of the source with parents (j,), -1 for none, along with its surface, see `move_rig`."""
    if not len(joints):
        return MovedJoints(joints, np.empty((0, 3, 3)))
    rounded = np.round(joints / max(SAME_PLACE * np.abs(joints).max(), SMALLEST))
    _, first, number = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    number = number.ravel()
    places = joints[first]
    edges = np.column_stack([number[parents[parents >= 0]], number[parents >= 0]])
    between_places = edges[:, 0] != edges[:, 1]
    edges = np.unique(edges[between_places], axis=0)
    motions = _motions_around(deformation, places)
    depth = np.maximum(cKDTree(deformation.before).query(places)[0], RIG.shallow * deformation.unit)
    found = _solve(places, motions, depth, edges)
    found, rotations = make_symmetric(places, found, motions.rotation, edges, deformation.target)
    return MovedJoints(found[number], align_bones(joints, found[number], parents, rotations[number]))


def _motions_around(deformation: Deformation, places: Floats) -> Similarities:
    """(j,) the similarities of a surface around joints (j, 3)."""
    before, after, areas, unit, _ = deformation
    scale, rotation, translation = np.empty(len(places)), np.empty((len(places), 3, 3)), np.empty_like(places)
    for number, place in enumerate(places):
        squares = np.einsum("nx,nx->n", before - place, before - place) + (RIG.shallow * unit) ** 2
        weights = areas * (squares.min() / squares) ** (RIG.falloff / 2)
        motion = procrustes(before, after, weights)
        scale[number], rotation[number], translation[number] = motion.scale, motion.rotation, motion.translation
    return Similarities(scale, rotation, translation)


def _solve(places: Floats, motions: Similarities, depth: Floats, edges: Integers) -> Floats:
    """(j, 3) positions of joints, by the least squares problem of the module.

    Args:
        places: (j, 3) the joints before.
        motions: (j,) the motions of their surroundings.
        depth: (j,) their distances from the surface.
        edges: (e, 2) bones, from parents to children.
    """
    followed = motions(places[:, None])[:, 0]
    if not len(edges):
        return followed
    joint, before, after = _middles(len(places), edges)
    arms = places[after] - places[before]
    share = np.einsum("mx,mx->m", places[joint] - places[before], arms) / np.einsum("mx,mx->m", arms, arms)
    share = np.clip(share, 0, 1)
    between = _rows(len(places), (joint, 1), (before, share - 1), (after, -share))
    offset = np.einsum("mxy,my->mx", motions.linear[joint], between @ places)
    near = np.linalg.norm(places[joint] - places[before], axis=1) * np.linalg.norm(
        places[joint] - places[after], axis=1
    )
    along = _rows(len(places), (edges[:, 1], 1), (edges[:, 0], -1))
    bones = along @ places
    whole = procrustes(places, followed)
    rows = csr_array(vstack([eye_array(len(places)), between, along]))
    wanted = np.concatenate([followed, offset, bones @ whole.linear.T])
    weights = [depth**-2.0, RIG.between / np.maximum(near, SMALLEST), RIG.along / np.einsum("ex,ex->e", bones, bones)]
    weighted = rows.T @ diags_array(np.concatenate(weights))
    return np.asarray(np.linalg.solve((weighted @ rows).toarray(), weighted @ wanted))


def _rows(count: int, *terms: tuple[Integers, ArrayLike]) -> csr_array:
    """(m, count) sparse rows, the sums of terms with columns (m,) and values (m,)."""
    size = len(terms[0][0])
    values = np.concatenate([np.broadcast_to(value, size) for _, value in terms]).astype(np.float64)
    columns = np.concatenate([column for column, _ in terms])
    return csr_array((values, (np.tile(np.arange(size), len(terms)), columns)), shape=(size, count))


def _middles(count: int, edges: Integers) -> tuple[Integers, Integers, Integers]:
    """Joints in the middle of a chain, the joints before and after them.

    They have one parent, and one child that continues the chain; twist bones that end at once do not count beside it.
    """
    has_child = np.bincount(edges[:, 0], minlength=count) > 0
    continuing = edges[has_child[edges[:, 1]]]
    chosen = np.where(np.bincount(continuing[:, 0], minlength=count) > 0, 1, 0)
    ends = edges[chosen[edges[:, 0]] == 0]
    ahead = np.concatenate([continuing, ends])
    above, below = edges[:, [1, 0]], ahead
    single_above = np.bincount(above[:, 0], minlength=count) == 1
    single_below = np.bincount(below[:, 0], minlength=count) == 1
    before, after = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    before[above[:, 0]], after[below[:, 0]] = above[:, 1], below[:, 1]
    joint = np.flatnonzero(single_above & single_below)
    joint = joint[before[joint] != after[joint]]
    return joint, before[joint], after[joint]


def align_bones(before: Floats, after: Floats, parents: Integers, rotations: Floats) -> Floats:
    """(j, 3, 3) rotations of the bones that begin at joints: best for their directions, else as the surface rotates."""
    child = np.flatnonzero(parents >= 0)
    arm, image = (points[child] - points[parents[child]] for points in (before, after))
    long = np.linalg.norm(arm, axis=1) > 0
    child, arm, image = child[long], arm[long], image[long]
    arm, image = (each / np.maximum(np.linalg.norm(each, axis=1, keepdims=True), SMALLEST) for each in (arm, image))
    covariance = ROLL * rotations
    np.add.at(covariance, parents[child], image[:, :, None] * arm[:, None])
    return nearest_rotations(covariance)
