"""From two surfaces to a dense map: prepare both, guess, refine and rank, bring the best to full resolution."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import dijkstra

from zoomout_core.correspondence.anchors import Anchors, beside
from zoomout_core.correspondence.confidence import confidence_of, cycle_error
from zoomout_core.correspondence.functional_map import functional_map_of
from zoomout_core.correspondence.initial.extremities import extremity_hypotheses
from zoomout_core.correspondence.initial.hypothesis import Hypothesis
from zoomout_core.correspondence.initial.landmarks import landmark_hypothesis
from zoomout_core.correspondence.initial.signs import sign_hypotheses
from zoomout_core.correspondence.nearest import nearest
from zoomout_core.correspondence.ranking import SCREENING_SIZE, Candidate, rank_steps
from zoomout_core.correspondence.shape import Shape, shape_steps
from zoomout_core.correspondence.surface_map import SurfaceMap
from zoomout_core.correspondence.zoomout import upsample
from zoomout_core.progress import Progress, Steps, drain, spread
from zoomout_core.projection import closest_points, project_to_embedding
from zoomout_core.surface import Floats, Integers, MeshError, Surface, WorkingMesh, edge_graph

Initial: TypeAlias = Literal["auto", "landmarks", "proximity", "given"]
Landmarks: TypeAlias = tuple[ArrayLike, ArrayLike]

SMALLEST_PART = 12
# Eigenfunctions that ranking needs, however small the final map.
FEWEST_FUNCTIONS = 120
# Weight of the landmarks' mean distance, at unit area, in the ranking: a flip costs about one.
LANDMARK_WEIGHT = 5.0
GIVEN_SIZE = 20
# Rounds on all vertices, each near the last one's images: they take back most of what sampling has cost.
FINISHING = 3


@dataclass(frozen=True, eq=False)
class Pair:
    """Two surfaces with their prepared main parts."""

    source: Surface
    target: Surface
    source_shape: Shape
    target_shape: Shape
    k_final: int
    step: int


@dataclass(frozen=True, eq=False)
class MatchResult:
    """A map from the target to the source, and what else is known about it.

    Attributes:
        surface_map: for every target vertex a point on the source surface.
        confidence: (n_t,) in [0, 1]; 0 where the map was not computed but carried over from nearby.
        functional_map: (k_target, k_source) between the bases of the main parts.
        candidates: all maps that were found, the most likely first.
        chosen: the number of the candidate that this result is made from.
        notes: what a user should know, a sentence each.
        pair: what other candidates are made from.
    """

    surface_map: SurfaceMap
    confidence: Floats
    functional_map: Floats
    candidates: tuple[Candidate, ...]
    chosen: int
    notes: tuple[str, ...]
    pair: Pair

    def use(self, candidate: int) -> MatchResult:
        """The result of another candidate, by its number."""
        return drain(self.use_steps(candidate))

    def use_steps(self, candidate: int) -> Steps[MatchResult]:
        """The same, stepped."""
        if not 0 <= candidate < len(self.candidates):
            raise ValueError(f"There is no candidate {candidate}: they are numbered 0 to {len(self.candidates) - 1}.")
        return _result_steps(self.pair, self.candidates, candidate, 0.0)


def match(
    source: Surface,
    target: Surface,
    initial: Initial = "auto",
    landmarks: Landmarks | None = None,
    initial_map: SurfaceMap | ArrayLike | None = None,
    k_final: int = 120,
    step: int = 5,
    samples: int = 1000,
    seed: int = 0,
) -> MatchResult:
    """Find for every vertex of the target the point on the source that it corresponds to.

    Args:
        source: the surface that the map lands on; it carries the attributes.
        target: the surface that the map starts from; it receives them.
        initial: how to begin. "auto": from the shapes alone. "landmarks": from the given pairs. "proximity":
            from the nearest points, where the two lie over each other. "given": from `initial_map`.
        landmarks: source vertices (m,) and the target vertices (m,) that correspond to them.
        initial_map: a source vertex for each target vertex (n_t,), a SurfaceMap, or a functional map
            (k_t, k_s) between `eigenbasis(source)` and `eigenbasis(target)`.
        k_final: size of the final functional map; less on meshes with fewer vertices.
        step: growth of the functional map in an iteration.
        samples: farthest points that the iterations run on.
        seed: of the eigensolver.

    Returns:
        The most likely map with the alternatives. What is uncertain stands in its `notes`.

    Raises:
        MeshError: a mesh that cannot be matched; the message says what to do.
        ValueError: arguments that do not fit together.
    """
    return drain(match_steps(source, target, initial, landmarks, initial_map, k_final, step, samples, seed))


def match_steps(
    source: Surface,
    target: Surface,
    initial: Initial = "auto",
    landmarks: Landmarks | None = None,
    initial_map: SurfaceMap | ArrayLike | None = None,
    k_final: int = 120,
    step: int = 5,
    samples: int = 1000,
    seed: int = 0,
) -> Steps[MatchResult]:
    """`match` as a generator that yields `Progress` and returns the result."""
    _check_start(initial, landmarks, initial_map)
    yield Progress(0.0, "Reading the meshes")
    k = max(k_final, FEWEST_FUNCTIONS)
    source_mesh, target_mesh = _main_part(source, "source"), _main_part(target, "target")
    source_shape = yield from spread(shape_steps(source_mesh, k, samples, seed), 0.0, 0.3, "Analysing the source")
    target_shape = yield from spread(shape_steps(target_mesh, k, samples, seed), 0.3, 0.6, "Analysing the target")
    pair = Pair(source, target, source_shape, target_shape, k_final, step)
    yield Progress(0.6, "Guessing")
    hypotheses = _hypotheses(pair, initial, landmarks, initial_map)
    ranking = rank_steps(hypotheses, source_shape, target_shape)
    candidates = yield from spread(ranking, 0.62, 0.75, "Comparing candidates")
    if landmarks is not None:
        candidates = _ranked_by_landmarks(candidates, pair, landmarks)
    return (yield from _result_steps(pair, tuple(candidates), 0, 0.75))


def _check_start(initial: str, landmarks: Landmarks | None, initial_map: object) -> None:
    known = ("auto", "landmarks", "proximity", "given")
    if initial not in known:
        raise ValueError(f"initial is {initial!r}: choose one of {', '.join(known)}.")
    if initial == "landmarks" and landmarks is None:
        raise ValueError("A start from landmarks needs `landmarks`: source vertices and target vertices.")
    if initial == "given" and initial_map is None:
        raise ValueError("A given start needs `initial_map`: a vertex map, a SurfaceMap or a functional map.")


def _main_part(surface: Surface, role: str) -> WorkingMesh:
    mesh, vertices = surface.working.part(0)
    if len(vertices) < SMALLEST_PART:
        raise MeshError(
            f"The largest part of the {role} has {len(vertices)} vertices, too few to be matched: "
            f"subdivide it to {SMALLEST_PART} or more."
        )
    return mesh


# --- where to begin -----------------------------------------------------------------------------------------


def _hypotheses(
    pair: Pair, initial: Initial, landmarks: Landmarks | None, initial_map: SurfaceMap | ArrayLike | None
) -> list[Hypothesis]:
    source, target = pair.source_shape, pair.target_shape
    if initial == "given":
        return [_given(pair, initial_map)]
    if initial == "proximity":
        triangle, barycentric = closest_points(
            _positions(pair.target, target.mesh), _positions(pair.source, source.mesh), source.mesh.triangles
        )
        vertex = SurfaceMap(triangle, barycentric, source.mesh.triangles).vertex
        return [_pointwise("nearest points in space", vertex, source, target)]
    hypotheses = extremity_hypotheses(source, target) + sign_hypotheses(source, target)
    if landmarks is None:
        return hypotheses
    by_landmarks = landmark_hypothesis(source, target, *_landmark_ids(pair, landmarks))
    assert by_landmarks.anchors is not None
    # Whatever a guess begins with, the landmarks hold it in place.
    held = [replace(guess, anchors=by_landmarks.anchors.and_those(guess.anchors)) for guess in hypotheses]
    return [by_landmarks, *held]


def _given(pair: Pair, initial_map: SurfaceMap | ArrayLike | None) -> Hypothesis:
    source, target = pair.source_shape, pair.target_shape
    array = initial_map.vertex if isinstance(initial_map, SurfaceMap) else np.asarray(initial_map)
    if array.ndim == 2:
        if array.shape[0] > len(target.basis.eigenvalues) or array.shape[1] > len(source.basis.eigenvalues):
            raise ValueError(f"The given functional map is {array.shape}, larger than the bases: give a smaller one.")
        return Hypothesis("a given functional map", array)
    if len(array) != len(pair.target.vertices) or array.min() < 0 or array.max() >= len(pair.source.vertices):
        raise ValueError(
            f"The given map must name one of {len(pair.source.vertices)} source vertices for each of "
            f"{len(pair.target.vertices)} target vertices."
        )
    # Of the vertices that were welded into one, any will do; images outside the main part go to the nearest in it.
    vertex = np.empty(len(target.mesh.vertices), dtype=np.int64)
    inside = target.mesh.vertex_of >= 0
    image = source.mesh.vertex_of[array]
    outside = image < 0
    if outside.any():
        image[outside] = nearest(pair.source.vertices[array[outside]], _positions(pair.source, source.mesh))
    vertex[target.mesh.vertex_of[inside]] = image[inside]
    return _pointwise("a given map", vertex, source, target)


def _pointwise(origin: str, vertex: Integers, source: Shape, target: Shape) -> Hypothesis:
    size = min(GIVEN_SIZE, len(source.basis.eigenvalues), len(target.basis.eigenvalues))
    return Hypothesis(origin, functional_map_of(vertex, source.basis, target.basis, size, size))


def _positions(surface: Surface, mesh: WorkingMesh) -> Floats:
    """(n, 3) the working mesh's vertices in the surface's own frame and unit."""
    used = np.flatnonzero(mesh.vertex_of >= 0)
    positions = np.empty_like(mesh.vertices)
    positions[mesh.vertex_of[used]] = surface.vertices[used]
    return positions


def _landmark_ids(pair: Pair, landmarks: Landmarks) -> tuple[Integers, Integers]:
    """The landmarks as vertices of the main parts."""
    ids = []
    for role, surface, shape, given in (
        ("source", pair.source, pair.source_shape, landmarks[0]),
        ("target", pair.target, pair.target_shape, landmarks[1]),
    ):
        vertices = np.atleast_1d(np.asarray(given, dtype=np.int64))
        if len(vertices) == 0 or vertices.min() < 0 or vertices.max() >= len(surface.vertices):
            raise ValueError(f"Landmarks on the {role} must be numbers of its {len(surface.vertices)} vertices.")
        on_mesh = shape.mesh.vertex_of[vertices]
        if (on_mesh < 0).any():
            raise MeshError(
                f"Vertex {vertices[on_mesh < 0][0]} of the {role} is a landmark off its largest part: move it."
            )
        ids.append(on_mesh)
    if len(ids[0]) != len(ids[1]):
        raise ValueError(f"{len(ids[0])} source and {len(ids[1])} target landmarks were given: they come in pairs.")
    return ids[0], ids[1]


def _ranked_by_landmarks(candidates: list[Candidate], pair: Pair, landmarks: Landmarks) -> list[Candidate]:
    source, target = pair.source_shape, pair.target_shape
    source_ids, target_ids = _landmark_ids(pair, landmarks)
    graph = edge_graph(source.mesh.vertices, source.mesh.triangles)
    distances = dijkstra(graph, directed=False, indices=source_ids)
    for candidate in candidates:
        queries, embedded = _embeddings(source, target, candidate.functional_map, candidate.anchors)
        image = nearest(queries[target_ids], embedded)
        candidate.scores["landmarks"] = float(distances[np.arange(len(image)), image].mean())
        candidate.scores["total"] += LANDMARK_WEIGHT * candidate.scores["landmarks"]
    return sorted(candidates, key=lambda candidate: (candidate.reverses_orientation, candidate.scores["total"]))


# --- from a candidate to the full surfaces ------------------------------------------------------------------


def _result_steps(pair: Pair, candidates: tuple[Candidate, ...], chosen: int, start: float) -> Steps[MatchResult]:
    candidate = candidates[chosen]
    source, target = pair.source_shape, pair.target_shape
    middle = (start + 1) / 2
    swapped = None if candidate.anchors is None else candidate.anchors.swapped()
    there, functional_map = yield from spread(
        _dense_steps(source, target, candidate.functional_map, candidate.anchors, pair),
        start,
        middle,
        "Refining",
    )
    back, _ = yield from spread(
        _dense_steps(target, source, candidate.reverse_functional_map, swapped, pair),
        middle,
        0.98,
        "Checking",
    )
    confidence = confidence_of(cycle_error(there, back, target.mesh.vertices))
    yield Progress(0.98, "Carrying over to all vertices")
    surface_map, confidence, notes = _on_surfaces(pair, there, confidence)
    return MatchResult(surface_map, confidence, functional_map, candidates, chosen, notes, pair)


def _dense_steps(
    source: Shape, target: Shape, functional_map: Floats, anchors: Anchors | None, pair: Pair
) -> Generator[float, None, tuple[SurfaceMap, Floats]]:
    """ZoomOut to the final size on all samples, then a precise point for every vertex of the target's mesh."""
    available = min(len(source.basis.eigenvalues), len(target.basis.eigenvalues))
    size = min(pair.k_final, available)
    start = min(SCREENING_SIZE, size, *functional_map.shape)
    at_samples = None if anchors is None else anchors.at(source.sampled.samples, target.sampled.samples)
    yield 0.0
    functional_map, _ = upsample(
        source.sampled, target.sampled, functional_map[:start, :start], size, pair.step, at_samples
    )
    k_target, k_source = functional_map.shape
    yield 0.4
    vertex = nearest(*_embeddings(source, target, functional_map, anchors))
    for i in range(FINISHING):
        yield 0.7 + 0.3 * i / FINISHING
        queries, embedded = _embeddings(source, target, functional_map, anchors)
        dense = SurfaceMap(
            *project_to_embedding(queries, embedded, source.mesh.triangles, vertex), source.mesh.triangles
        )
        vertex = dense.vertex
        pulled_back = dense.interpolate(source.basis.eigenvectors[:, :k_source])
        functional_map = target.basis.coefficients(pulled_back)[:k_target]
    return dense, functional_map


def _embeddings(source: Shape, target: Shape, functional_map: Floats, anchors: Anchors | None) -> tuple[Floats, Floats]:
    """Coordinates (n_t, d) of the target's vertices and (n_s, d) of the source's, near where they correspond."""
    k_target, k_source = functional_map.shape
    embedded = source.basis.eigenvectors[:, :k_source] @ functional_map.T
    if anchors is None:
        return target.basis.eigenvectors[:, :k_target], embedded
    return beside(target.basis.eigenvectors[:, :k_target], anchors.target), beside(embedded, anchors.source)


def _on_surfaces(
    pair: Pair, between_parts: SurfaceMap, confidence: Floats
) -> tuple[SurfaceMap, Floats, tuple[str, ...]]:
    """The map between the main parts' meshes as a map between the surfaces, in their own numbers."""
    source, target = pair.source_shape.mesh, pair.target_shape.mesh
    inside = target.vertex_of >= 0
    n = len(pair.target.vertices)
    triangle, barycentric, trust = np.zeros(n, dtype=np.int64), np.zeros((n, 3)), np.zeros(n)
    triangle[inside] = source.triangle_of[between_parts.triangle[target.vertex_of[inside]]]
    barycentric[inside] = between_parts.barycentric[target.vertex_of[inside]]
    trust[inside] = confidence[target.vertex_of[inside]]
    notes = []
    outside = ~inside & np.isfinite(pair.target.vertices).all(axis=1)
    if outside.any():
        # Loose parts follow the nearest place of the main part.
        main = between_main = np.flatnonzero(inside[pair.target.triangles[:, 0]])
        place, weights = closest_points(
            pair.target.vertices[outside], pair.target.vertices, pair.target.triangles[between_main]
        )
        known = SurfaceMap(triangle, barycentric, pair.source.triangles)
        carried = known.at(pair.source, pair.target, main[place], weights)
        triangle[outside], barycentric[outside] = carried.triangle, carried.barycentric
        parts = int(pair.target.components.max())
        notes.append(
            f"{int(outside.sum())} vertices of the target lie off its largest part ({parts} loose parts): they "
            "follow the nearest place of that part, with no confidence."
        )
    if pair.source.components.max() > 0:
        notes.append(
            f"The source has {int(pair.source.components.max())} loose parts beside its largest: nothing was "
            "matched to them."
        )
    barycentric[~inside & ~outside, 0] = 1
    return SurfaceMap(triangle, barycentric, pair.source.triangles), trust, tuple(notes)
