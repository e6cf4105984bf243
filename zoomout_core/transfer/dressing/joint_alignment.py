# SPDX-License-Identifier: GPL-3.0-or-later
"""Align a body that takes another one's shape with the joints of the other body, if both have bones.

A map may slide along smooth limbs: a knee is then mapped to the thigh, although the skins coincide. The joints show how
far it slides. However, armatures place joints by different conventions. These differ in all directions, whereas a map
slides along bones only. The differences across bones therefore measure the conventions, and slides of this size are
ignored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import vertex_normals
from zoomout_core.transfer.dressing.form import Form
from zoomout_core.transfer.rigging.bone_pairs import Skeleton, pair_bones
from zoomout_core.transfer.rigging.joints import finite_joints, move_joints
from zoomout_core.transfer.rigging.poses import parents_first
from zoomout_core.transfer.rigging.skinning import renumber_bones
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class JointAlignmentTuning(Tuning, set_by="outfits"):
    """How skin follows joints.

    Attributes:
        shortest: minimum length of a bone that slides.
        trust: the part of a slide that exceeds this multiple of the median distance across the bones is corrected.
        smooth: length over which slides are averaged.
        rounds: number of corrections.
        on_skin: maximum distance from the skin of vertices that stay on it; others are within the body.
        facing: the distance equivalent to a unit difference of normals when vertices are projected to the skin.
    """

    shortest: float = tuned(0.02, "at unit area", 1e-6, 1)
    trust: float = tuned(2.0, "1", 0, 100)
    smooth: float = tuned(0.05, "at unit area", 1e-6, 1)
    rounds: int = tuned(2, "rounds", 0, 20)
    on_skin: float = tuned(0.003, "at unit area", 0, 1)
    facing: float = tuned(0.05, "at unit area", 1e-6, 10)


JOINT_ALIGNMENT = JointAlignmentTuning()
# With fewer bones, the median is unreliable.
MIN_BONES = 6


class JointPairs(NamedTuple):
    """Joints that two bodies have in common."""

    before: Floats  # (j, 3) positions in the first body
    after: Floats  # (j, 3) positions in the second one
    parents: Integers  # (j,) the nearest common joint above each; -1 for none
    weights: csr_array  # (n, j) their skin weights in the first body

    @classmethod
    def of(cls, bones: Skeleton, weights: csr_array, others: Skeleton) -> JointPairs:
        """The joints of bones with partners by name. Partners by place would only confirm the map.

        Args:
            bones: the bones of the first body.
            weights: (n, b) its skin weights. Those of a bone without a partner are added to the bone above.
            others: the bones of the second body.
        """
        pairs = pair_bones(bones, others, 0.0)
        numbers = {name: number for number, name in enumerate(others.names)}
        chosen = [number for number, name in enumerate(bones.names) if name in pairs]
        nearest = np.full(len(bones.names), -1)  # at or above each bone
        nearest[chosen] = np.arange(len(chosen))
        for bone in parents_first(bones.parents):
            if nearest[bone] < 0 and bones.parents[bone] >= 0:
                nearest[bone] = nearest[bones.parents[bone]]
        above = bones.parents[chosen]
        return cls(
            bones.heads[chosen],
            others.heads[[numbers[pairs[bones.names[bone]]] for bone in chosen]].reshape(-1, 3),
            np.where(above >= 0, nearest[above], -1),
            renumber_bones(weights, nearest, len(chosen)),
        )


class _Bones(NamedTuple):
    """Bones between joints, and the slides of the skin along them at both ends."""

    head: Integers  # (b,) joints
    tail: Integers  # (b,) joints
    start: Floats  # (b, 3) positions of the heads in the shape
    axis: Floats  # (b, 3) unit vectors
    length: Floats  # (b,)
    slides: Floats  # (b, 2) at the head and at the tail


def align_joints(body: Surface, shape: Floats, skin: Surface, joints: JointPairs) -> Floats:
    """Slide a body's shape over the skin of another one, so that both have the same joints inside.

    Args:
        body: the first body.
        shape: (n, 3) its vertices in the shape of the other one, see `shape_of_source`.
        skin: the other body.
        joints: the joints of both.

    Returns:
        (n, 3) its vertices. Those that were on the skin still are; those without weights do not move.

    Raises:
        ValueError: the shape does not fit the body, or it or joints are not finite.
    """
    finite_joints(joints.after)  # `move_joints` checks the others
    unit = float(np.sqrt(skin.area))
    if not len(_bones(body, shape, joints, unit).head):
        return shape
    weights = csc_array(normalise(joints.weights))
    form = Form.of(body, float(np.sqrt(body.area)))
    smoothing = ScreenedSmoothing.of(form.areas, form.stiffness, JOINT_ALIGNMENT.smooth)
    outwards = np.zeros(len(skin.triangles), dtype=bool)
    surface = OrientedSurface(skin.vertices, skin.triangles, outwards, JOINT_ALIGNMENT.facing * unit)
    on_skin = surface.closest(shape, np.zeros_like(shape))[2] < JOINT_ALIGNMENT.on_skin * unit
    found = shape
    for _ in range(JOINT_ALIGNMENT.rounds):
        slides = _slides(found, weights, _bones(body, found, joints, unit))
        smoothed = smoothing.smooth(slides[form.first])[form.number]
        moved = found + np.where((form.number >= 0)[:, None], smoothed, 0.0)
        found = _project_to_skin(moved, body, surface, skin, on_skin & slides.any(axis=1))
    return found


def _bones(body: Surface, shape: Floats, joints: JointPairs, unit: float) -> _Bones:
    """The bones of a shape that are long enough to be reliable; none if they are too few."""
    places = move_joints(body, shape, joints.before).positions
    tail = np.flatnonzero(joints.parents >= 0)
    head = joints.parents[tail]
    length = np.linalg.norm(places[tail] - places[head], axis=1)
    is_long = length > JOINT_ALIGNMENT.shortest * unit
    if is_long.sum() < MIN_BONES:
        is_long[:] = False
    head, tail, length = head[is_long], tail[is_long], length[is_long]
    axis = (places[tail] - places[head]) / length[:, None]
    off = (joints.after - places)[np.column_stack([head, tail])]  # (b, 2, 3)
    along = np.einsum("bex,bx->be", off, axis)
    across = np.linalg.norm(off - along[:, :, None] * axis[:, None], axis=2)
    tolerance = JOINT_ALIGNMENT.trust * float(np.median(across)) if across.size else 0.0
    # A joint that is off by more than its bone is placed elsewhere in the other armature.
    slides = np.sign(along) * np.clip(np.abs(along) - tolerance, 0, length[:, None])
    return _Bones(head, tail, places[head], axis, length, slides)


def _slides(shape: Floats, weights: csc_array, bones: _Bones) -> Floats:
    """(n, 3) the slide of each vertex, along the nearest bone below each joint that moves it."""
    slides = np.zeros_like(shape)
    for joint in np.unique(bones.head).tolist():
        rows = slice(weights.indptr[joint], weights.indptr[joint + 1])
        vertices = weights.indices[rows]
        below = np.flatnonzero(bones.head == joint)
        offset = shape[vertices, None] - bones.start[below]  # (v, c, 3)
        share = np.clip(np.einsum("vcx,cx->vc", offset, bones.axis[below]) / bones.length[below], 0, 1)
        along = share[:, :, None] * (bones.length[below, None] * bones.axis[below])
        nearest = np.linalg.norm(offset - along, axis=2).argmin(axis=1)
        at, bone = np.take_along_axis(share, nearest[:, None], axis=1)[:, 0], below[nearest]
        slide = (1 - at) * bones.slides[bone, 0] + at * bones.slides[bone, 1]
        slides[vertices] += (weights.data[rows] * slide)[:, None] * bones.axis[bone]
    return slides


def _project_to_skin(
    places: Floats, body: Surface, surface: OrientedSurface, skin: Surface, chosen: Booleans
) -> Floats:
    """(n, 3) positions of a body's vertices, with chosen ones projected to skin that faces the same way."""
    found, normals = places.copy(), vertex_normals(places, body.triangles)
    triangle, barycentric, _ = surface.closest(places[chosen], normals[chosen])
    found[chosen] = np.einsum("qc,qcx->qx", barycentric, skin.vertices[skin.triangles[triangle]])
    return found
