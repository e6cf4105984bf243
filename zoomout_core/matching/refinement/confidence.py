# SPDX-License-Identifier: GPL-3.0-or-later
"""The confidence of a map at each vertex."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.similarity_residual import similarity_residual
from zoomout_core.maps.surface_map import SurfaceMap, folded_triangles
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.mesh.affine_maps import mirror_factors
from zoomout_core.mesh.triangles import border_edges, triangle_areas
from zoomout_core.spectral.descriptors import sum_at_vertices
from zoomout_core.tuning import Tuning, tuned

# A point whose barycentric coordinates at vertices of a border fall short of one by less is on it.
ON_BORDER = 1e-2


@dataclass(frozen=True)
class ConfidenceTuning(Tuning, set_by="correspondence"):
    """How errors of a map determine its confidence."""

    # Expected error at which the confidence is 0.5. At this value half of the vertices are off by more than 0.025, and
    # a fifth by more than 0.05; at half of it these are 0.009 and a fiftieth (36 pairs of five kinds of shapes).
    half_confidence: float = tuned(0.022, "at unit area", 1e-6, 1)
    # Residual of similarities that leaves the other indicators unchanged. If a tenth of the right vertices are
    # doubtful, 33 % of those that are off by more than 0.1 are trusted with residuals, and 49 % without them (53 pairs
    # of people, animals, gorillas and men, half of which are damaged).
    usual_residual: float = tuned(0.1, "1", 1e-6, 1)
    # To the farthest neighbours of a vertex that such a residual is computed from. Where it ranks maps, a single ring
    # was right in 9 of 12 pairs, three in 18 of 19.
    rings: int = tuned(3, "edges", 1, 10)
    pooling: float = tuned(0.05, "at unit area", 0, 1)  # diffusion length that averages errors
    without_partner: float = tuned(0.085, "at unit area", 0, 2)  # no partner beyond this miss there and back
    # The same for vertices that map to a border of the other shape, such as those that fill one of its holes.
    beyond_border: float = tuned(0.03, "at unit area", 0, 2)
    # An edge is torn if its image is longer by more than this.
    torn: float = tuned(0.15, "at unit area", 0, 2)


CONFIDENCE = ConfidenceTuning()


class Partners(NamedTuple):
    """Which vertices of two surfaces, or of two shapes' meshes, have a partner on the other one."""

    target: Booleans  # (n_t,) of the target
    source: Booleans  # (n_s,) of the source


def confidence_of(
    there: SurfaceMap,  # from the target's mesh to the source's
    back: SurfaceMap,  # from the source's mesh to the target's, computed independently
    functional_map: Floats,  # (k_target, k_source) of the map from the target
    source: ShapeAnalysis,
    target: ShapeAnalysis,
    reverses_orientation: bool = False,  # the map does
    mirrored: bool = False,  # it maps the target's mirror image
    # (n_t,) whether a vertex has a partner; elsewhere confidence is 0, and nothing counts as flipped. All vertices
    # have one by default.
    has_partner: Booleans | None = None,
) -> tuple[Floats, float]:
    """Confidence from the error that three indicators agree on, and from triangles that the map flips.

    There are three indicators: the error of the round trip, the disagreement of the eigenfunctions at both ends, and
    the deviation of the map from a similarity of the surroundings. Each alone fails: the first if the maps of both
    directions have the same error, the second where eigenfunctions of different places are similar, the third inside a
    limb that is mapped to another limb. Their product orders errors better than each. Returns (n_t,) confidence in [0,
    1], and the part of the target's area, in [0, 1], that the map flips.
    """
    cycle = cycle_error(there, back, target.mesh.vertices)
    k_target, k_source = functional_map.shape
    mapped = there.interpolate(source.basis.eigenvectors[:, :k_source]) @ functional_map.T
    values, eigenvalues = target.basis.eigenvectors[:, :k_target], target.basis.eigenvalues[:k_target]
    off = spectral_distance(values, mapped, eigenvalues)
    errors = np.column_stack([cycle, off, local_distortion(there, source, target, mirrored)])
    pooled = np.maximum(target.basis.smoothed(errors, CONFIDENCE.pooling**2), 0)
    expected = np.sqrt(pooled.prod(axis=1) / CONFIDENCE.usual_residual)
    triangles = target.mesh.oriented_triangles
    normals = there.interpolate(source.mesh.vertex_normals) * (-1 if reverses_orientation else 1)
    over = folded_triangles(there.interpolate(source.mesh.vertices), normals, triangles)
    area = triangle_areas(target.mesh.vertices, triangles)
    known = np.ones(len(expected), dtype=bool) if has_partner is None else has_partner
    over &= known[triangles].all(axis=1)
    shares = sum_at_vertices(triangles, np.column_stack([area * ~over, area]), len(expected))
    upright = shares[:, 0] / np.maximum(shares[:, 1], 1e-300)
    return known * upright / (1 + (expected / CONFIDENCE.half_confidence) ** 2), float(area[over].sum() / area.sum())


def partners_by_cycle(there: SurfaceMap, back: SurfaceMap, source: ShapeAnalysis, target: ShapeAnalysis) -> Partners:
    """Which vertices of two shapes' meshes return close to themselves when mapped there and back.

    A tail that the other shape lacks maps to its surroundings there. The map back is computed independently, and misses
    it.
    """
    return Partners(_returns(there, back, target, source), _returns(back, there, source, target))


def _returns(there: SurfaceMap, back: SurfaceMap, shape: ShapeAnalysis, other: ShapeAnalysis) -> Booleans:
    """(n,) whether the vertices of a shape's mesh return close to themselves."""
    cycle = cycle_error(there, back, shape.mesh.vertices)
    pooled = shape.basis.smoothed(cycle[:, None], CONFIDENCE.pooling**2)[:, 0]
    on_border = np.zeros(len(other.mesh.vertices), dtype=bool)
    on_border[border_edges(other.mesh.triangles)] = True
    ends_there = there.interpolate(on_border.astype(np.float64)) > 1 - ON_BORDER
    return np.asarray((pooled <= CONFIDENCE.without_partner) & ~(ends_there & (cycle > CONFIDENCE.beyond_border)))


def cycle_error(there: SurfaceMap, back: SurfaceMap, target_vertices: Floats) -> Floats:
    """(n_t,) distance between target vertices (n_t, 3) and their images under the map there and back, in their unit."""
    returned = there.interpolate(back.interpolate(target_vertices))
    return np.asarray(np.linalg.norm(returned - target_vertices, axis=1))


def local_distortion(surface_map: SurfaceMap, source: ShapeAnalysis, target: ShapeAnalysis, mirrored: bool) -> Floats:
    """(n_t,) `similarity_residual` of a map; a `mirrored` one is a map of the target's mirror image."""
    places = target.mesh.vertices * mirror_factors(mirrored)
    images = surface_map.interpolate(source.mesh.vertices)
    return similarity_residual(places, target.mesh.triangles, images, CONFIDENCE.rings)


def torn_triangles(surface_map: SurfaceMap, source: ShapeAnalysis, target: ShapeAnalysis) -> float:
    """The number of triangles of the target, weighted by their areas, whose corners a map sends far apart."""
    triangles = target.mesh.triangles
    edges = triangles, np.roll(triangles, 1, axis=1)
    images = surface_map.interpolate(source.mesh.vertices)
    own, mapped = (np.linalg.norm(at[edges[0]] - at[edges[1]], axis=2) for at in (target.mesh.vertices, images))
    areas = triangle_areas(target.mesh.vertices, triangles)
    return float(areas @ (mapped - own > CONFIDENCE.torn).any(axis=1) / areas.mean())


def spectral_distance(rows: Floats, others: Floats, eigenvalues: Floats) -> Floats:
    """(n,) difference of values of the first eigenfunctions (n, k), as a distance at unit area.

    A step d changes the first k eigenfunctions, on average, by d times the root of half their eigenvalues' sum.
    """
    return np.asarray(np.linalg.norm(rows - others, axis=1) / np.sqrt(eigenvalues.sum() / 2))
