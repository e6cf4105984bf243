# SPDX-License-Identifier: GPL-3.0-or-later
"""Pin extremities of two bodies to each other where a map falls short of them.

Eigenfunctions and rigid motions preserve lengths, so that the leg of a hippopotamus covers only the upper part of a
horse's. The map back takes all of the longer leg to the shorter one, and foot to foot. Extremities that one of the two
maps pairs well are pinned to each other if the other map falls far short of several of them. The images of these limbs
are stretched to their tips, and the registration is repeated with the pins.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.maps.bend import bend
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.hypotheses.extremities import EXTREMITIES, maxima
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.registration.nonrigid_icp import Pins
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.runtime.once import once_per_argument
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class PinTuning(Tuning, set_by="correspondence"):
    """Which extremities are pinned, and how far around them images are stretched."""

    max_miss: float = tuned(0.08, "at unit area", 0, 2)  # of the map that pairs two extremities
    max_shortfall: float = tuned(0.5, "at unit area", 0, 10)  # of the other map; farther off is another limb
    min_shortfall: float = tuned(0.1, "at unit area", 0, 2)  # below it, an extremity counts as reached
    # Minimum of the sum of all shortfalls. Two extremities are missed by .28 and .11 between a hippopotamus and a dog,
    # whose map improves with pins, and by .10 and .14 between two people, whose map does not.
    min_sum: float = tuned(0.3, "at unit area", 0, 10)
    # A single one may be a limb that is cut or has another end, on bodies of the same proportions.
    min_limbs: int = tuned(2, "extremities", 1, 30)
    # Width of the Gaussian by which the displacement of a tip decays, in lengths of its limb.
    width: float = tuned(0.7, "1", 0, 10)


PINS = PinTuning()


class _Tips(NamedTuple):
    """The extremities of a shape, the lesser ones, too."""

    vertices: Integers  # (m,) of the mesh
    distances: Floats  # (m, n) geodesic distances from them


def pin_extremities(
    there: SurfaceMap, back: SurfaceMap, source: ShapeAnalysis, target: ShapeAnalysis
) -> tuple[SurfaceMap, Pins] | None:
    """Stretch a map to the extremities that it falls short of.

    Args:
        there: the map from the target's mesh to the source's.
        back: the map from the source's mesh to the target's.
        source: the source.
        target: the target.

    Returns:
        The stretched map, and the pins for its registration; None if the map falls short of too few extremities.
    """
    of_source, of_target = _tips(source), _tips(target)
    if min(len(of_source.vertices), len(of_target.vertices)) == 0:
        return None
    missed = of_source.distances[:, there.vertex[of_target.vertices]]  # (m_source, m_target)
    missed_back = of_target.distances[:, back.vertex[of_source.vertices]].T
    partner, paired = _pair(missed, missed_back)
    shortfall = missed[partner, np.arange(len(partner))]
    falls_short = paired & (shortfall > PINS.min_shortfall)
    if np.count_nonzero(falls_short) < PINS.min_limbs or shortfall[falls_short].sum() < PINS.min_sum:
        return None
    vertices, goals = of_target.vertices, source.mesh.vertices[of_source.vertices[partner]]
    between = of_target.distances[:, vertices] + np.diag(np.full(len(vertices), np.inf))
    stretched = there
    for tip in np.flatnonzero(falls_short):
        stretched = _stretch(stretched, vertices[tip], goals[tip], between[tip].min() / 2, source, target)
    # Those that the map reaches are pinned, too, so that the longer limbs do not pull the others along.
    return stretched, Pins(vertices[paired], goals[paired])


def _pair(missed: Floats, missed_back: Floats) -> tuple[Integers, Booleans]:
    """Pair the extremities of the target (m_t,) with those of the source (m_s,).

    Args:
        missed: (m_s, m_t) how far the map of the target ends from each extremity of the source.
        missed_back: (m_s, m_t) how far the map of the source ends from each extremity of the target.

    Returns:
        (m_t,) the partner of each extremity, and (m_t,) whether the pair is unambiguous.
    """
    better, worse = np.minimum(missed, missed_back), np.maximum(missed, missed_back)
    each, partner = np.arange(better.shape[1]), better.argmin(axis=0)
    paired = better.argmin(axis=1)[partner] == each
    paired &= (better[partner, each] < PINS.max_miss) & (worse[partner, each] < PINS.max_shortfall)
    return partner, paired


def _stretch(
    surface_map: SurfaceMap, tip: int, goal: Floats, length: float, source: ShapeAnalysis, target: ShapeAnalysis
) -> SurfaceMap:
    """Move the image of a tip to a place (3,) of the source, and those of its limb, of some length, along with it."""
    displacement = goal - surface_map.interpolate(source.mesh.vertices)[tip]
    meshes = source.mesh.vertices, target.mesh.vertices, target.mesh.triangles
    return bend(surface_map, *meshes, np.array([tip]), displacement[None], PINS.width * length)


@once_per_argument
def _tips(shape: ShapeAnalysis) -> _Tips:
    vertices, persistence = maxima(shape)
    vertices = vertices[persistence > EXTREMITIES.lesser_persistence][: EXTREMITIES.max_count]
    graph = edge_graph(shape.mesh.vertices, shape.mesh.triangles)
    distances = np.asarray(dijkstra(graph, indices=vertices))
    return _Tips(vertices, distances.reshape(len(vertices), len(shape.mesh.vertices)))
