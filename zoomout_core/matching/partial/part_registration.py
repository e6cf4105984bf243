# SPDX-License-Identifier: GPL-3.0-or-later
"""Register a part with a whole by a rough map of its samples, and score the map by the fit.

Only the part is deformed, because most of the whole has no partner. A correct map deforms it little, and normals
agree; a map to another limb has to bend, stretch or fold it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.procrustes import nearest_rotations
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape
from zoomout_core.matching.refinement.local_rigid_alignment import align
from zoomout_core.matching.registration.correspondences import GeodesicLimit, Surroundings
from zoomout_core.matching.registration.deformation_graph import DeformationGraph
from zoomout_core.matching.registration.nonrigid_icp import ALIGNMENT_WIDTH, Level, bend
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class PartRegistrationTuning(Tuning, set_by="partial"):
    """How a part is registered with a whole; lengths are those of the larger shape at unit area."""

    image_functions: int = tuned(60, "eigenfunctions", 4, 1000)  # of the part, for smoothing images
    # The schedule for sifting candidates.
    coarse: tuple[Level, ...] = tuned((Level(40, 1.0, 0.3, 1), Level(40, 0.01, 0.3, 5)), "nodes, 1, 1, rounds", 0, 1000)
    # The schedule for sifting rigid placements: surfaces are about as far apart as the robust scales.
    placed: tuple[Level, ...] = tuned(
        (Level(40, 0.1, 0.3, 3, 0.1), Level(40, 0.02, 0.3, 3, 0.05)), "nodes, 1, 1, rounds, length", 0, 1000
    )
    # The following schedule, for comparing the remaining ones.
    fine: tuple[Level, ...] = tuned((Level(100, 1.0, 0.3, 1), Level(100, 0.02, 0.3, 4)), "nodes, 1, 1, rounds", 0, 1000)


PART_REGISTRATION = PartRegistrationTuning()


@dataclass(frozen=True, eq=False)
class RegisteredPart:
    """A part registered with a whole."""

    positions: Floats  # (n, 3) the part's vertices in the whole's frame
    normals: Floats  # (n, 3) their unit normals, rotated with them
    rotations: Floats  # (n, 3, 3) rotations of the surroundings of each vertex
    closest: SurfaceMap  # the closest points of the whole, near vertices with compatible normals
    residual: Floats  # (n,) distance to these
    agreement: Floats  # (n,) cosine between the normals
    is_near: Booleans  # (n,) whether they are near the image of the nearest place, along the whole
    on_cut: Booleans  # (n,) whether the closest point is on a cut of the whole; vertices beyond it have no partner
    strain: (
        float  # mean relative distance between the positions that neighbouring nodes predict for each other, off cuts
    )

    def scores(self, areas: Floats) -> dict[str, float]:
        """Measures that distinguish a right map from a wrong one, with vertex areas (n,); 0 for a perfect fit.

        Returns:
            normals: mean of one minus the cosine, where the closest point is not on a cut;
            strain: see above;
            beyond: share of the area whose closest points are on a cut.
        """
        weights = np.where(self.on_cut, 0, areas) / areas.sum()
        return {
            "normals": float(weights @ (1 - self.agreement) / max(weights.sum(), 1e-9)),
            "strain": self.strain,
            "beyond": float(1 - weights.sum()),
        }


def register_part(
    places: Integers,  # (d_p,) the whole's place for each place of the part
    part: IncompleteShape,  # the shape that is deformed
    whole: IncompleteShape,  # the shape that it is registered with
    levels: Sequence[Level],
    start: Floats | None = None,  # (n, 3) the part's vertices, placed before; by default, this map places them
) -> RegisteredPart:
    """Register a part with a whole."""
    here, there = part.shape, whole.shape
    vertex = there.search.samples[places]
    rest, normals = here.mesh.vertices, here.mesh.vertex_normals
    if start is None:
        count = min(PART_REGISTRATION.image_functions, here.search.rows.shape[1])
        images = here.search.fit(there.mesh.vertices[vertex[here.nearest_distance_sample]], count)
        start = align(images, here, ALIGNMENT_WIDTH, mirrored=False).positions
    place, is_cut = here.voronoi_cell, whole.cut_distance_of_vertices == 0
    around, limit = Surroundings.of(there), GeodesicLimit(vertex[place], there, is_cut)
    graph = bend(rest, normals, start, around, limit, here, levels, is_part=True)
    positions, turned, blends = graph.deform()
    turned = unit_vectors(turned)
    closest = around.closest(positions, turned)
    # The rough map may be off by more; vertices drawn to a touching limb differ from their neighbours.
    nearby = GeodesicLimit(closest.vertex[here.search.samples[place]], there)
    residual = np.linalg.norm(closest.interpolate(there.mesh.vertices) - positions, axis=1)
    on_cut = is_cut[closest.vertex]
    agreement = np.einsum("nx,nx->n", turned, unit_vectors(closest.interpolate(there.mesh.vertex_normals)))
    is_near = ~nearby.exceeds_geodesic_limit(np.arange(len(rest)), closest.vertex)
    rotations, strain = nearest_rotations(blends), _strain(graph, ~on_cut)
    return RegisteredPart(positions, turned, rotations, closest, residual, agreement, is_near, on_cut, strain)


def _strain(graph: DeformationGraph, counts: Booleans) -> float:
    """See `RegisteredPart`; between nodes at vertices that count (n,)."""
    counted = counts[graph.nodes.vertex[graph.nodes.first]] & counts[graph.nodes.vertex[graph.nodes.second]]
    if not counted.any():
        return 1.0
    first, second = graph.nodes.first[counted], graph.nodes.second[counted]
    places = graph.rest[graph.nodes.vertex]
    away = places[second] - places[first]
    put = graph.images[first] + np.einsum("eij,ej->ei", graph.rotations[first], away)
    apart = np.linalg.norm(put - graph.images[second], axis=1)
    return float(np.mean(apart / np.maximum(np.linalg.norm(away, axis=1), 1e-9)))
