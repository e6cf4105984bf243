# SPDX-License-Identifier: GPL-3.0-or-later
"""Data on edges: lines such as seams, creases and sharp edges, traced along the target's edges; marked vertices.

Edges of the target do not correspond to single edges of the source, and the nearest edges would form dashes. So the
lines of the source's marked edges are traced as a whole: each chain of edges, from one junction to the next, becomes
the shortest nearby path along the target's edges. The target is mapped onto the source to measure distances from a line
there. A step of a path costs its length, or that of the line between its ends if this is longer; then the difference is
added again, so that no path skips from one reach of a line to another. The cost grows with the distance from the line.
Values are taken along the line.

Values of most edges are a field instead of lines: they are read around the middle of each edge. Where all edges of
neighbouring faces have a value, they fill an area, and only its outline is a line.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.messages import message
from zoomout_core.runtime.threads import threads
from zoomout_core.transfer.attribute import Attribute, is_nothing, nothing
from zoomout_core.transfer.edge_graph import MAX_DISTANCE, EdgeGraph, LocatedPoints, MappedGraph, locate_points
from zoomout_core.transfer.groups import expand_ranges, find, first_of_each
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.polylines import Polylines, PolylineSamples, polylines_of, runs, sample

# Smaller shares of a length are rounding.
ROUNDING = 1e-6
# Points of lines that are traced together; bounds the memory.
BLOCK = 1 << 16
# Above this share of edges with a value, the values are a field and not lines.
MAX_MARKED_SHARE = 0.5
# Edge length of the source relative to the target's above which every edge may be a separate line.
MAX_COARSENESS = 2.0
# Spacing of points sampled on lines, in edges of the target: each edge is hit several times.
LINE_SPACING = 1 / 3
# Maximum gap of a line that is bridged, in edges of the target; shorter pieces between gaps are dropped.
MAX_GAP = 4.0
# Distances, in edges of the target, that a path may leave the faces crossed by its line. The next is tried if there is
# no path, because the map tears these faces apart.
SEARCH_RINGS = (2, 4, 8)
# Added to the cost of a step, relative to its length, for each edge length of distance from the line.
DISTANCE_COST = 2.0
# Length of a path relative to its line above which it is rejected: it goes around a tear of the map.
MAX_DETOUR = 3.0
# A loop is divided at its thirds, or at a vertex up to this share of its length away.
ANCHOR_RANGE = 1 / 12


def transfer_edges(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer values at edges: lines of edges become lines; if most edges have a value, they are a field."""
    values = np.asarray(attribute.values)
    marked = ~is_nothing(values)
    source, target = EdgeGraph(mapped.source), EdgeGraph(mapped.target)
    if not (marked.any() and len(target.ends)):
        return replace(attribute, values=nothing(values, len(mapped.target.edges)))
    mapped_graph = MappedGraph(mapped, target)
    if np.median(source.lengths) > MAX_COARSENESS * mapped_graph.edge_length:
        return _trace(attribute, marked, source, mapped_graph)
    if marked.mean() > MAX_MARKED_SHARE:
        return _transfer_field(attribute, mapped)
    solid = _solid(marked, source)
    traced = _trace(attribute, marked & ~solid, source, mapped_graph)
    if not solid.any():
        return traced
    nearest = _nearest_edges(mapped, np.flatnonzero(solid | ~marked))
    inside = solid[nearest] & is_nothing(traced.values)
    traced.values[inside] = values[nearest[inside]]
    return traced


def snap_marks(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer marks of single vertices: each goes to the nearest vertex; the largest wins if several meet."""
    values = np.asarray(attribute.values)
    marked = np.flatnonzero(~is_nothing(values))
    edge_graph = EdgeGraph(mapped.target)
    place = locate_points(mapped.source.vertices[marked], MappedGraph(mapped, edge_graph))
    # The last entry is for vertices without a graph vertex.
    at_vertices = np.zeros(len(edge_graph.surface_vertex) + 1, dtype=values.dtype)
    np.maximum.at(at_vertices, place.nearest[place.covered], values[marked[place.covered]])
    left = int((~place.covered).sum())
    note = (
        message(
            "{layer}: {left:,} of {count:,} marked vertices were left out, where the target has no "
            "reliable partner on the source.",
            layer=attribute.name,
            left=left,
            count=len(marked),
        ),
    )
    values = at_vertices[mapped.target.working.vertex_of]
    return replace(attribute, values=values, notes=attribute.notes + note * bool(left))


# --- fields -------------------------------------------------------------------------------------------------


def _transfer_field(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer a field of values at edges: floats by way of the vertices, others from the nearest edge."""
    values, source, target = np.asarray(attribute.values), mapped.source, mapped.target
    if values.dtype.kind == "f":
        ends = source.edges.ravel()
        table = csr_array((np.ones(len(ends)), (ends, np.arange(len(ends)) // 2)), (len(source.vertices), len(values)))
        sums = (table @ values.reshape(len(values), -1)) / np.maximum(table.sum(axis=1), 1).reshape(-1, 1)
        mixed = mapped.surface_map.interpolate(sums)[target.edges].mean(axis=1)
        return replace(attribute, values=mixed.reshape(-1, *values.shape[1:]).astype(values.dtype))
    return replace(attribute, values=values[_nearest_edges(mapped, np.arange(len(values)))])


def _nearest_edges(mapped: MappedTarget, chosen: Integers) -> Integers:
    """(e_t,) the chosen source edge whose middle is nearest to that of each target edge."""
    middles = mapped.source.vertices[mapped.source.edges[chosen]].mean(axis=1)
    found = cKDTree(middles).query(mapped.points[mapped.target.edges].mean(axis=1), workers=threads())[1]
    return chosen[found]


def _solid(marked: Booleans, source: EdgeGraph) -> Booleans:
    """(e_s,) which marked edges are between faces with all edges marked."""
    graph_edges = np.zeros(len(source.ends) + 1, dtype=bool)  # the last entry is for edges missing in the graph
    graph_edges[source.of_edge[marked]] = True
    graph_edges[-1] = False
    full = np.logical_and.reduceat(graph_edges[source.of_side], source.surface.face_start[:-1])
    graph_edges[source.of_side[~full[source.surface.corner_face]]] = False
    return marked & graph_edges[source.of_edge]


# --- lines --------------------------------------------------------------------------------------------------


class _Pieces(NamedTuple):
    """Parts of lines, each of which becomes a path."""

    first: Integers  # (p,) the first sample of each
    last: Integers  # (p,) the last sample of each
    loose_first: Booleans  # (p,) whether its line begins there, without a connecting line
    loose_last: Booleans  # (p,) whether its line ends there, without a connecting line


class _Steps(NamedTuple):
    """Steps of paths along edges of the target's graph."""

    piece: Integers  # (t,) the piece of the path
    graph_edge: Integers  # (t,) the edge of the graph
    sample: Integers  # (t,) the nearest sample of the line
    stray: Floats  # (t,) distance of the edge's ends from the line


def _trace(attribute: Attribute, marked: Booleans, source: EdgeGraph, mapped_graph: MappedGraph) -> Attribute:
    """Trace lines; edges elsewhere get no value."""
    values = np.asarray(attribute.values)
    edge = np.flatnonzero(marked)
    on_faces = source.of_edge[edge] >= 0
    graph_edge, index = np.unique(source.of_edge[edge[on_faces]], return_index=True)
    edge = edge[on_faces][index]
    chains = polylines_of(source.ends[graph_edge])
    samples = sample(chains, source.points, LINE_SPACING * mapped_graph.edge_length)
    place = _at_borders(locate_points(samples.point, mapped_graph), samples, source, mapped_graph)
    pieces = _pieces(chains, samples, place, mapped_graph)
    steps = _paths(pieces, samples, place, mapped_graph)
    kept = _without_spurs(steps, pieces, place, mapped_graph.edge_graph)
    result = nothing(values, len(mapped_graph.edge_graph.ends) + 1)  # last entry: loose edges, which the graph lacks
    result[steps.graph_edge[kept]] = values[edge[samples.edge[steps.sample[kept]]]]
    arrived = np.unique(steps.piece[np.isin(steps.graph_edge, steps.graph_edge[kept])])
    lost = np.setdiff1d(np.arange(len(pieces.first)), arrived)
    notes = _notes(attribute.name, int((~on_faces).sum()), samples, pieces, lost, mapped_graph.edge_length)
    return replace(attribute, values=result[mapped_graph.edge_graph.of_edge], notes=attribute.notes + notes)


def _at_borders(
    place: LocatedPoints, samples: PolylineSamples, source: EdgeGraph, mapped_graph: MappedGraph
) -> LocatedPoints:
    """Move places of the source's border to the target's border, if one is nearby."""
    at_border = np.flatnonzero(source.on_border[samples.vertex] & (samples.vertex >= 0))
    vertices = np.flatnonzero(mapped_graph.edge_graph.on_border)
    if len(at_border) == 0 or len(vertices) == 0:
        return place
    distance, found = cKDTree(mapped_graph.points[vertices]).query(samples.point[at_border])
    near = np.asarray(distance) <= MAX_DISTANCE * mapped_graph.edge_length
    nearest = place.nearest.copy()
    nearest[at_border[near]] = vertices[np.asarray(found)[near]]
    return place._replace(nearest=nearest)


def _pieces(chains: Polylines, samples: PolylineSamples, place: LocatedPoints, mapped_graph: MappedGraph) -> _Pieces:
    """Divide lines where the target does not cover them, and loops in three, so that no path doubles back."""
    chain, covered = samples.chain, _bridge(samples, place.covered, MAX_GAP * mapped_graph.edge_length)
    _, first, last = runs(chain, covered)
    first, last = first[covered[first]], last[covered[first]]
    starts = np.diff(chain, prepend=-1)[first] != 0
    stops = np.diff(chain, append=-1)[last] != 0
    meeting = np.bincount(np.concatenate([chains.begin, chains.end]))
    alone = [meeting[np.maximum(samples.vertex[ends], 0)] == 1 for ends in (first, last)]
    loose_first, loose_last = ~starts | alone[0], ~stops | alone[1]
    loop = starts & stops & (samples.vertex[first] == samples.vertex[last])
    thirds = [_anchors(first[loop], last[loop], samples, place, share) for share in (1 / 3, 2 / 3)]
    none = np.zeros(3 * int(loop.sum()), dtype=bool)
    return _Pieces(
        np.concatenate([first[~loop], first[loop], *thirds]),
        np.concatenate([last[~loop], *thirds, last[loop]]),
        np.concatenate([loose_first[~loop], none]),
        np.concatenate([loose_last[~loop], none]),
    )


def _bridge(samples: PolylineSamples, covered: Booleans, longest: float) -> Booleans:
    """(q,) samples that count as covered, after closing short gaps and dropping short pieces between gaps."""
    chain, along = samples.chain, samples.along
    for state in (False, True):
        run, first, last = runs(chain, covered)
        inside = (np.diff(chain, prepend=-1)[first] == 0) & (np.diff(chain, append=-1)[last] == 0)
        short = inside & (along[last] - along[first] < longest) & (covered[first] == state)
        covered = covered ^ short[run]
    return covered


def _anchors(first: Integers, last: Integers, samples: PolylineSamples, place: LocatedPoints, share: float) -> Integers:
    """(l,) a sample of each loop near a share of its length, as close to a target vertex as possible."""
    owner, index = expand_ranges(first, last + 1)
    length = (samples.along[last] - samples.along[first])[owner]
    part = (samples.along[index] - samples.along[first[owner]]) / length
    off = np.abs(part - share)
    # Prefer samples near a third, then near a vertex; a loop with few samples takes any.
    outside = off >= ANCHOR_RANGE
    return index[first_of_each(owner, np.where(outside, off, place.distance[index]), outside)]


def _paths(pieces: _Pieces, samples: PolylineSamples, place: LocatedPoints, mapped_graph: MappedGraph) -> _Steps:
    """The steps of the paths of all pieces, traced in blocks; pieces without a path are retried with more room."""
    none = np.zeros(0, dtype=np.int64)
    parts = [_Steps(none, none, none, np.zeros(0))]
    left = np.arange(len(pieces.first))
    for rings in SEARCH_RINGS:
        block_of = np.cumsum((pieces.last - pieces.first + 1)[left]) // BLOCK
        blocks = [left[block_of == block] for block in np.unique(block_of)]
        parts += [_paths_of(block, rings, pieces, samples, place, mapped_graph) for block in blocks]
        moving = place.nearest[pieces.first[left]] != place.nearest[pieces.last[left]]
        left = np.setdiff1d(left[moving], np.concatenate([part.piece for part in parts]))
    return _Steps(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _paths_of(
    chosen: Integers,
    rings: int,
    pieces: _Pieces,
    samples: PolylineSamples,
    place: LocatedPoints,
    mapped_graph: MappedGraph,
) -> _Steps:
    """The steps of the paths of some pieces, each in a separate graph of the vertices around its line."""
    edge_graph, count = mapped_graph.edge_graph, len(mapped_graph.edge_graph.surface_vertex)
    piece, index = expand_ranges(pieces.first[chosen], pieces.last[chosen] + 1)
    met = np.column_stack([place.vertices[index], place.nearest[index]])
    nodes = _band(np.unique(piece[:, None] * count + met), rings, edge_graph)
    owner, vertex = np.divmod(nodes, count)
    nearest, along, stray = _beside(owner, mapped_graph.points[vertex], piece, index, samples)

    start, graph_edges, other = edge_graph.around
    node, entry = expand_ranges(start[vertex], start[vertex + 1])
    there = find(nodes, owner[node] * count + other[entry])
    inside = there > node
    a, b, graph_edge = node[inside], there[inside], graph_edges[entry[inside]]
    passed = np.abs(along[a] - along[b])
    direct = np.linalg.norm(mapped_graph.points[vertex[a]] - mapped_graph.points[vertex[b]], axis=1)
    away = (stray[a] + stray[b]) / (2 * mapped_graph.edge_length)
    walked = np.maximum(mapped_graph.scale * edge_graph.lengths[graph_edge], passed)
    cost = walked * (1 + DISTANCE_COST * away) + np.maximum(passed - direct, 0)
    cost = np.maximum(cost, 1e-9 * mapped_graph.edge_length)  # zeros would be missing edges
    graph = csr_array((cost, (a, b)), shape=(len(nodes), len(nodes)))

    begin, end = (
        np.searchsorted(nodes, np.arange(len(chosen)) * count + place.nearest[at[chosen]])
        for at in (pieces.first, pieces.last)
    )
    _, before, _ = dijkstra(graph, directed=False, indices=begin, return_predecessors=True, min_only=True)
    here = end[(before[end] >= 0) & (end != begin)]
    steps = [np.zeros((0, 2), dtype=np.int64)]
    while len(here):
        steps.append(np.stack([before[here], here], axis=1))
        here = before[here]
        here = here[before[here] >= 0]
    step = np.concatenate(steps)
    graph_edge = edge_graph.edge_between(vertex[step])
    of = owner[step[:, 0]]
    travelled = np.bincount(of, mapped_graph.scale * edge_graph.lengths[graph_edge], minlength=len(chosen))
    straight = samples.along[pieces.last[chosen]] - samples.along[pieces.first[chosen]]
    kept = (travelled <= MAX_DETOUR * straight + MAX_GAP * mapped_graph.edge_length)[of]
    of, step = of[kept], step[kept]
    return _Steps(chosen[of], graph_edge[kept], nearest[step].sum(axis=1) // 2, stray[step].sum(axis=1))


def _band(nodes: Integers, rings: int, edge_graph: EdgeGraph) -> Integers:
    """Add the vertices a few edges away to sorted numbers piece * k + vertex."""
    start, _, other = edge_graph.around
    count = len(edge_graph.surface_vertex)
    for _ in range(rings):
        owner, vertex = np.divmod(nodes, count)
        node, entry = expand_ranges(start[vertex], start[vertex + 1])
        nodes = np.unique(np.concatenate([nodes, owner[node] * count + other[entry]]))
    return nodes


def _beside(
    owner: Integers, points: Floats, piece: Integers, index: Integers, samples: PolylineSamples
) -> tuple[Integers, Floats, Floats]:
    """Locate points relative to the lines of their pieces.

    Args:
        owner: (n,) the piece of each point.
        points: (n, 3) positions on the source.
        piece: (q,) the piece of each sample.
        index: (q,) the number of each sample.
        samples: all samples.

    Returns:
        (n,) the nearest sample, (n,) the position of the line's nearest point along it, and (n,) its distance.
    """
    # Pieces are far apart in a fourth dimension, so that each point finds its own piece.
    apart = 2 * float(np.linalg.norm(np.ptp(np.concatenate([points, samples.point[index]]), axis=0)))
    tree = cKDTree(np.column_stack([samples.point[index], piece * apart]))
    _, found = tree.query(np.column_stack([points, owner * apart]), workers=threads())
    nearest, along = index[found], samples.along[index[found]]
    stray = np.linalg.norm(samples.point[nearest] - points, axis=1)
    for step in (-1, 1):
        beside = np.clip(found + step, 0, len(index) - 1)
        beside = index[np.where(piece[beside] == owner, beside, found)]
        way = samples.point[beside] - samples.point[nearest]
        square = np.einsum("nx,nx->n", way, way)
        share = np.einsum("nx,nx->n", points - samples.point[nearest], way) / np.maximum(square, 1e-300)
        share = np.clip(share, 0, 1)
        distance = np.linalg.norm(samples.point[nearest] + share[:, None] * way - points, axis=1)
        closer = distance < stray
        there = samples.along[nearest] + share * (samples.along[beside] - samples.along[nearest])
        along, stray = np.where(closer, there, along), np.where(closer, distance, stray)
    return nearest, along, stray


def _without_spurs(steps: _Steps, pieces: _Pieces, place: LocatedPoints, edge_graph: EdgeGraph) -> Integers:
    """Keep steps, one per graph edge, that lead to another step or to the end of a line."""
    kept = first_of_each(steps.graph_edge, steps.stray)
    ends = np.zeros(len(edge_graph.surface_vertex), dtype=bool)
    ends[place.nearest[pieces.first[pieces.loose_first]]] = True
    ends[place.nearest[pieces.last[pieces.loose_last]]] = True
    while True:
        vertices = edge_graph.ends[steps.graph_edge[kept]]
        meeting = np.bincount(vertices.ravel(), minlength=len(edge_graph.surface_vertex))
        leads_on = ((meeting[vertices] > 1) | ends[vertices]).all(axis=1)
        if leads_on.all():
            return kept
        kept = kept[leads_on]


def _notes(
    name: str, loose: int, samples: PolylineSamples, pieces: _Pieces, lost: Integers, edge_length: float
) -> tuple[str, ...]:
    """Notes on lost values: of loose edges, of parts that the target lacks, and of pieces without a path."""
    notes = []
    if loose:
        notes.append(
            message(
                "{layer}: {count:,} edges of the source belong to no face and were left out.", layer=name, count=loose
            )
        )
    last = np.flatnonzero(np.diff(samples.chain, append=-1))
    total = float(samples.along[last].sum())
    length = samples.along[pieces.last] - samples.along[pieces.first]
    missing = 1 - float(length.sum()) / total if total else 0.0
    if missing > ROUNDING:
        notes.append(
            message(
                "{layer}: {share:.1%} of the length of its lines was left out, where the target has no "
                "reliable partner on the source.",
                layer=name,
                share=missing,
            )
        )
    torn = float(length[lost][length[lost] > edge_length].sum())
    if torn:
        notes.append(
            message(
                "{layer}: {share:.1%} of the length of its lines was left out, where the map is "
                "discontinuous or the target's edges are too long.",
                layer=name,
                share=torn / total,
            )
        )
    return tuple(notes)
