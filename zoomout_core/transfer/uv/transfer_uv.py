# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer UV maps: every face of the target is in one island of the source, on one side of each of its seams.

A face that might cross a seam is sampled. Its samples are on one or several sheets: parts of the source around the face
that are divided by seams, such as parts of different islands, or the two sides of a seam within one. The face takes one
sheet by vote, and all its corners are read there; corners beyond the sheet's border continue it linearly. Faces that
agree about a corner share it, so the target has seams only where the source has one.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.cut_mesh import CUT_TOLERANCE
from zoomout_core.transfer.finite import with_finite_values
from zoomout_core.transfer.groups import first_of_each, label_groups
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.picks import Picks
from zoomout_core.transfer.potts import elect_for_faces
from zoomout_core.transfer.uv.chart import Chart, chart_of
from zoomout_core.transfer.uv.faults import fault_notes
from zoomout_core.transfer.uv.sheets import Sheets, sheets_of

# Smaller differences between corners of joined faces, relative to the UVs' range, are rounding.
SAME_CORNER = 1e-9
# Maximum difference of UVs at the common edge of continuous faces, relative to the smaller face's UV size.
UV_TOLERANCE = 0.25


def transfer_uv(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer UVs (c, 2) at face corners."""
    chart, sheets, chosen, row = _choose_rows(attribute, mapped)
    uv = sheets.uv[row]
    notes = fault_notes(attribute.name, chart, mapped, sheets.seed[chosen], uv)
    return replace(attribute, values=uv.astype(np.asarray(attribute.values).dtype), notes=attribute.notes + notes)


def pick_uv(attribute: Attribute, mapped: MappedTarget) -> Picks:
    """The corners of the source from which `transfer_uv` mixes each UV, apart from its clipping to a tile."""
    _, sheets, _, row = _choose_rows(with_finite_values(attribute, mapped.source), mapped)
    return Picks(mapped.source.triangle_corners[sheets.triangle[row]], sheets.weights[row])


def _choose_rows(attribute: Attribute, mapped: MappedTarget) -> tuple[Chart, Sheets, Integers, Integers]:
    """The source's chart, the sheets, (f,) the candidate of each face, and (c,) the row of each corner's UV."""
    target = mapped.target
    chart = chart_of(mapped.source, np.asarray(attribute.values, dtype=np.float64))
    sheets = sheets_of(chart, mapped)
    chosen = elect_for_faces(sheets.candidates, mapped, partial(_agree, sheets, chart, target))
    of_corner = chosen[target.corner_face]
    row = sheets.rows(of_corner, np.arange(len(of_corner)), target)
    first, second = mapped.adjacent
    agree = _agree(sheets, chart, target, of_corner[first[:, 0]], of_corner[second[:, 0]], first, second)
    return chart, sheets, chosen, row[_share_corners(sheets.uv[row], sheets.gap[row], first[agree], second[agree])]


def _agree(
    sheets: Sheets, chart: Chart, target: Surface, one: Integers, other: Integers, first: Integers, second: Integers
) -> Booleans:
    """(e,) whether two candidates are continuous across their common edge."""
    size, island = sheets.size, chart.cut.triangle_island[sheets.seed]
    tolerance = UV_TOLERANCE * np.minimum(size[one], size[other]) + CUT_TOLERANCE * size.max()
    agree = island[one] == island[other]
    for mine, theirs in zip(first.T, second.T, strict=True):
        apart = sheets.uv[sheets.rows(one, mine, target)] - sheets.uv[sheets.rows(other, theirs, target)]
        for axis in apart.T:
            agree &= np.abs(axis) <= tolerance
    return agree


def _share_corners(uv: Floats, gap: Floats, first: Integers, second: Integers) -> Integers:
    """(c,) the corner whose UV (c, 2) each takes: joined ones that are equal, or beyond a border, share the nearest."""
    group = label_groups(len(uv), first.ravel(), second.ravel())
    nearest = np.empty(group.max() + 1, dtype=np.int64)
    nearest[group[::-1]] = np.arange(len(group))[::-1]  # the first of each group, which is the nearest if it has no gap
    others = np.flatnonzero(gap[nearest[group]] > 0)
    others = others[first_of_each(group[others], gap[others])]
    nearest[group[others]] = others
    of_nearest = uv[nearest[group]]
    rounding = SAME_CORNER * float(np.ptp(uv, axis=0).max())
    off = np.abs(uv - of_nearest)
    taken = (gap > 0) | (np.maximum(off[:, 0], off[:, 1]) <= rounding)
    return np.where(taken, nearest[group], np.arange(len(uv)))
