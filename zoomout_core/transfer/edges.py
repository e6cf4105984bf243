"""Data on edges: lines such as seams, creases and sharp edges, drawn anew along the target's edges; marked vertices.

No edge of the target corresponds to one of the source, and the nearest edges of each form dashes. So the lines that
the source's marked edges form are traced whole: each chain of edges, from one junction to the next, becomes the
shortest path along the target's edges that stays near it. The target is laid onto the source by the map, so that
distances from a line are measured there. A step of a path costs its length, or that of the line between its ends
where this is larger, and what it cuts short once more, so that no path skips from one reach of a line to another; and
the more, the farther from the line it goes. Values are taken along the line.

Values that most edges have are no lines, but a field: they are read around the middle of each edge. Where all edges of
neighbouring faces have one, they fill an area, whose outline alone is a line.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.runtime.threads import threads
from zoomout_core.transfer.attribute import Attribute, is_nothing, nothing
from zoomout_core.transfer.cut_mesh import ragged
from zoomout_core.transfer.edge_graph import REACH, Laid, Place, Web, placed
from zoomout_core.transfer.mapped_target import Draped
from zoomout_core.transfer.polylines import Chains, Samples, runs, sample, string_together

# Where more than this part of the edges have a value, these are no lines,
MOST_MARKED = 0.5
# unless they are this many times as long as the target's: then every edge may be a line of its own.
COARSE = 2.0
# Points of lines are this part of the target's edges apart.
SPACING = 1 / 3
# A gap of a line in the target is bridged, and a piece between two gaps dropped, if shorter than so many edges.
GAP = 4.0
# A path keeps to vertices that are at most so many edges away from the faces that its line crosses: where the map
# tears these apart, to more.
RINGS = 2, 4, 8
# So much the cost of a step grows for each edge's length that it is away from its line.
STRAYING = 2.0
# A path that takes so many times the length of its line goes around a tear of the map.
DETOUR = 3.0
# A part of a length that is as good as nothing.
ROUNDING = 1e-6
# Points of lines that are traced together: bounds the memory.
BLOCK = 1 << 16


def transfer_edges(attribute: Attribute, draped: Draped) -> Attribute:
    """Values at edges: lines of edges that have one become lines; where most have one, a field of values."""
    values = np.asarray(attribute.values)
    marked = ~is_nothing(values)
    source, target = Web(draped.source), Web(draped.target)
    if not (marked.any() and len(target.ends)):
        return replace(attribute, values=nothing(values, len(draped.target.edges)))
    laid = Laid(draped, target)
    if np.median(source.lengths) > COARSE * laid.edge_length:
        return _traced(attribute, marked, source, laid)
    if marked.mean() > MOST_MARKED:
        return _spread(attribute, draped)
    solid = _solid(marked, source)
    traced = _traced(attribute, marked & ~solid, source, laid)
    if not solid.any():
        return traced
    nearest = _nearest_edges(draped, np.flatnonzero(solid | ~marked))
    inside = solid[nearest] & is_nothing(traced.values)
    traced.values[inside] = values[nearest[inside]]
    return traced


def snap_marks(attribute: Attribute, draped: Draped) -> Attribute:
    """Values at vertices that single ones have: each goes to the nearest vertex, the largest where several meet."""
    values = np.asarray(attribute.values)
    marked = np.flatnonzero(~is_nothing(values))
    web = Web(draped.target)
    place = placed(draped.source.vertices[marked], Laid(draped, web))
    at_knots = np.zeros(len(web.vertex) + 1, dtype=values.dtype)  # the last for vertices without a knot
    np.maximum.at(at_knots, place.nearest[place.covered], values[marked[place.covered]])
    left = int((~place.covered).sum())
    note = (
        f"{attribute.name}: {left} of {len(marked)} marked vertices were left out, where the target has no counterpart "
        "of the source that can be trusted.",
    )
    values = at_knots[draped.target.working.vertex_of]
    return replace(attribute, values=values, notes=attribute.notes + note * bool(left))


# --- fields -------------------------------------------------------------------------------------------------


def _spread(attribute: Attribute, draped: Draped) -> Attribute:
    """Values of a field at edges: floats by way of the vertices, all others those of the nearest edge."""
    values, source, target = np.asarray(attribute.values), draped.source, draped.target
    if values.dtype.kind == "f":
        ends = source.edges.ravel()
        table = csr_array((np.ones(len(ends)), (ends, np.arange(len(ends)) // 2)), (len(source.vertices), len(values)))
        sums = (table @ values.reshape(len(values), -1)) / np.maximum(table.sum(axis=1), 1).reshape(-1, 1)
        mixed = draped.surface_map.interpolate(sums)[target.edges].mean(axis=1)
        return replace(attribute, values=mixed.reshape(-1, *values.shape[1:]).astype(values.dtype))
    return replace(attribute, values=values[_nearest_edges(draped, np.arange(len(values)))])


def _nearest_edges(draped: Draped, chosen: Integers) -> Integers:
    """(e_t,) which of chosen edges of the source has its middle nearest to that of each of the target's."""
    middles = draped.source.vertices[draped.source.edges[chosen]].mean(axis=1)
    found = cKDTree(middles).query(draped.points[draped.target.edges].mean(axis=1), workers=threads())[1]
    return chosen[found]


def _solid(marked: Booleans, source: Web) -> Booleans:
    """(e_s,) which marked edges are between faces all of whose edges are marked."""
    strands = np.zeros(len(source.ends) + 1, dtype=bool)  # the last for what is no strand
    strands[source.of_edge[marked]] = True
    strands[-1] = False
    full = np.logical_and.reduceat(strands[source.of_side], source.surface.face_start[:-1])
    strands[source.of_side[~full[source.surface.corner_face]]] = False
    strands[-1] = False
    return marked & strands[source.of_edge]


# --- lines --------------------------------------------------------------------------------------------------


class _Pieces(NamedTuple):
    """Parts of lines that become a path each.

    Attributes:
        first: (p,) the sample that each begins with, and
        last: (p,) ends with.
        loose_first: (p,) whether its line begins there, and
        loose_last: (p,) ends there, with no other line going on.
    """

    first: Integers
    last: Integers
    loose_first: Booleans
    loose_last: Booleans


class _Steps(NamedTuple):
    """Steps of paths along strands of the target.

    Attributes:
        piece: (t,) whose path they are part of.
        strand: (t,) the strand.
        sample: (t,) the sample of the line that is nearest to it.
        stray: (t,) how far the strand's ends are from the line.
    """

    piece: Integers
    strand: Integers
    sample: Integers
    stray: Floats


def _traced(attribute: Attribute, marked: Booleans, source: Web, laid: Laid) -> Attribute:
    """Values at the edges of lines, and none elsewhere."""
    values = np.asarray(attribute.values)
    edge = np.flatnonzero(marked)
    on_faces = source.of_edge[edge] >= 0
    strand, index = np.unique(source.of_edge[edge[on_faces]], return_index=True)
    edge = edge[on_faces][index]
    chains = string_together(source.ends[strand])
    samples = sample(chains, source.points, SPACING * laid.edge_length)
    place = _at_borders(placed(samples.point, laid), samples, source, laid)
    pieces = _pieces(chains, samples, place, laid)
    steps = _paths(pieces, samples, place, laid)
    kept = _without_spurs(steps, pieces, place, laid.web)
    result = nothing(values, len(laid.web.ends) + 1)  # the last for loose edges, whose strand is -1
    result[steps.strand[kept]] = values[edge[samples.edge[steps.sample[kept]]]]
    arrived = np.unique(steps.piece[np.isin(steps.strand, steps.strand[kept])])
    lost = np.setdiff1d(np.arange(len(pieces.first)), arrived)
    notes = _notes(attribute.name, int((~on_faces).sum()), samples, pieces, lost, laid.edge_length)
    return replace(attribute, values=result[laid.web.of_edge], notes=attribute.notes + notes)


def _at_borders(place: Place, samples: Samples, source: Web, laid: Laid) -> Place:
    """The places, where those of the source's border are at the target's, if one is about there."""
    at_border = np.flatnonzero(source.on_border[samples.vertex] & (samples.vertex >= 0))
    knots = np.flatnonzero(laid.web.on_border)
    if len(at_border) == 0 or len(knots) == 0:
        return place
    distance, found = cKDTree(laid.points[knots]).query(samples.point[at_border])
    near = np.asarray(distance) <= REACH * laid.edge_length
    nearest = place.nearest.copy()
    nearest[at_border[near]] = knots[np.asarray(found)[near]]
    return place._replace(nearest=nearest)


def _pieces(chains: Chains, samples: Samples, place: Place, laid: Laid) -> _Pieces:
    """Divide lines where the target does not cover them, and loops in three, so that no path is its own way back."""
    chain, covered = samples.chain, _bridged(samples, place.covered, GAP * laid.edge_length)
    run = runs(chain, covered)
    first = np.flatnonzero(np.diff(run, prepend=-1)) if len(run) else run
    last = np.append(first[1:], len(run)) - 1 if len(run) else run
    kept = covered[first]
    first, last = first[kept], last[kept]
    starts = np.diff(chain, prepend=-1)[first] != 0 if len(chain) else covered[first]
    stops = np.diff(chain, append=-1)[last] != 0 if len(chain) else covered[last]
    meeting = np.bincount(np.concatenate([chains.begin, chains.end])) if len(chain) else first
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


def _bridged(samples: Samples, covered: Booleans, longest: float) -> Booleans:
    """(q,) the samples that count as covered, without short gaps and without short pieces between gaps."""
    chain, along = samples.chain, samples.along
    for state in (False, True):
        if not len(chain):
            break
        run = runs(chain, covered)
        first = np.flatnonzero(np.diff(run, prepend=-1))
        last = np.append(first[1:], len(run)) - 1
        inside = (np.diff(chain, prepend=-1)[first] == 0) & (np.diff(chain, append=-1)[last] == 0)
        short = inside & (along[last] - along[first] < longest) & (covered[first] == state)
        covered = covered ^ short[run]
    return covered


def _anchors(first: Integers, last: Integers, samples: Samples, place: Place, share: float) -> Integers:
    """(l,) a sample of each loop near a share of its length, as near to a knot of the target as may be."""
    owner, index = ragged(np.arange(len(first)), first, last + 1, np.arange(len(samples.chain)))
    length = (samples.along[last] - samples.along[first])[owner]
    part = (samples.along[index] - samples.along[first[owner]]) / length
    off = np.abs(part - share)
    # Near a third and near a knot; any sample will do where a loop has few.
    order = np.lexsort((np.where(off < 1 / 12, place.distance[index], off), off >= 1 / 12, owner))
    return index[order[np.flatnonzero(np.diff(owner[order], prepend=-1))]]


def _paths(pieces: _Pieces, samples: Samples, place: Place, laid: Laid) -> _Steps:
    """The steps of the paths of all pieces, traced in blocks; those without a path again with more room."""
    parts = [_Steps(*(np.zeros(0, dtype=t) for t in (np.int64, np.int64, np.int64, np.float64)))]
    left = np.arange(len(pieces.first))
    for rings in RINGS:
        block_of = np.cumsum((pieces.last - pieces.first + 1)[left]) // BLOCK
        blocks = [left[block_of == block] for block in np.unique(block_of)]
        parts += [_paths_of(block, rings, pieces, samples, place, laid) for block in blocks]
        moving = place.nearest[pieces.first[left]] != place.nearest[pieces.last[left]]
        left = np.setdiff1d(left[moving], np.concatenate([part.piece for part in parts]))
    return _Steps(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _paths_of(chosen: Integers, rings: int, pieces: _Pieces, samples: Samples, place: Place, laid: Laid) -> _Steps:
    """The steps of the paths of some pieces: each has a graph of its own, of the knots around its line."""
    web, count = laid.web, len(laid.web.vertex)
    every = np.arange(len(samples.chain))
    piece, index = ragged(np.arange(len(chosen)), pieces.first[chosen], pieces.last[chosen] + 1, every)
    met = np.column_stack([place.knots[index], place.nearest[index]])
    nodes = _band(np.unique(piece[:, None] * count + met), rings, web)
    owner, knot = np.divmod(nodes, count)
    nearest, along, stray = _beside(owner, laid.points[knot], piece, index, samples)

    start, strands, other = web.around
    node, entry = ragged(np.arange(len(nodes)), start[knot], start[knot + 1], np.arange(len(strands)))
    there = owner[node] * count + other[entry]
    place_of = np.minimum(np.searchsorted(nodes, there), len(nodes) - 1)
    inside = (nodes[place_of] == there) & (place_of > node)
    a, b, strand = node[inside], place_of[inside], strands[entry[inside]]
    passed = np.abs(along[a] - along[b])
    skipped = np.maximum(passed - np.linalg.norm(laid.points[knot[a]] - laid.points[knot[b]], axis=1), 0)
    away = (stray[a] + stray[b]) / (2 * laid.edge_length)
    cost = np.maximum(laid.scale * web.lengths[strand], passed) * (1 + STRAYING * away) + skipped
    cost = np.maximum(cost, 1e-9 * laid.edge_length)  # zeros would be no steps
    graph = csr_array((cost, (a, b)), shape=(len(nodes), len(nodes)))

    begin, end = (
        np.searchsorted(nodes, np.arange(len(chosen)) * count + place.nearest[at[chosen]])
        for at in (pieces.first, pieces.last)
    )
    _, before, _ = dijkstra(graph, directed=False, indices=begin, return_predecessors=True, min_only=True)
    here = end[(before[end] >= 0) & (end != begin)]
    walked = []
    while len(here):
        walked.append(np.stack([before[here], here], axis=1))
        here = before[here]
        here = here[before[here] >= 0]
    step = np.concatenate([np.zeros((0, 2), dtype=np.int64), *walked]).astype(np.int64)
    strand = web.strand_between(knot[step])
    of = owner[step[:, 0]]
    travelled = np.bincount(of, laid.scale * web.lengths[strand], minlength=len(chosen))
    straight = samples.along[pieces.last[chosen]] - samples.along[pieces.first[chosen]]
    direct = (travelled <= DETOUR * straight + GAP * laid.edge_length)[of]
    return _Steps(
        chosen[of[direct]],
        strand[direct],
        nearest[step].sum(axis=1)[direct] // 2,
        stray[step].sum(axis=1)[direct],
    )


def _band(nodes: Integers, rings: int, web: Web) -> Integers:
    """Numbers piece * k + knot, in rising order, with those of knots a few strands away."""
    start, _, other = web.around
    count = len(web.vertex)
    for _ in range(rings):
        owner, knot = np.divmod(nodes, count)
        owner, knot = ragged(owner, start[knot], start[knot + 1], other)
        nodes = np.unique(np.concatenate([nodes, owner * count + knot]))
    return nodes


def _beside(
    owner: Integers, points: Floats, piece: Integers, index: Integers, samples: Samples
) -> tuple[Integers, Floats, Floats]:
    """Where points are beside the lines of their pieces.

    Args:
        owner: (n,) the piece of each point.
        points: (n, 3) where they lie on the source.
        piece: (q,) the piece of each sample.
        index: (q,) its number.
        samples: all of them.

    Returns:
        (n,) the nearest sample, (n,) how far along the line the nearest point of it is, and (n,) how far away.
    """
    # Pieces are far apart in a fourth dimension, so that each point finds its own.
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


def _without_spurs(steps: _Steps, pieces: _Pieces, place: Place, web: Web) -> Integers:
    """The steps, one for each strand, that lead somewhere: to another, or to the end of a line."""
    order = np.lexsort((steps.stray, steps.strand))
    kept = order[np.flatnonzero(np.diff(steps.strand[order], prepend=-1))]
    ends = np.zeros(len(web.vertex), dtype=bool)
    ends[place.nearest[pieces.first[pieces.loose_first]]] = True
    ends[place.nearest[pieces.last[pieces.loose_last]]] = True
    while True:
        knots = web.ends[steps.strand[kept]]
        meeting = np.bincount(knots.ravel(), minlength=len(web.vertex))
        leads_on = ((meeting[knots] > 1) | ends[knots]).all(axis=1)
        if leads_on.all():
            return kept
        kept = kept[leads_on]


def _notes(
    name: str, loose: int, samples: Samples, pieces: _Pieces, lost: Integers, edge_length: float
) -> tuple[str, ...]:
    """What did not arrive: of loose edges, of parts that the target lacks, and of pieces that have no path."""
    notes = []
    if loose:
        notes.append(f"{name}: {loose} edges of the source belong to no face and were left out.")
    last = np.flatnonzero(np.diff(samples.chain, append=-1))
    total = float(samples.along[last].sum())
    length = samples.along[pieces.last] - samples.along[pieces.first]
    missing = 1 - float(length.sum()) / total if total else 0.0
    if missing > ROUNDING:
        notes.append(
            f"{name}: {missing:.1%} of the length of its lines was left out, where the target has no counterpart "
            "of the source that can be trusted."
        )
    torn = float(length[lost][length[lost] > edge_length].sum())
    if torn:
        notes.append(
            f"{name}: {torn / total:.1%} of the length of its lines was left out, where the map is torn or the "
            "target's edges are too long."
        )
    return tuple(notes)
