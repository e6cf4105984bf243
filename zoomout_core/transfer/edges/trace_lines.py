# SPDX-License-Identifier: GPL-3.0-or-later
"""Trace lines of marked edges along the target's edges.

Edges of the target do not correspond to single edges of the source, and the nearest edges would form dashes. So lines
are traced as a whole: each chain of edges, from one junction to the next, becomes a path along the target's edges
(`line_paths.py`). Its edges take the values of the line beside them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Integers
from zoomout_core.messages import message, plural
from zoomout_core.transfer.attribute import Attribute, nothing
from zoomout_core.transfer.edges.edge_graph import MAX_DISTANCE, EdgeGraph, LocatedPoints, MappedGraph, locate_points
from zoomout_core.transfer.edges.line_paths import MAX_GAP, LinePieces, LocatedLines, PathSteps, find_paths
from zoomout_core.transfer.edges.polylines import Polylines, PolylineSamples, polylines_of, runs, sample
from zoomout_core.transfer.groups import expand_ranges, first_of_each

# Smaller shares of a length are rounding.
ROUNDING = 1e-6
# Spacing of points sampled on lines, in edges of the target: each edge is hit several times.
LINE_SPACING = 1 / 3
# A loop is divided at its thirds, or at a vertex up to this share of its length away.
ANCHOR_RANGE = 1 / 12


def trace_lines(attribute: Attribute, marked: Booleans, source: EdgeGraph, graph: MappedGraph) -> Attribute:
    """Trace the lines of marked edges; edges elsewhere get no value.

    Args:
        attribute: values at the source's edges.
        marked: (e_s,) which edges form lines.
        source: the source's graph.
        graph: the target's graph, mapped onto the source.
    """
    values = np.asarray(attribute.values)
    edge = np.flatnonzero(marked)
    on_faces = source.of_edge[edge] >= 0
    graph_edge, index = np.unique(source.of_edge[edge[on_faces]], return_index=True)
    edge = edge[on_faces][index]
    chains = polylines_of(source.ends[graph_edge])
    samples = sample(chains, source.points, LINE_SPACING * graph.edge_length)
    lines = LocatedLines(samples, _at_borders(locate_points(samples.point, graph), samples, source, graph), graph)
    pieces = _pieces(chains, lines)
    steps = find_paths(pieces, lines)
    kept = _without_spurs(steps, pieces, lines)
    result = nothing(values, len(graph.edge_graph.ends) + 1)  # the last entry is for loose edges, which the graph lacks
    result[steps.graph_edge[kept]] = values[edge[samples.edge[steps.sample[kept]]]]
    arrived = np.unique(steps.piece[np.isin(steps.graph_edge, steps.graph_edge[kept])])
    lost = np.setdiff1d(np.arange(len(pieces.first)), arrived)
    notes = _notes(attribute.name, int((~on_faces).sum()), pieces, lost, lines)
    return replace(attribute, values=result[graph.edge_graph.of_edge], notes=attribute.notes + notes)


def _at_borders(place: LocatedPoints, samples: PolylineSamples, source: EdgeGraph, graph: MappedGraph) -> LocatedPoints:
    """Move places of the source's border to the target's border, if one is nearby."""
    at_border = np.flatnonzero(source.on_border[samples.vertex] & (samples.vertex >= 0))
    vertices = np.flatnonzero(graph.edge_graph.on_border)
    if len(at_border) == 0 or len(vertices) == 0:
        return place
    distance, found = cKDTree(graph.points[vertices]).query(samples.point[at_border])
    near = np.asarray(distance) <= MAX_DISTANCE * graph.edge_length
    nearest = place.nearest.copy()
    nearest[at_border[near]] = vertices[np.asarray(found)[near]]
    return place._replace(nearest=nearest)


def _pieces(chains: Polylines, lines: LocatedLines) -> LinePieces:
    """Divide lines where the target does not cover them, and loops in three, so that no path doubles back."""
    samples, chain = lines.samples, lines.samples.chain
    covered = _bridge(samples, lines.place.covered, MAX_GAP * lines.graph.edge_length)
    _, first, last = runs(chain, covered)
    first, last = first[covered[first]], last[covered[first]]
    starts = np.diff(chain, prepend=-1)[first] != 0
    stops = np.diff(chain, append=-1)[last] != 0
    meeting = np.bincount(np.concatenate([chains.begin, chains.end]))
    alone = [meeting[np.maximum(samples.vertex[ends], 0)] == 1 for ends in (first, last)]
    loose_first, loose_last = ~starts | alone[0], ~stops | alone[1]
    loop = starts & stops & (samples.vertex[first] == samples.vertex[last])
    thirds = [_anchors(first[loop], last[loop], lines, share) for share in (1 / 3, 2 / 3)]
    none = np.zeros(3 * int(loop.sum()), dtype=bool)
    return LinePieces(
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


def _anchors(first: Integers, last: Integers, lines: LocatedLines, share: float) -> Integers:
    """(l,) a sample of each loop near a share of its length, as close to a target vertex as possible."""
    along = lines.samples.along
    owner, index = expand_ranges(first, last + 1)
    part = (along[index] - along[first[owner]]) / (along[last] - along[first])[owner]
    off = np.abs(part - share)
    # Prefer samples near a third, then near a vertex; a loop with few samples takes any.
    outside = off >= ANCHOR_RANGE
    return index[first_of_each(owner, np.where(outside, off, lines.place.distance[index]), outside)]


def _without_spurs(steps: PathSteps, pieces: LinePieces, lines: LocatedLines) -> Integers:
    """Keep steps, one per graph edge, that lead to another step or to the end of a line."""
    edge_graph, nearest = lines.graph.edge_graph, lines.place.nearest
    kept = first_of_each(steps.graph_edge, steps.stray)
    ends = np.zeros(len(edge_graph.surface_vertex), dtype=bool)
    ends[nearest[pieces.first[pieces.loose_first]]] = True
    ends[nearest[pieces.last[pieces.loose_last]]] = True
    while True:
        vertices = edge_graph.ends[steps.graph_edge[kept]]
        meeting = np.bincount(vertices.ravel(), minlength=len(edge_graph.surface_vertex))
        leads_on = ((meeting[vertices] > 1) | ends[vertices]).all(axis=1)
        if leads_on.all():
            return kept
        kept = kept[leads_on]


def _notes(name: str, loose: int, pieces: LinePieces, lost: Integers, lines: LocatedLines) -> tuple[str, ...]:
    """Notes on lost values: of loose edges, of parts that the target lacks, and of pieces without a path."""
    samples = lines.samples
    notes = []
    if loose:
        notes.append(
            plural(
                loose,
                "{layer}: 1 edge of the source belongs to no face and was left out.",
                "{layer}: {count:,} edges of the source belong to no face and were left out.",
                layer=name,
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
    torn = float(length[lost][length[lost] > lines.graph.edge_length].sum())
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
