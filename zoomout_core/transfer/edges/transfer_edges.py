# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer data on edges, as lines or as a field, and marked vertices.

Marked edges, such as seams, creases and sharp edges, form lines, which are traced as a whole (`trace_lines.py`). Values
of most edges are a field instead: they are read at the middle of each edge. Where all edges of neighbouring faces have
a value, they fill an area, and only its outline is a line.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Integers
from zoomout_core.messages import message
from zoomout_core.runtime.threads import threads
from zoomout_core.transfer.attribute import Attribute, is_nothing, nothing
from zoomout_core.transfer.edges.edge_graph import EdgeGraph, MappedGraph, locate_points
from zoomout_core.transfer.edges.trace_lines import trace_lines
from zoomout_core.transfer.mapped_target import MappedTarget

# Share of edges with a value above which the values are a field and not lines.
MAX_MARKED_SHARE = 0.5
# Edge length of the source relative to the target's above which every edge may be a separate line.
MAX_COARSENESS = 2.0


def transfer_edges(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer values at edges: lines of edges become lines; if most edges have a value, they are a field."""
    values = np.asarray(attribute.values)
    marked = ~is_nothing(values)
    source, target = EdgeGraph(mapped.source), EdgeGraph(mapped.target)
    if not (marked.any() and len(target.ends)):
        return replace(attribute, values=nothing(values, len(mapped.target.edges)))
    mapped_graph = MappedGraph(mapped, target)
    if np.median(source.lengths) > MAX_COARSENESS * mapped_graph.edge_length:
        return trace_lines(attribute, marked, source, mapped_graph)
    if marked.mean() > MAX_MARKED_SHARE:
        return _transfer_field(attribute, mapped)
    solid = _solid(marked, source)
    traced = trace_lines(attribute, marked & ~solid, source, mapped_graph)
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
