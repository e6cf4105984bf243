# SPDX-License-Identifier: GPL-3.0-or-later
"""Place regions that a map distorts by their shape, such as a head of other proportions.

Eigenfunctions preserve areas and lengths. Between species whose heads differ in size, they slide the head along its
profile: the forehead of a lion covers the muzzle of a hippopotamus, and its nose the lower jaw. All hypotheses have
this error, because none is closer to an isometry, and a registration does not turn a head by a right angle. But the
residuals of local similarities are large there, and the shapes of both regions alone determine how they fit. So the
region is fitted by a similarity to its surroundings on the source, from many starting poses, by closest points with
compatible normals in both directions. Images around the region do not count, because they slide with it. The best pose
replaces the images of the region if it fits better than the pose of the map. Slender regions stay, because tails bend,
and so do those whose best pose is on another part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Booleans, Floats, Integers, SingleFloats
from zoomout_core.geometry.procrustes import Similarities, procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.refinement.local_rigid_alignment import sides_are_known
from zoomout_core.matching.registration.correspondences import Surroundings
from zoomout_core.matching.registration.nonrigid_icp import replace_images
from zoomout_core.mesh.affine_maps import mirror_factors
from zoomout_core.mesh.triangles import at_all, components, unique_edges
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class RegionTuning(Tuning, set_by="correspondence"):
    """Which regions are placed by their shape, and how."""

    pooling: float = tuned(0.08, "at unit area", 0, 1)  # diffusion length that averages residuals of similarities
    # Average from which a region is distorted. Heads of other species have .35 to .55; on two pairs of people and two
    # of gorillas and men, no region of `min_area` is above .25.
    min_distortion: float = tuned(0.3, "1", 0, 1)
    min_area: float = tuned(0.05, "of the target's area", 1e-6, 1)  # smaller regions do not determine a pose
    max_area: float = tuned(0.3, "of the target's area", 0, 1)  # larger ones are wrong as a whole
    # Second principal extent of a region over the first, from which it is rigid: two tails, which bend, have 0.21 and
    # 0.24, heads 0.5 to 0.8.
    min_width: float = tuned(0.35, "1", 0, 1)
    around_target: float = tuned(0.25, "at unit area", 0, 2)  # distance from the region to which points are considered
    around_source: float = tuned(0.2, "at unit area", 0, 2)  # the same from its images
    normal_weight: float = tuned(0.08, "at unit area", 0, 1)  # distance that equals a unit difference of normals
    angles: tuple[float, ...] = tuned((30.0, 60.0, 90.0), "degrees", 0, 180)  # of starting poses, about three axes
    min_scale: float = tuned(0.4, "1", 0.01, 1)  # of a pose
    max_scale: float = tuned(2.0, "1", 1, 100)  # of a pose
    first_rounds: int = tuned(4, "rounds", 1, 100)  # from all starting poses
    rounds: int = tuned(8, "rounds", 1, 100)  # further ones, from the best poses
    kept: int = tuned(4, "poses", 1, 1000)  # number of the best poses
    # Part of the places that the map gives to the region, which a pose must cover: poses that improve a head keep 0.75
    # to 1, one that made a head worse kept 0.06.
    min_kept: float = tuned(0.4, "1", 0, 1)
    max_ratio: float = tuned(0.93, "1", 0, 1)  # of the misfit to that of the map's pose, for a pose to replace it


REGIONS = RegionTuning()
# Scales s at unit area (Geman and McClure 1987): of the misfit r^2 / (r^2 + s^2), and the wider one of the weights
# 1 / (1 + (r / s)^2)^2 by which a pose is fitted to closest points.
MISFIT_SCALE, WEIGHT_SCALE = 0.05, 0.08
# Points of the source that the region is projected to; denser ones do not change the best pose.
MAX_POINTS = 400
MIN_SAMPLES = 8


class Placement(NamedTuple):
    """A region of the target in its new pose on the source."""

    region: Integers  # (r,) vertices of the target
    partners: Integers  # (p,) vertices of the source that the region covers
    vertex: Integers  # (r,) a vertex of the source near each vertex of the region in its pose
    back: Integers  # (p,) a vertex of the target near each of the partners
    pose: Similarities  # of the target's vertices, mirrored if the map mirrors, to the source


class _Points(NamedTuple):
    """Points of a shape."""

    positions: Floats  # (n, 3)
    normals: Floats  # (n, 3)

    @classmethod
    def of(cls, shape: ShapeAnalysis, vertex: Integers, mirrored: bool = False) -> _Points:
        """Vertices of a shape, or of its mirror image."""
        sense = mirror_factors(mirrored)
        mesh = shape.mesh
        return cls(mesh.vertices[vertex] * sense, mesh.vertex_normals[vertex] * sense)

    def move(self, pose: Similarities) -> SingleFloats:
        """(..., n, 6) coordinates of the points in some poses, in which compatible points are close."""
        positions, normals = pose(self.positions), self.normals @ np.swapaxes(pose.rotation, -1, -2)
        return np.concatenate([positions, REGIONS.normal_weight * normals], axis=-1).astype(np.float32)

    def coordinates(self) -> SingleFloats:
        """(n, 6) the same of the points where they are."""
        return self.move(Similarities(np.ones(()), np.eye(3), np.zeros(3)))


class _Scene(NamedTuple):
    """A region of the target, and the part of the source on which it is placed."""

    target: _Points  # samples of the region and around it
    inside: Booleans  # (t,) those in the region
    images: Floats  # (t, 3) of the samples by the map
    points: _Points  # dense ones of the source
    samples: _Points  # of the source


def find_placements(
    first: SurfaceMap, distortion: Floats, source: ShapeAnalysis, target: ShapeAnalysis, mirrored: bool
) -> list[Placement]:
    """Poses of the regions that a map distorts, where they fit better than those of the map.

    Args:
        first: the map from the target's mesh to the source's.
        distortion: (n_t,) `local_distortion` of the map.
        source: the source.
        target: the target.
        mirrored: whether the map is one of the target's mirror image.
    """
    if not sides_are_known(source, target):
        return []
    pooled = target.basis.smoothed(distortion[:, None], REGIONS.pooling**2)[:, 0]
    placements = (
        _place(region, first, source, target, mirrored) for region in _regions(pooled > REGIONS.min_distortion, target)
    )
    return [placement for placement in placements if placement is not None]


def move_regions(
    surface_map: SurfaceMap,
    placements: Sequence[Placement],
    source: ShapeAnalysis,
    target: ShapeAnalysis,
    mirrored: bool,
) -> SurfaceMap:
    """Replace the images of regions by those in their new poses, in a map from the target's mesh to the source's."""
    surface = Surroundings.of(source).surface
    for region, _, vertex, _, pose in placements:
        found = surface.closest(pose(_Points.of(target, region, mirrored).positions), vertex)
        surface_map = replace_images(surface_map, region, SurfaceMap(*found, source.mesh.triangles))
    return surface_map


def move_regions_back(
    back: SurfaceMap, placements: Sequence[Placement], source: ShapeAnalysis, target: ShapeAnalysis, mirrored: bool
) -> SurfaceMap:
    """Replace the images of the regions' partners likewise, in a map from the source's mesh to the target's."""
    sense = mirror_factors(mirrored)
    surface = Surroundings.of(target).surface
    for _, partners, _, vertex, pose in placements:
        found = surface.closest(pose.inverse(source.mesh.vertices[partners]) * sense, vertex)
        back = replace_images(back, partners, SurfaceMap(*found, target.mesh.triangles))
    return back


def _regions(distorted: Booleans, target: ShapeAnalysis) -> list[Integers]:
    """The rigid connected regions of some vertices (n,) of the target whose areas are within the limits."""
    edges, _ = unique_edges(target.mesh.triangles)
    number = components(edges[at_all(distorted, edges)], len(distorted))
    shares = np.bincount(number[distorted], target.basis.areas[distorted] / target.basis.areas.sum())
    chosen = np.flatnonzero((shares >= REGIONS.min_area) & (shares <= REGIONS.max_area))
    regions = [np.flatnonzero(distorted & (number == each)) for each in chosen]
    return [region for region in regions if _width(target.mesh.vertices[region]) >= REGIONS.min_width]


def _width(points: Floats) -> float:
    """The second principal extent of points (n, 3) over the first."""
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(extent[1] / extent[0])


def _place(
    region: Integers, first: SurfaceMap, source: ShapeAnalysis, target: ShapeAnalysis, mirrored: bool
) -> Placement | None:
    """The best pose of a region; None if that of the map is as good, or the pose is unreliable.

    A pose is unreliable if too few samples determine it, or if it moves the region to another part of the source.
    """
    inside = np.zeros(len(target.mesh.vertices), dtype=bool)
    inside[region] = True
    known = inside[target.sampled.samples[: len(target.distances)]]
    images = first.interpolate(source.mesh.vertices)
    samples = source.sampled.samples
    nearest = cKDTree(images[target.sampled.samples]).query(source.mesh.vertices[samples])[1]
    covered = inside[target.sampled.samples[nearest]]
    reached = covered[: len(source.distances)]
    if min(known.sum(), reached.sum()) < MIN_SAMPLES:
        return None
    off_target, off_source = target.distances[known].min(axis=0), source.distances[reached].min(axis=0)
    at = target.sampled.samples[off_target[target.sampled.samples] < REGIONS.around_target]
    area = np.flatnonzero(off_source < REGIONS.around_source)
    scene = _Scene(
        _Points.of(target, at, mirrored),
        inside[at],
        images[at],
        _Points.of(source, area[:: -(-len(area) // MAX_POINTS)]),
        _Points.of(source, samples[np.isin(samples, area)]),
    )
    centres = source.mesh.vertices[samples[covered]].mean(axis=0), scene.samples.positions.mean(axis=0)
    growth = np.sqrt(covered.sum() / inside[target.sampled.samples].sum())
    pose = _best_pose(scene, _starts(scene, centres, growth))
    if pose is None:
        return None
    around = np.flatnonzero(off_target < REGIONS.around_target)
    of_target, of_source = _Points.of(target, around, mirrored).move(pose), _Points.of(source, area).coordinates()
    back = around[cKDTree(of_target).query(of_source)[1]]
    vertex = area[cKDTree(of_source).query(of_target[inside[around]])[1]]
    covers = inside[back]
    if np.isin(samples[covered], area[covers]).mean() < REGIONS.min_kept:
        return None
    return Placement(around[inside[around]], area[covers], vertex, back[covers], pose)


def _starts(scene: _Scene, centres: Sequence[Floats], growth: float) -> Similarities:
    """The pose of the map, and those that turn it about the principal axes of the region, at some centres (3,)."""
    limits = REGIONS.min_scale, REGIONS.max_scale
    points = scene.target.positions[scene.inside]
    current = procrustes(points, scene.images[scene.inside], scales=limits)
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle, full_matrices=False)[2]
    angles = np.radians(np.concatenate([np.zeros(1), REGIONS.angles, -np.array(REGIONS.angles)]))
    turns = Rotation.from_rotvec((angles[:, None, None] * axes).reshape(-1, 3)).as_matrix()
    rotation = np.concatenate([current.rotation @ turns] * len(centres))
    scale = np.full(len(rotation), np.clip(growth, *limits))
    centre = np.repeat(centres, len(turns), axis=0)
    turned = Similarities(scale, rotation, centre - scale[:, None] * (rotation @ middle))
    return Similarities.concatenate([current.repeat(1), turned])


def _best_pose(scene: _Scene, starts: Similarities) -> Similarities | None:
    """The pose of the smallest misfit, by closest points from each of the starts; None if the first is as good."""
    poses = starts
    for _ in range(REGIONS.first_rounds):
        poses, _ = _fit(scene, poses)
    _, misfit = _fit(scene, poses)
    chosen = np.argsort(misfit[1:], kind="stable")[: REGIONS.kept] + 1
    poses = poses[np.concatenate([[0], chosen])]
    for _ in range(REGIONS.rounds):
        poses, _ = _fit(scene, poses)
    _, misfit = _fit(scene, poses)
    best = int(np.argmin(misfit))
    return poses[best] if misfit[best] < REGIONS.max_ratio * misfit[0] else None


def _fit(scene: _Scene, poses: Similarities) -> tuple[Similarities, Floats]:
    """One round of closest points both ways: the poses after it (b), and (b,) the misfit before it."""
    moved = scene.target.move(poses)  # (b, t, 6)
    there, gap = _closest(moved[:, scene.inside], scene.points.coordinates(), axis=2)
    back, gap_back = _closest(moved, scene.samples.coordinates(), axis=1)
    # Places of the source that the surroundings of the region cover have no partner in it.
    owned = scene.inside[back] / np.maximum(scene.inside[back].sum(axis=1, keepdims=True), 1)
    gaps = np.concatenate([gap, gap_back], axis=1)
    shares = np.concatenate([np.full(gap.shape, 1 / gap.shape[1]), owned], axis=1)
    misfit = (shares * gaps**2 / (gaps**2 + MISFIT_SCALE**2)).sum(axis=1)
    weights = shares / (1 + (gaps / WEIGHT_SCALE) ** 2) ** 2
    inner, goals = scene.target.positions[scene.inside], scene.samples.positions
    places = np.concatenate([np.broadcast_to(inner, (len(moved), *inner.shape)), scene.target.positions[back]], axis=1)
    images = np.concatenate([scene.points.positions[there], np.broadcast_to(goals, (len(moved), *goals.shape))], axis=1)
    limits = REGIONS.min_scale, REGIONS.max_scale
    return procrustes(places, images, weights, scales=limits), np.asarray(misfit)


def _closest(moved: SingleFloats, points: SingleFloats, axis: int) -> tuple[Integers, Floats]:
    """The closest pairs among coordinates (b, t, 6) and (s, 6), along one of the axes of (b, t, s): which, how far."""
    squared = (points**2).sum(axis=1) - 2 * moved @ points.T
    squared += (moved**2).sum(axis=2)[:, :, None]
    found = squared.argmin(axis=axis)
    nearest = np.take_along_axis(squared, np.expand_dims(found, axis), axis).squeeze(axis)
    return found, np.sqrt(np.maximum(nearest, 0)).astype(np.float64)
