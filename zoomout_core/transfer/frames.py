# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotation and growth from a source to a target around each vertex, by a map between them.

The rotation is the nearest one to the mean differential of the map over a neighbourhood. The mean depends only on the
images along the border of the neighbourhood, so that the noise of a map cancels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, diags_array
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Booleans, Floats, Integers, segment_sum
from zoomout_core.geometry.gradients import products_of_gradients, without_sums
from zoomout_core.geometry.procrustes import fit_neighbourhoods, nearest_rotations, products
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.mesh.triangles import vertex_areas
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.once import once_per_argument
from zoomout_core.spectral.laplacian import mesh_laplacian
from zoomout_core.transfer.attribute import Domain
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class FrameTuning(Tuning, set_by="transfer"):
    """The widths of the neighbourhoods over which the differential of a map is averaged.

    Attributes:
        smoothing_length: width of the neighbourhoods, about a wrist. With half or twice the width, errors of keys on
            posed characters grow by a fifth to a quarter: noise remains, or bones are mixed.
        growth_rounds: rounds of averaging for the growth, which make it a mean over neighbourhoods twice as wide. A
            bend stretches the skin on one side and compresses it on the other, although the flesh does not grow.
        excess: if a map deviates from the similarity of a wide neighbourhood by more than this multiple of its
            deviation from those of narrow ones, `steady_turns` ignores the wide neighbourhood.
        deviation: the same as a share of the size of the neighbourhood. Both were set on heads (`faces`) and posed
            bodies.
        same_direction: rotation between two shapes up to which they face the same way, see `without_small_turn`. Shapes
            of heads that do differ by .5 to 9.2 degrees.
        same_size: ratio of sizes up to which two shapes are of similar size, see `Frames.other_person`. Those of 66
            pairs of persons' heads differ by a factor of 1.18 at most.
        same_shape: deviation of a map from a similarity, as a share of the size, up to which the target is a copy of
            the source. It is at most .006 on retopologised copies of heads, and at least .05 on heads of other persons.
    """

    smoothing_length: float = tuned(0.02, "at unit area", 1e-6, 1)
    growth_rounds: int = tuned(4, "rounds", 0, 100)
    excess: float = tuned(1.5, "1", 0.1, 10)
    deviation: float = tuned(0.2, "1", 1e-6, 1)
    same_direction: float = tuned(12.0, "degrees", 0, 90)
    same_size: float = tuned(1.2, "1", 1, 10)
    same_shape: float = tuned(0.02, "1", 1e-6, 1)


FRAMES = FrameTuning()
# Ratio of the widths of wide and of narrow neighbourhoods: about a forearm.
WIDE = 4
# Minimum confidence for full trust in a map; below it, trust decreases in proportion.
FULL_CONFIDENCE = 0.5
# Minimum trust: positive, so that parts without confidence are still placed.
MIN_TRUST = 1e-6
# Weight of untrusted edges: enough to fill in missing parts, too little to affect their surroundings.
DOUBTED_WEIGHT = 1e-3
# Maximum growth of the target at a place relative to the mean, and by its inverse the minimum; beyond it is noise.
MAX_RELATIVE_GROWTH = 4.0
# Each limit is followed by a gradual transition. These are the multiples of the limits at which it ends: of the angle
# between shapes that face the same way, of the logarithm of the ratio of similar sizes, and of the deviation of a copy.
OTHER_DIRECTION = OTHER_SIZE = 1.5
OTHER_SHAPE = 2.0
# A wide neighbourhood counts in full up to this share of the deviation above which it is ignored.
FULL_SHARE = 2 / 3


@dataclass(frozen=True, eq=False)
class Frames:
    """Rotation and growth from the source to n vertices of the target's working mesh."""

    mapped: MappedTarget  # the target, mapped over the source
    number: Integers  # (n,) the vertices of the working mesh
    stiffness: csc_array  # (n, n) stiffness of the edges between them
    areas: Floats  # (n,) areas of the vertices, as shares of the whole area
    points: Floats  # (n_w, 3) positions of all vertices of the working mesh on the source
    confidence: Floats  # (n,) confidence of the map
    is_face: bool = False  # whether the vertices are on a head, which has no joints

    @cached_property
    def trust(self) -> Floats:
        """(n,) trust in the map, above zero."""
        return np.clip(self.confidence / FULL_CONFIDENCE, MIN_TRUST, 1)

    @cached_property
    def trusted_stiffness(self) -> csc_array:
        """(n, n) stiffness with edges weighted by the trust in their ends, which ignores errors elsewhere."""
        trust = diags_array(self.trust)
        return without_sums(trust @ self.stiffness @ trust)

    @cached_property
    def doubted_stiffness(self) -> csc_array:
        """(n, n) the remaining stiffness, of edges without trust, which fills in values."""
        return DOUBTED_WEIGHT * (self.stiffness - self.trusted_stiffness)

    @cached_property
    def rotations(self) -> Floats:
        """(n, 3, 3) rotations of vectors from the source to the target; reflections where the map mirrors."""
        normals = self._handedness[:, None] * self.mapped.target.working.vertex_normals[self.number]
        upright = normals[:, :, None] * self._mapped_normals[:, None, :] / self.mapped.source.area
        fitted = self.smoothing.solve((self._differential + upright).reshape(-1, 9))
        return nearest_rotations(fitted.reshape(-1, 3, 3), self._handedness)

    @cached_property
    def turns(self) -> Floats:
        """(n, 3, 3) matrices that rotate and scale vectors from the source to the target."""
        working = self.mapped.target.working
        vertices = working.vertices[self.number]
        # A length of the target shrinks to this share on the source, in each of two directions.
        whole = np.einsum("nxx->n", products_of_gradients(self.trusted_stiffness, vertices, vertices))
        shrinking = np.einsum("nts,nts->n", self.rotations, self._differential)
        sums = np.stack([shrinking, whole], axis=1)
        for _ in range(FRAMES.growth_rounds):
            sums = self.smoothing.weights[:, None] * self.smoothing.solve(sums)
        shrinking, whole = sums.T
        shrinking = np.maximum(shrinking, whole / MAX_RELATIVE_GROWTH)
        growth = np.divide(whole, shrinking, out=np.ones_like(whole), where=shrinking > 0)
        growth = np.maximum(growth, 1 / MAX_RELATIVE_GROWTH)
        return (working.scale / np.sqrt(self.mapped.source.area) * growth)[:, None, None] * self.rotations

    @cached_property
    def steady_turns(self) -> Floats:
        """(n, 3, 3) `turns`, or those of wider neighbourhoods where the map deviates from these by noise only.

        On another head, the differential of a map varies with the map's errors and the shapes of features, which must
        not rotate expressions. In another pose, it varies across joints and hardly within a bone. So the best
        similarity of a wide neighbourhood is used where the map deviates little from it, and hardly more than from
        those of narrow neighbourhoods. Where the same holds for the similarity of all vertices, that one is used,
        without a small rotation. Parts that are smaller than a wide neighbourhood, such as eyelashes, rotate with what
        is beside them.

        A face has no joints, so neighbourhoods rotate by the shapes of features only. If it faces the way of the
        source's face, the rotation of all vertices is therefore used everywhere. If the heads are rotated against each
        other, that rotation is no better: it is uncertain by some degrees.
        """
        size = np.sqrt(self.mapped.source.area) / self.mapped.target.working.scale
        moments, side = self._moments, self._handedness
        wide = ScreenedSmoothing.of(self.smoothing.weights, self.stiffness, WIDE * FRAMES.smoothing_length)
        _, deviation = fit_neighbourhoods(self.smoothing.smooth(moments), side)
        noise = wide.smooth(deviation[:, None])[:, 0]

        blend, share = size * self.turns, np.ones(len(side))
        around, deviation = fit_neighbourhoods(wide.smooth(moments), side)
        whole, deviation_of_whole = self._whole
        large_turn, kept = without_small_turn(whole[0])
        for linear, sides, missed in (
            (around, side, deviation),
            (large_turn[None], self._side_of_most, deviation_of_whole),
        ):
            share = share * (side == sides) * _fitting(missed, noise)
            blend = blend + share[:, None, None] * (linear - blend)
        lengths = np.linalg.norm(blend, axis=(1, 2)) / np.sqrt(3)
        if self.is_face:
            share = (side == self._side_of_most) * (1 - kept)
            blend = blend + share[:, None, None] * (large_turn - blend)
        lengths = np.clip(lengths, 1 / MAX_RELATIVE_GROWTH, MAX_RELATIVE_GROWTH)
        turns = lengths[:, None, None] / size * nearest_rotations(blend, side)
        return np.asarray(turns[self._beside])

    @cached_property
    def _beside(self) -> Integers:
        """(n,) the nearest vertex of a large part to each vertex of a small one, and otherwise the vertex itself."""
        working = self.mapped.target.working
        area = np.bincount(working.component, vertex_areas(working.vertices, working.triangles))
        is_small = area[working.component[self.number]] < np.pi * (WIDE * FRAMES.smoothing_length) ** 2
        large, small = np.flatnonzero(~is_small), np.flatnonzero(is_small)
        beside = np.arange(len(self.number))
        if len(large) and len(small):
            places = working.vertices[self.number]
            beside[small] = large[cKDTree(places[large]).query(places[small])[1]]
        return beside

    @property
    def growth(self) -> float:
        """How much larger the target is than the source, in their units."""
        size = np.sqrt(self.mapped.source.area) / self.mapped.target.working.scale
        growth = np.cbrt(abs(np.linalg.det(self._whole[0][0]))) / size
        return float(np.clip(growth, 1 / MAX_RELATIVE_GROWTH, MAX_RELATIVE_GROWTH))

    @property
    def other_person(self) -> float:
        """Degree, in [0, 1], to which source and target seem to be two persons, whose expressions are equally long.

        Head models add the same offsets to small and large heads (Blanz and Vetter, A morphable model for the synthesis
        of 3D faces, 1999; Li et al., Learning a model of facial shape and expression from 4D scans, 2017). But an
        enlarged copy of a head needs longer offsets to close its eyes. A head of a very different size is in another
        unit, or belongs to a creature.
        """
        differs = (self._whole[1][0] / FRAMES.same_shape - 1) / (OTHER_SHAPE - 1)
        similar = (OTHER_SIZE - abs(np.log(self.growth)) / np.log(FRAMES.same_size)) / (OTHER_SIZE - 1)
        return float(np.clip(differs, 0, 1) * np.clip(similar, 0, 1))

    @cached_property
    def _moments(self) -> Floats:
        """(n, 18) see `fit_neighbourhoods`; both surfaces are of unit area."""
        own = self.mapped.target.working.vertices[self.number]
        images = self.points[self.number] / np.sqrt(self.mapped.source.area)
        return np.column_stack([products(images, own), (own**2).sum(axis=1), np.ones(len(own))])

    @cached_property
    def _whole(self) -> tuple[Floats, Floats]:
        """(1, 3, 3) the best similarity of all vertices, and (1,) the map's deviation from it."""
        return fit_neighbourhoods(self.smoothing.weights[None] @ self._moments, self._side_of_most)

    @cached_property
    def _side_of_most(self) -> Floats:
        """(1,) -1 if most of the target is mapped as a mirror image, else 1."""
        return np.array([1.0 if self.smoothing.weights @ self._handedness >= 0 else -1.0])

    @cached_property
    def _differential(self) -> Floats:
        """(n, 3, 3) integrals of products of gradients, of the target's positions and of those on the source.

        Both surfaces are of unit area.
        """
        images = self.points[self.number] / np.sqrt(self.mapped.source.area)
        return products_of_gradients(self.trusted_stiffness, self.mapped.target.working.vertices[self.number], images)

    @cached_property
    def _mapped_normals(self) -> Floats:
        """(n, 3) a third of the area normals of the triangles around each vertex, mapped onto the source.

        Triangles are weighted by the trust in their corners.
        """
        triangles, count = self.mapped.target.working.oriented_triangles, len(self.points)
        trust = np.zeros(count)
        trust[self.number] = self.trust
        a, b, c = (self.points[triangles[:, i]] for i in range(3))
        weighted = np.repeat(trust[triangles].min(axis=1, keepdims=True) / 6 * np.cross(b - a, c - a), 3, axis=0)
        return segment_sum(weighted, triangles.ravel(), count)[self.number]

    @cached_property
    def _handedness(self) -> Floats:
        """(n,) -1 where a component is mapped as a mirror image, else 1.

        Components without an outside, such as lashes, take the value of most others.
        """
        source, target = self.mapped.source.working, self.mapped.target.working
        normals = source.component_sides_are_known[source.component, None] * source.vertex_normals
        outward = on_working_mesh(target, self.mapped.surface_map.interpolate(normals[source.vertex_of]))[self.number]
        component = target.component[self.number]
        facing = np.bincount(component, np.einsum("nx,nx->n", outward, self._mapped_normals))
        facing *= target.component_sides_are_known[: len(facing)]
        facing[facing == 0] = facing.sum()
        return np.where(facing < 0, -1.0, 1.0)[component]

    def nearest(self, positions: Floats) -> Integers:
        """(q,) the vertex, of n, nearest to each position (q, 3) around the target."""
        own = on_working_mesh(self.mapped.target.working, self.mapped.target.vertices)[self.number]
        return np.asarray(cKDTree(own).query(positions)[1])

    @cached_property
    def smoothing(self) -> ScreenedSmoothing:
        """The system T A + h^2 (L' + L") of trust, areas, the smoothing length and both stiffnesses."""
        stiffness = self.trusted_stiffness + self.doubted_stiffness
        return ScreenedSmoothing.of(self.trust * self.areas, stiffness, FRAMES.smoothing_length)


def without_small_turn(linear: Floats) -> tuple[Floats, float]:
    """Remove the rotation from a similarity's linear part (3, 3) if it is small.

    Two characters stand upright and face forward in their files. Still, the best similarity between their shapes
    rotates by some degrees, because foreheads recede and necks bend. It would rotate the directions of all expressions,
    too.

    Returns the linear part (3, 3), and the share of the rotation, in [0, 1], that it keeps.
    """
    scale = np.cbrt(np.linalg.det(linear))
    if scale <= 0:  # a mirror image
        return linear, 1.0
    rotation = Rotation.from_matrix(linear / scale)
    angle = np.degrees(rotation.magnitude())
    kept = float(np.clip((angle / FRAMES.same_direction - 1) / (OTHER_DIRECTION - 1), 0, 1))
    return np.asarray(scale * Rotation.from_rotvec(kept * rotation.as_rotvec()).as_matrix()), kept


def _fitting(deviation: Floats, noise: Floats) -> Floats:
    """(n,) weights in [0, 1] of wide neighbourhoods, by their deviations (n,) or (1,) and those of narrow ones (n,)."""
    limit = np.minimum(FRAMES.excess * noise, FRAMES.deviation)
    excess = np.divide(deviation, limit, out=np.ones_like(limit), where=limit > 0)
    return np.asarray(np.clip((1 - excess) / (1 - FULL_SHARE), 0, 1))


@once_per_argument
def frames_of(mapped: MappedTarget) -> Frames:
    """Frames at all vertices of the target."""
    return frames_on(mapped, np.ones(len(mapped.target.vertices), dtype=bool))


def frames_on(mapped: MappedTarget, vertices: Booleans, is_face: bool = False) -> Frames:
    """Frames at some vertices (n_t,) of the target, and at the neighbours of these."""
    working = mapped.target.working
    stiffness, areas = mesh_laplacian(working.vertices, working.triangles)
    chosen = on_working_mesh(working, vertices)
    number = np.flatnonzero(chosen | (abs(stiffness) @ chosen > 0))
    among = without_sums(stiffness[number][:, number])
    confidence = on_working_mesh(working, mapped.confidence)[number]
    return Frames(mapped, number, among, areas[number], on_working_mesh(working, mapped.points), confidence, is_face)


def rotations(mapped: MappedTarget, domain: Domain) -> Floats:
    """(count, 3, 3) rotations of directions from the source to the target, at points, faces or corners.

    They are reflections where the map mirrors the source.
    """
    target, frames = mapped.target, frames_of(mapped)
    place = target.working.vertex_of.copy()
    loose = np.flatnonzero(place < 0)
    if len(loose):
        place[loose] = frames.nearest(target.vertices[loose])
    if domain is Domain.POINT:
        return frames.rotations[place]
    at_corners = frames.rotations[place[target.corner_vertex]]
    if domain is Domain.CORNER:
        return at_corners
    first = target.face_start[:-1]
    return nearest_rotations(np.add.reduceat(at_corners, first), np.linalg.det(at_corners[first]))


def on_working_mesh(working: WorkingMesh, values: NDArray[Any]) -> NDArray[Any]:
    """(n_w, ...) values at the vertices of a working mesh, from those (n, ...) of its surface.

    The first of several welded vertices counts.
    """
    used = np.flatnonzero(working.vertex_of >= 0)[::-1]
    first = np.empty(len(working.vertices), dtype=np.int64)
    first[working.vertex_of[used]] = used
    return values[first]
