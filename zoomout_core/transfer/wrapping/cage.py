# SPDX-License-Identifier: GPL-3.0-or-later
"""The cage of a subdivision surface on the source: its limit points are on the source, not its vertices."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.sparse_solve import factorise
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.wrapping.elastic import PinnedSystem, Pins, neighbour_means
from zoomout_core.transfer.wrapping.subdivision import limit_points

# Rounds of projecting the limit surface onto the source.
PROJECTION_ROUNDS = 4
# Weights relative to squared distances of the limit from its projections: of differences in motion between a vertex and
# its neighbours, and of the motion itself. The first determines patterns that no limit point does, such as alternating
# vertices.
FAIRNESS_WEIGHT = 3e-3
MOTION_WEIGHT = 1e-4


def cage_of(
    mapped: MappedTarget, positions: Floats, triangle: Integers, weight: Floats, detail: float, pins: Pins
) -> Floats:
    """(n_t, 3) vertices of a cage whose limit surface matches the given vertex positions.

    Least squares of distances of the limit's points at vertices, edges and faces, regularised by the cage's motion.

    Args:
        mapped: the target, which is the cage, on the source.
        positions: (n_t, 3) positions of its vertices on the source, in the source's frame and unit.
        triangle: (n_t,) the source's triangles near these.
        weight: (n_t,) how far vertices are on the source, in [0, 1]; the others stay.
        detail: how far the limit moves from the polygons between the positions to the source, in [0, 1].
        pins: places of the limit, as mixtures of its points at the vertices, that must reach given positions.
    """
    cage, source, n = mapped.target, mapped.source, len(positions)
    points = limit_points(cage)
    pull = csc_array(points.limit.T @ diags_array(np.maximum(points.limit @ weight, 0)))
    fair = csc_array(FAIRNESS_WEIGHT * _differences(cage) + MOTION_WEIGHT * diags_array(np.ones(n)))
    limit_pins = Pins(csr_array(pins.matrix @ points.limit[:n]), pins.positions)
    system = PinnedSystem(factorise(pull @ points.limit + fair), limit_pins)
    flat, found, at = points.flat @ positions, positions, triangle[points.near]
    for _ in range(PROJECTION_ROUNDS):
        at, barycentric, _ = mapped.whole.walk(at, points.limit @ found)
        projections = np.einsum("qc,qcx->qx", barycentric, source.vertices[source.triangles[at]])
        found = system.solve(pull @ (flat + detail * (projections - flat)) + fair @ positions)
    return found


def _differences(cage: Surface) -> csr_array:
    """(n, n) quadratic form of the sum of squared differences between vertices and the means of their neighbours."""
    means = neighbour_means(cage.triangles, len(cage.vertices))
    differences = diags_array((np.diff(means.indptr) > 0).astype(np.float64)) - means
    return csr_array(differences.T @ differences)
