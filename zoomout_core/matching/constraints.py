# SPDX-License-Identifier: GPL-3.0-or-later
"""Evidence from the user: landmarks, common axes, regions of the same name, an earlier map.

None of it decides alone: it enters the ranking of candidates with a weight, and evidence on places constrains maps by
anchors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import SMALLEST
from zoomout_core.maps.anchors import Anchors, coordinates
from zoomout_core.maps.bend import bend
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.pair import Pair, landmark_points, landmarks_on_parts, positions_of_part
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.scores import IN_SPACE, UP_AXES, UPRIGHT, Disagreement, correlation
from zoomout_core.mesh.input_checks import vertex_numbers
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph

Landmarks: TypeAlias = tuple[ArrayLike, ArrayLike]
Regions: TypeAlias = Sequence[tuple[ArrayLike, ArrayLike]]

# The indicator function of a region is smoothed over this diffusion length, at unit area, and scaled to unit size.
REGION_WIDTH = 0.05
REGION_SCALE = 2.0
# A pinned landmark's displacement decays with the distance d as exp(-(d / w)^2), of width w, at unit area. The width is
# at least this multiple of the largest displacement; below 0.86, triangles would fold over.
PINNING_WIDTH = 0.1
MIN_PINNING_WIDTH_RATIO = 1.5


@dataclass(frozen=True, eq=False)
class Constraints:
    """Evidence about the right map."""

    landmarks: Landmarks | None  # corresponding places on the source and on the target, as for `landmarks_on_parts`
    common_axes: Floats  # (a, 3) directions in which both surfaces are oriented alike, such as the up axis, or none
    regions: list[tuple[Integers, Integers]]  # source vertices and target vertices of each
    earlier: Integers | None = None  # (s,) source vertex of each search sample by an earlier map
    # (s, 3) positions of the target's search samples in the frame of the source's part, or None if the two surfaces do
    # not overlap.
    in_space: Floats | None = None
    upright: bool = False  # whether both surfaces are likely to stand upright, with y or z up

    def anchors(self, pair: Pair) -> Anchors | None:
        """Anchors of a map by indicator functions of the regions; None without regions."""
        regions = self._indicators(pair)
        if not regions:
            return None
        source, target = (
            REGION_SCALE * np.column_stack([shape.basis.smoothed(inside[:, None], REGION_WIDTH**2) for inside in side])
            for shape, side in zip((pair.source_shape, pair.target_shape), zip(*regions, strict=True), strict=True)
        )
        return Anchors(source, target)

    def disagreement(self, pair: Pair) -> Disagreement:
        """A function that measures how far a map disagrees with each kind of evidence."""
        source, target = pair.source_shape, pair.target_shape
        here = target.search.samples
        landmark_distance = None if self.landmarks is None else _landmark_distance(pair, self.landmarks)
        regions = self._indicators(pair)
        has_axes = len(self.common_axes) > 0
        # Axes and overlapping surfaces are stronger evidence of the same kind.
        is_upright = self.upright and not has_axes and self.in_space is None
        positions = _positions_of_samples(pair) if has_axes or is_upright else ()
        heights = [of_shape @ self.common_axes.T for of_shape in positions]

        def evaluate(functional_map: Floats, sample_map: Integers, anchors: Anchors | None) -> dict[str, float]:
            there = source.search.samples[sample_map]
            disagreements = {}
            if landmark_distance is not None:
                disagreements["landmarks"] = landmark_distance(functional_map, anchors)
            if self.earlier is not None:
                first = source.nearest_distance_sample[sample_map]
                disagreements["earlier map"] = float(target.weights @ source.distances[first, self.earlier])
            if self.in_space is not None:
                moved = np.linalg.norm(source.proxy.vertices[there] - self.in_space, axis=1)
                disagreements[IN_SPACE] = float(target.weights @ moved)
            if has_axes:
                agreement = correlation(heights[0], heights[1][sample_map], target.weights)
                disagreements["axes"] = 1 - agreement
            if is_upright:
                agreement = _upright_agreement(positions[0], positions[1][sample_map], target.weights)
                disagreements[UPRIGHT] = 1 - agreement
            if regions:
                overlaps = [_jaccard(inside[here], onto[there], target.weights) for onto, inside in regions]
                disagreements["regions"] = float(1 - np.mean(overlaps))
            return disagreements

        return evaluate

    def _indicators(self, pair: Pair) -> list[tuple[Floats, Floats]]:
        """For each region that both shapes have vertices of, (n_s,) and (n_t,) its indicators on source and target."""
        found = []
        for of_source, of_target in self.regions:
            on_source = _indicator(of_source, pair.source, pair.source_shape)
            on_target = _indicator(of_target, pair.target, pair.target_shape)
            if all(inside.any() and not inside.all() for inside in (on_source, on_target)):
                found.append((on_source, on_target))
        return found


def check_axes(common_axes: ArrayLike | None) -> Floats:
    """Check the axes that a user gave, and normalise them to (a, 3) unit vectors.

    Raises:
        ValueError: the axes are not directions.
    """
    try:
        axes = np.zeros((0, 3)) if common_axes is None else np.atleast_2d(np.asarray(common_axes, dtype=float))
    except (TypeError, ValueError):  # no numbers
        axes = np.full((1, 3), np.nan)
    length = np.hypot.reduce(axes, axis=-1, keepdims=True)  # squares could overflow
    if axes.ndim != 2 or axes.shape[1] != 3 or not np.isfinite(length).all() or (length == 0).any():
        raise ValueError("common_axes must be directions such as (0, 0, 1), one or several of them.")
    return np.asarray(axes / length)


def check_regions(regions: Regions | None, source: Surface, target: Surface) -> list[tuple[Integers, Integers]]:
    """Check the regions that a user gave: vertex numbers of the source and of the target for each.

    Raises:
        ValueError: a region is not a pair of lists of vertices.
    """
    checked = []
    for number, region in enumerate(() if regions is None else regions):
        if not hasattr(region, "__len__") or len(region) != 2:
            raise ValueError(f"Region {number} must be a pair: its vertices on the source, and those on the target.")
        of_source = vertex_numbers(region[0], len(source.vertices), f"Region {number} of the source")
        of_target = vertex_numbers(region[1], len(target.vertices), f"Region {number} of the target")
        checked.append((of_source, of_target))
    return checked


def meet_exact_landmarks(surface_map: SurfaceMap, pair: Pair) -> SurfaceMap:
    """Bend the map of a pair to its exact landmarks, if it has any. Maps of hulls already meet them, shell by shell."""
    if pair.exact_landmarks is None or pair.target_shape.proxy.full.is_hull:
        return surface_map
    return bend_to_points(surface_map, pair.source, pair.target, *landmark_points(pair, pair.exact_landmarks))


def landmark_errors(
    surface_map: SurfaceMap, source: Surface, target: Surface, on_source: Floats, on_target: Floats
) -> Floats:
    """(l,) distances between points (l, 3) of the source and the images of those (l, 3) of the target, at unit area."""
    missed = _displacements(surface_map, source, target, on_source, on_target)[1]
    return np.asarray(np.linalg.norm(missed, axis=1) / np.sqrt(source.area))


def bend_to_points(
    surface_map: SurfaceMap, source: Surface, target: Surface, on_source: Floats, on_target: Floats
) -> SurfaceMap:
    """Deform a map between surfaces so that points (l, 3) of the target land on those (l, 3) of the source.

    If several points are nearest to the same vertex of the target, the first one counts.
    """
    nearest_vertices, missed = _displacements(surface_map, source, target, on_source, on_target)
    places = target.working.vertex_of[nearest_vertices]
    _, first = np.unique(places, return_index=True)
    largest = np.linalg.norm(missed, axis=1).max(initial=0) / np.sqrt(source.area)
    # Lengths of the target, on which the bend fades, are as many times longer as it is larger.
    width = max(PINNING_WIDTH, MIN_PINNING_WIDTH_RATIO * largest) * np.sqrt(target.area)
    # Both surfaces are bent with their seams welded, so that the bend does not end at one.
    here, there = target.working, source.working
    corners, member = there.vertex_of[surface_map.source_triangles], here.surface_vertex
    welded = SurfaceMap(surface_map.triangle[member], surface_map.barycentric[member], corners)
    meshes = there.to_surface(there.vertices), here.to_surface(here.vertices), here.triangles
    bent = bend(welded, *meshes, places[first], missed[first], width)
    triangle, barycentric = surface_map.triangle.copy(), surface_map.barycentric.copy()
    used = np.flatnonzero(here.vertex_of >= 0)
    of_used = here.vertex_of[used]
    triangle[used], barycentric[used] = bent.triangle[of_used], bent.barycentric[of_used]
    return SurfaceMap(triangle, barycentric, surface_map.source_triangles)


def _displacements(
    surface_map: SurfaceMap, source: Surface, target: Surface, on_source: Floats, on_target: Floats
) -> tuple[Integers, Floats]:
    """(l,) the vertices of the target nearest to points, and (l, 3) the displacements that their images need."""
    triangle, barycentric = closest_points(on_target, target.vertices, target.triangles)
    corners = target.triangles[triangle]
    images = np.einsum("lc,lcx->lx", barycentric, surface_map.interpolate(source.vertices)[corners])
    return corners[np.arange(len(corners)), barycentric.argmax(axis=1)], on_source - images


def _landmark_distance(pair: Pair, landmarks: Landmarks) -> Callable[[Floats, Anchors | None], float]:
    """A function that sums the distances, at unit area, between landmarks and the images of their partners."""
    source, target = pair.source_shape, pair.target_shape
    source_ids, target_ids = landmarks_on_parts(pair, landmarks)
    graph = edge_graph(source.mesh.vertices, source.mesh.triangles)
    distances = dijkstra(graph, indices=source_ids)

    def total_distance(functional_map: Floats, anchors: Anchors | None) -> float:
        at_landmarks = None if anchors is None else Anchors(anchors.source, anchors.target[target_ids])
        rows = target.basis.eigenvectors[target_ids]
        image = nearest(*coordinates(rows, source.basis.eigenvectors, functional_map, at_landmarks))
        return float(distances[np.arange(len(image)), image].sum())

    return total_distance


def _positions_of_samples(pair: Pair) -> tuple[Floats, ...]:
    """(s_t, 3) and (s_s, 3) the search samples of target and source in their surfaces' own frames and units."""
    sides = (pair.target, pair.target_shape), (pair.source, pair.source_shape)
    return tuple(
        positions_of_part(surface, shape)[shape.proxy.full_vertex[shape.search.samples]] for surface, shape in sides
    )


def _upright_agreement(places: Floats, images: Floats, weights: Floats) -> float:
    """How well a map from places (s, 3) to images (s, 3), with weights (s,) that sum to one, keeps the up direction.

    It is 1 if heights along y or z are in proportion. If the map turns a shape upside down along one of these axes, the
    weight is the squared ratio of the extents along the other axis and this one. It is small for tall shapes. For long
    animals it is near one and decides nothing. So covariances are compared, not correlations.
    """
    here, there = (points[:, UP_AXES] - weights @ points[:, UP_AXES] for points in (places, images))
    extents = np.sqrt((weights @ here**2) * (weights @ there**2))
    return float(max((weights @ (here * there)).max() / max(extents.max(), SMALLEST), 0.0))


def _jaccard(inside: Floats, onto: Floats, weights: Floats) -> float:
    """The Jaccard index, with weights (s,), of two regions given by their indicators (s,) at samples and images."""
    return float(weights @ (inside * onto)) / max(float(weights @ np.maximum(inside, onto)), 1e-300)


def _indicator(vertices: Integers, surface: Surface, shape: ShapeAnalysis) -> Floats:
    """(n,) 1 at the vertices of a shape's mesh whose nearest vertex of the part is one of the surface's `vertices`."""
    of_surface = np.zeros(len(surface.vertices), dtype=bool)
    of_surface[vertices] = True
    vertex_of = shape.proxy.full.vertex_of
    of_part = np.zeros(len(shape.proxy.full.vertices))
    of_part[vertex_of[of_surface & (vertex_of >= 0)]] = 1
    return np.asarray(of_part[shape.proxy.full_vertex])
