"""UV maps: every face of the target lies within one island of the source, on one side of each of its seams.

A face that might lie across a seam is sampled. Its samples fall onto one or several sheets: parts of the
source that are joined around the face without a seam between them, be they of different islands or the two
sides of a seam within one. The face takes one sheet by vote, and all its corners are read there; corners
beyond the sheet's border continue it linearly. Faces that agree about a corner share it, so the target has
seams only where the source has one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.cut_mesh import (
    CUT_TOLERANCE,
    CutSurface,
    adjacent_edges,
    cut_open,
    edge_lengths,
    face_edges,
    joined_groups,
    ragged,
)
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.potts import LOYALTY, Candidates, elect

# More parts than these do not meet in one face, unless it is larger than islands.
MOST_SHEETS = 4
# A corner picks its triangle this far towards the middle of its face, so that it stays on the face's side.
INWARD = 0.01
# Faces whose UVs at a common edge differ by less than this part of their size run on into each other.
AGREEMENT = 0.25
# Corners of joined faces that differ by less than this part of the UVs' range differ by rounding.
SAME_CORNER = 1e-9
# Beyond a border UVs run on at most this many times as fast as their island's do on average.
MOST_STEEP = 4.0
# Faces are reported when their UVs are this many times as long, or as short, as the source's are there,
STRETCHED = 4.0
# or cover less than this part of what the source's would.
DEGENERATE = 1e-3


@dataclass(frozen=True, eq=False)
class Chart:
    """A UV map of the source, cut at its seams.

    Attributes:
        cut: the source, cut open.
        uv: (c, 2) values at its corners.
        density: (islands,) mean UV length for a unit of length.
        lower: (islands, 2) and
        upper: (islands, 2) the UDIM tile that an island lies in, each way; infinite where in several.
    """

    cut: CutSurface
    uv: Floats
    density: Floats
    lower: Floats
    upper: Floats

    def at(self, triangle: Integers, barycentric: Floats) -> Floats:
        """(q, 2) UVs at points of the source."""
        return np.einsum("qc,qcx->qx", barycentric, self.uv[self.cut.surface.triangle_corners[triangle]])

    def beyond(self, triangle: Integers, barycentric: Floats, points: Floats) -> Floats:
        """(q, 2) UVs at points (q, 3) beyond an island, continued from the triangle closest to each."""
        surface = self.cut.surface
        a, b, c = (surface.vertices[surface.triangles[triangle, i]] for i in range(3))
        uv_a, uv_b, uv_c = (self.uv[surface.triangle_corners[triangle, i]] for i in range(3))
        ab, ac = b - a, c - a
        offset = points - np.einsum("qc,qcx->qx", barycentric, np.stack([a, b, c], axis=1))
        bb, bc, cc = (np.einsum("qx,qx->q", x, y) for x, y in ((ab, ab), (ab, ac), (ac, ac)))
        ob, oc = np.einsum("qx,qx->q", offset, ab), np.einsum("qx,qx->q", offset, ac)
        determinant = bb * cc - bc * bc
        proper = determinant > 1e-12 * bb * cc
        scale = np.divide(1.0, determinant, out=np.zeros_like(determinant), where=proper)
        step = (scale * (cc * ob - bc * oc))[:, None] * (uv_b - uv_a) + (scale * (bb * oc - bc * ob))[:, None] * (
            uv_c - uv_a
        )
        island = self.cut.triangle_island[triangle]
        longest = MOST_STEEP * self.density[island] * np.linalg.norm(offset, axis=1)
        length = np.linalg.norm(step, axis=1)
        step *= np.minimum(1, np.divide(longest, length, out=np.ones_like(length), where=length > 0))[:, None]
        return np.clip(self.at(triangle, barycentric) + step, self.lower[island], self.upper[island])


@dataclass(frozen=True, eq=False)
class Sheets:
    """The sheets that each face of the target might lie on, and its corners there.

    Attributes:
        candidates: k of them.
        seed: (k,) a triangle of the source on each.
        row: (k,) where the corners of each start in the rows.
        uv: (rows, 2) of each corner of each candidate's face.
        gap: (rows,) how far the corner lies beyond the sheet's border, in space.
    """

    candidates: Candidates
    seed: Integers
    row: Integers
    uv: Floats
    gap: Floats

    @cached_property
    def size(self) -> Floats:
        """(k,) the larger extent of each candidate's face in the atlas."""
        extent = [np.maximum.reduceat(axis, self.row) - np.minimum.reduceat(axis, self.row) for axis in self.uv.T]
        return np.maximum(*extent)

    def rows(self, candidate: Integers, corner: Integers, target: Surface) -> Integers:
        """The row of a corner for a candidate of its face."""
        return self.row[candidate] + corner - target.face_start[self.candidates.face[candidate]]


def transfer_uv(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """UVs (c, 2) at face corners."""
    target = mapped.target
    chart = chart_of(mapped.source, np.asarray(attribute.values, dtype=np.float64))
    sheets = _sheets(chart, mapped)
    first, second = mapped.adjacent
    chosen = _elected(sheets, chart, mapped)
    corner = np.arange(len(target.corner_vertex))
    row = sheets.rows(chosen[target.corner_face], corner, target)
    agree = _agree(
        sheets,
        chart,
        target,
        chosen[target.corner_face[first[:, 0]]],
        chosen[target.corner_face[second[:, 0]]],
        first,
        second,
    )
    uv = _shared(sheets.uv[row], sheets.gap[row], first[agree], second[agree])
    notes = _notes(attribute.name, chart, mapped, sheets.seed[chosen], uv)
    return replace(attribute, values=uv.astype(np.asarray(attribute.values).dtype), notes=attribute.notes + notes)


def chart_of(source: Surface, uv: Floats) -> Chart:
    """Cut the source (its corners have UVs (c, 2)) at its real seams, and measure its islands."""
    cut = cut_open(source, uv)
    count = int(cut.island.max()) + 1
    area = np.bincount(cut.triangle_island, triangle_areas(source.vertices, source.triangles), minlength=count)
    covered = np.bincount(cut.triangle_island, np.abs(_signed_areas(uv[source.triangle_corners])), minlength=count)
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, cut.island[source.corner_face], uv)
    np.maximum.at(high, cut.island[source.corner_face], uv)
    tile = np.floor(low + CUT_TOLERANCE)
    inside = high <= tile + 1 + CUT_TOLERANCE
    return Chart(
        cut=cut,
        uv=uv,
        density=np.sqrt(np.divide(covered, area, out=np.zeros(count), where=area > 0)),
        lower=np.where(inside, np.minimum(tile, low), -np.inf),
        upper=np.where(inside, np.maximum(tile + 1, high), np.inf),
    )


def uv_seams(surface: Surface, uv: Floats) -> Booleans:
    """(e,) which of a surface's edges its atlas (c, 2) is cut open at; its own borders are none."""
    first, second = adjacent_edges(surface)
    tolerance = CUT_TOLERANCE * float(np.ptp(uv, axis=0).max(initial=0))
    apart = (np.abs(uv[first] - uv[second]) > tolerance).any(axis=(1, 2))
    ends = np.sort(surface.corner_vertex[np.concatenate([first[apart], second[apart]])], axis=1)
    low, high = np.sort(surface.edges, axis=1).T
    n = len(surface.vertices)
    return np.isin(low * n + high, ends[:, 0] * n + ends[:, 1])


def _sheets(chart: Chart, mapped: MappedTarget) -> Sheets:
    """One sheet for faces that lie within a border, and for others those that their samples fall onto."""
    target, cut = mapped.target, chart.cut
    near = mapped.near_border(cut)
    safe = np.flatnonzero(~near)
    face, seed, middle, share = _sampled_sheets(cut, mapped, np.flatnonzero(near))
    face, share = np.concatenate([safe, face]), np.concatenate([np.ones(len(safe)), share])
    order = np.argsort(face, kind="stable")
    first_vertex = target.corner_vertex[target.face_start[safe]]
    seed = np.concatenate([mapped.surface_map.triangle[first_vertex], seed])[order]
    middle = np.concatenate([mapped.points[first_vertex], middle])[order]
    return _read(chart, mapped, near, Candidates(face[order], share[order]), seed, middle)


def _read(
    chart: Chart, mapped: MappedTarget, near: Booleans, candidates: Candidates, seed: Integers, middle: Floats
) -> Sheets:
    """The corners of each candidate's face on its sheet: looked for where the face is near a border, else known."""
    target, cut, face = mapped.target, chart.cut, candidates.face
    start, end = target.face_start[face], target.face_start[face + 1]
    candidate, corner = ragged(np.arange(len(face)), start, end, np.arange(len(target.corner_vertex)))
    vertex = target.corner_vertex[corner]
    triangle, barycentric = mapped.surface_map.triangle[vertex], mapped.surface_map.barycentric[vertex]
    gap = np.zeros(len(vertex))
    walked = near[face[candidate]]
    points = mapped.points[vertex[walked]]
    inside = points + INWARD * (middle[candidate[walked]] - points)
    entered, _, _ = cut.walk(seed[candidate[walked]], inside)
    triangle[walked], barycentric[walked], gap[walked] = cut.walk(entered, points)
    uv = chart.at(triangle, barycentric)
    over = np.flatnonzero(gap > 0)
    uv[over] = chart.beyond(triangle[over], barycentric[over], mapped.points[vertex[over]])
    return Sheets(candidates, seed, np.cumsum(end - start) - (end - start), uv, gap)


def _sampled_sheets(
    cut: CutSurface, mapped: MappedTarget, faces: Integers
) -> tuple[Integers, Integers, Floats, Floats]:
    """The sheets that samples of some faces of the target fall onto.

    Returns:
        For each sheet its face, a triangle and a point on it, the sample nearest to the face's middle,
        and its share of the face's votes.
    """
    samples = mapped.samples(faces)
    points = np.einsum(
        "qc,qcx->qx", samples.barycentric, mapped.source.vertices[mapped.source.triangles[samples.triangle]]
    )
    count = np.bincount(samples.face, minlength=len(mapped.target.face_start) - 1)
    middle = np.stack([np.bincount(samples.face, axis, minlength=len(count)) for axis in points.T], axis=1)
    off_middle = np.linalg.norm(points - middle[samples.face] / count[samples.face, None], axis=1)
    order = np.lexsort((off_middle, samples.face))
    seed_of = np.full(len(order), -1)
    for _ in range(MOST_SHEETS):
        unclaimed = order[seed_of[order] < 0]
        if len(unclaimed) == 0:
            break
        begin = np.flatnonzero(np.diff(samples.face[unclaimed], prepend=-1))
        seed = np.repeat(unclaimed[begin], np.diff(begin, append=len(unclaimed)))
        _, _, left = cut.walk(samples.triangle[seed], points[unclaimed])
        reached = (left == 0) | (seed == unclaimed)
        seed_of[unclaimed[reached]] = seed[reached]
    claimed = np.flatnonzero(seed_of >= 0)
    seed, sheet = np.unique(seed_of[claimed], return_inverse=True)
    total = np.bincount(samples.face, samples.weight, minlength=len(count))
    share = np.bincount(sheet, samples.weight[claimed]) / total[samples.face[seed]]
    return samples.face[seed], samples.triangle[seed], points[seed], share


def _elected(sheets: Sheets, chart: Chart, mapped: MappedTarget) -> Integers:
    """(f,) the candidate that each face takes, so that the seams on the target are short."""
    target = mapped.target
    first, second = sheets.candidates.contested(*mapped.adjacent, target.corner_face)
    edge, one, other = sheets.candidates.pairs(target.corner_face[first[:, 0]], target.corner_face[second[:, 0]])
    return elect(
        sheets.candidates,
        LOYALTY * mapped.circumference,
        one,
        other,
        edge_lengths(target.vertices[target.corner_vertex], first)[edge],
        _agree(sheets, chart, target, one, other, first[edge], second[edge]),
    )


def _agree(
    sheets: Sheets,
    chart: Chart,
    target: Surface,
    one: Integers,
    other: Integers,
    first: Integers,
    second: Integers,
) -> Booleans:
    """(e,) whether two candidates run on into each other over their common edge."""
    size, island = sheets.size, chart.cut.triangle_island[sheets.seed]
    tolerance = AGREEMENT * np.minimum(size[one], size[other]) + CUT_TOLERANCE * size.max()
    agree = island[one] == island[other]
    for mine, theirs in zip(first.T, second.T, strict=True):
        apart = sheets.uv[sheets.rows(one, mine, target)] - sheets.uv[sheets.rows(other, theirs, target)]
        for axis in apart.T:
            agree &= np.abs(axis) <= tolerance
    return agree


def _shared(uv: Floats, gap: Floats, first: Integers, second: Integers) -> Floats:
    """(c, 2) UVs, where joined corners that are one, or lie beyond a border, have what the nearest of them has."""
    group = joined_groups(len(uv), first.ravel(), second.ravel())
    nearest = np.empty(group.max() + 1, dtype=np.int64)
    nearest[group[::-1]] = np.arange(len(group))[::-1]  # the first of each, which is the nearest if it has no gap
    others = np.flatnonzero(gap[nearest[group]] > 0)
    others = others[np.lexsort((gap[others], group[others]))]
    others = others[np.flatnonzero(np.diff(group[others], prepend=-1))]
    nearest[group[others]] = others
    of_nearest = uv[nearest[group]]
    rounding = SAME_CORNER * float(np.ptp(uv, axis=0).max())
    off = np.abs(uv - of_nearest)
    taken = (gap > 0) | (np.maximum(off[:, 0], off[:, 1]) <= rounding)
    return np.where(taken[:, None], of_nearest, uv)


def _notes(name: str, chart: Chart, mapped: MappedTarget, seed: Integers, uv: Floats) -> tuple[str, ...]:
    """What the user should look at, a sentence each."""
    flipped, degenerate, stretched = (int(mask.sum()) for mask in _faults(chart, mapped, seed, uv))
    faces, islands = len(seed), len(chart.density)
    missing = islands - len(np.unique(chart.cut.triangle_island[seed]))
    sentences = (
        (flipped, f"{flipped} of {faces} faces have flipped UVs."),
        (degenerate, f"{degenerate} of {faces} faces have UVs without an area."),
        (stretched, f"{stretched} of {faces} faces have strongly stretched UVs."),
        (missing, f"{missing} of {islands} UV islands of the source received no face."),
    )
    return tuple(f"{name}: {sentence}" for count, sentence in sentences if count)


def _faults(chart: Chart, mapped: MappedTarget, seed: Integers, uv: Floats) -> tuple[Booleans, Booleans, Booleans]:
    """Which faces have UVs that are flipped against the source's, without an area, or strongly stretched.

    Args:
        chart: the source's UV map.
        mapped: the target on the source.
        seed: (f,) a triangle of the source where each face lies.
        uv: (c, 2) the target's.
    """
    source, target = mapped.source, mapped.target
    island = chart.cut.triangle_island[seed]
    signed = _signed_areas(uv[target.triangle_corners])
    covered = np.bincount(target.triangle_face, signed)
    area = np.bincount(target.triangle_face, triangle_areas(target.vertices, target.triangles))
    expected = chart.density[island] ** 2 * area * source.area / target.area
    degenerate = np.abs(covered) < DEGENERATE * expected
    flipped = _flipped(chart, mapped, seed, signed) & ~degenerate

    around_face, around_seed = face_edges(target), source.triangle_corners[seed][:, [[0, 1], [1, 2], [2, 0]]]
    in_space = edge_lengths(source.vertices[source.corner_vertex], around_seed).sum(axis=1)
    in_uv = edge_lengths(chart.uv, around_seed).sum(axis=1)
    local = np.divide(in_uv, in_space, out=np.zeros(len(seed)), where=in_space > 0)
    length = mapped.circumference * np.sqrt(source.area / target.area)
    found = np.bincount(target.corner_face, edge_lengths(uv, around_face))
    long = found > STRETCHED * length * np.maximum(local, chart.density[island])
    short = found * STRETCHED < length * np.minimum(local, chart.density[island])
    return flipped, degenerate, (long | short) & ~degenerate


def _flipped(chart: Chart, mapped: MappedTarget, seed: Integers, signed: Floats) -> Booleans:
    """(f,) which faces of the target, whose triangles cover UV areas (m,), are turned against the source at the seeds.

    Where the source's UVs fold without a seam, a seed may lie over the fold; then the middle of the face decides,
    or rather of the triangle that covers most.
    """
    source, target = mapped.source, mapped.target
    outwards = np.bincount(target.triangle_face, signed * _outward(target))
    on_source = _signed_areas(chart.uv[source.triangle_corners]) * _outward(source)
    flipped = outwards * on_source[seed] < 0
    order = np.argsort(np.abs(signed), kind="stable")
    largest = np.empty(len(flipped), dtype=np.int64)
    largest[target.triangle_face[order]] = order
    suspects = np.flatnonzero(flipped)
    middle, _ = mapped.locate(largest[suspects], np.full((len(suspects), 3), 1 / 3))
    island = chart.cut.triangle_island
    over_fold = (island[middle] == island[seed[suspects]]) & (outwards[suspects] * on_source[middle] > 0)
    flipped[suspects[over_fold]] = False
    return flipped


def _signed_areas(uv: Floats) -> Floats:
    """(m,) areas of UV triangles (m, 3, 2), negative where wound clockwise."""
    ab, ac = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return np.asarray(0.5 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]), dtype=np.float64)


def _outward(surface: Surface) -> Floats:
    """(m,) 1 for triangles that are wound outwards, -1 for the others, 0 for those without an extent."""
    winding = np.zeros(len(surface.triangles))
    winding[surface.working.triangle_of] = np.where(surface.working.flipped, -1.0, 1.0)
    return winding
