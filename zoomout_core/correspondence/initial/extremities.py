"""Hypotheses from extremities: hands, feet, head, tail, matched by their distances along the surface.

Extremities are the persistent maxima of the average geodesic distance. All ways to pair those of two shapes
are weighed by how well they keep the distances between them; several are kept, for a shape and its mirror
image keep them alike. The distances to the paired extremities, and the sense in which these turn around each
point, then give a map by nearest neighbours and hold it in place while it is refined.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from zoomout_core.correspondence.anchors import Anchors
from zoomout_core.correspondence.initial.hypothesis import Hypothesis
from zoomout_core.correspondence.initial.landmarks import anchored_hypothesis
from zoomout_core.correspondence.places import places_on
from zoomout_core.correspondence.shape import Shape
from zoomout_core.surface import Floats, Integers, edge_graph

# Rise of the average distance above the pass to a higher maximum, at unit area: heads have 0.14 and more,
# hands and feet 0.34 and more, fingers 0.05.
PERSISTENCE = 0.09
FEWEST, MOST = 3, 7
# How many pairings of all extremities are tried, and how many that leave one out.
COMPLETE, PARTIAL = 10, 4


@dataclass(frozen=True, eq=False)
class Extremities:
    """The tips of a shape.

    Attributes:
        vertices: (m,) of the mesh, the most persistent first.
        average_distance: (m,) to all of the surface, at unit area.
        persistence: (m,) how far each stands out.
    """

    vertices: Integers
    average_distance: Floats
    persistence: Floats


def extremity_hypotheses(source: Shape, target: Shape) -> list[Hypothesis]:
    """The maps that pairings of extremities suggest; none where a shape has too few of them."""
    tips_source, tips_target = extremities(source), extremities(target)
    if min(len(tips_source.vertices), len(tips_target.vertices)) < FEWEST:
        return []
    places_source, places_target = (
        places_on(source, tips_source.vertices),
        places_on(target, tips_target.vertices),
    )
    hypotheses = []
    for of_target, of_source in pairings(target, tips_target, source, tips_source):
        anchors = Anchors(places_source.features(of_source), places_target.features(of_target))
        origin = "extremities " + " ".join(f"{t}-{s}" for t, s in zip(of_target, of_source, strict=True))
        hypotheses.append(anchored_hypothesis(origin, source, target, anchors))
    return hypotheses


def extremities(shape: Shape) -> Extremities:
    """Persistent maxima of the average geodesic distance, at least 3 if there are as many maxima, at most 7."""
    owner = np.argmin(shape.distances, axis=0)
    mass = np.bincount(owner, shape.basis.areas, minlength=len(shape.distances))
    average = mass @ shape.distances
    vertices, persistence = _persistent_maxima(average, shape)
    count = int(np.clip((persistence > PERSISTENCE).sum(), FEWEST, MOST))
    vertices, persistence = vertices[:count], persistence[:count]
    return Extremities(vertices, average[vertices], persistence)


def pairings(
    first: Shape, tips_first: Extremities, second: Shape, tips_second: Extremities
) -> list[tuple[Integers, Integers]]:
    """The most consistent pairings of two shapes' extremities, the best first: numbers in each, in parallel."""
    distances, average, persistence = (
        [per_shape(shape, tips) for shape, tips in ((first, tips_first), (second, tips_second))]
        for per_shape in (_between, lambda _, tips: tips.average_distance, lambda _, tips: tips.persistence)
    )
    for side in range(2):
        unit = average[side].mean()
        distances[side], average[side] = distances[side] / unit, average[side] / unit
    full = min(len(average[0]), len(average[1]))
    kept: list[tuple[Integers, Integers]] = []
    for size, most in ((full, COMPLETE), (full - 1, PARTIAL)):
        if size < FEWEST - 1:
            break
        left, right = _all_pairings(len(average[0]), len(average[1]), size)
        i, j = np.triu_indices(size, k=1)
        cost = np.abs(distances[0][left[:, i], left[:, j]] - distances[1][right[:, i], right[:, j]]).mean(axis=1)
        cost += 0.5 * np.abs(average[0][left] - average[1][right]).mean(axis=1)
        cost += 0.5 * np.abs(persistence[0][left] - persistence[1][right]).mean(axis=1)
        complete = [set(zip(a.tolist(), b.tolist(), strict=True)) for a, b in kept]
        found = 0
        for row in np.argsort(cost, kind="stable"):
            pairs = set(zip(left[row].tolist(), right[row].tolist(), strict=True))
            if not any(pairs < other for other in complete):
                kept.append((left[row], right[row]))
                found += 1
            if found == most:
                break
    return kept


def _all_pairings(count_first: int, count_second: int, size: int) -> tuple[Integers, Integers]:
    """All injective pairings of `size` elements of each of two sets: numbers in each, (p, size)."""
    orders = np.array(list(permutations(range(count_second), size)), dtype=np.int64)
    subsets = np.array(list(combinations(range(count_first), size)), dtype=np.int64)
    return np.repeat(subsets, len(orders), axis=0), np.tile(orders, (len(subsets), 1))


def _between(shape: Shape, tips: Extremities) -> Floats:
    """(m, m) geodesic distances between the extremities, by way of the nearest samples' distances."""
    return np.asarray(places_on(shape, tips.vertices).distances[tips.vertices])


def _persistent_maxima(values: Floats, shape: Shape) -> tuple[Integers, Floats]:
    """Local maxima of a function on the mesh and their persistence, by falling persistence.

    Vertices are taken from the highest down; where two hills meet, the lower one ends.
    """
    graph = edge_graph(shape.mesh.vertices, shape.mesh.triangles)
    neighbours = np.split(graph.indices, graph.indptr[1:-1])
    rank = np.empty(len(values), dtype=np.int64)
    order = np.argsort(-values, kind="stable")
    rank[order] = np.arange(len(values))
    hill = np.full(len(values), -1)  # union-find: a link towards the hill's highest vertex
    persistence: dict[int, float] = {}

    def top(vertex: int) -> int:
        while hill[vertex] != vertex:
            hill[vertex] = hill[hill[vertex]]
            vertex = hill[vertex]
        return vertex

    for vertex in order:
        hill[vertex] = vertex
        for neighbour in neighbours[vertex]:
            if rank[neighbour] > rank[vertex]:
                continue
            a, b = top(int(vertex)), top(int(neighbour))
            if a == b:
                continue
            higher, lower = (a, b) if rank[a] < rank[b] else (b, a)
            if lower != vertex:
                persistence[lower] = float(values[lower] - values[vertex])
            hill[lower] = higher
    persistence[int(order[0])] = float(values[order[0]] - values[order[-1]])
    maxima = sorted(persistence, key=lambda vertex: -persistence[vertex])
    return np.array(maxima), np.array([persistence[vertex] for vertex in maxima])
