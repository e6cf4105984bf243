# SPDX-License-Identifier: GPL-3.0-or-later
"""The sheets from which each face of the target might take its UVs.

A sheet is a part of the source around a face within which no seam runs. The two sides of a seam are two sheets, even
within one island. A face that might cross a seam is sampled, and its samples vote for sheets.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers, segment_sum
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.cut_mesh import CutSurface, corners_of_faces
from zoomout_core.transfer.groups import group_starts
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.potts import Candidates
from zoomout_core.transfer.uv.chart import Chart

# Maximum number of sheets per face; more meet in one face only if it is larger than islands.
MAX_SHEETS = 4
# To choose its triangle, a corner is moved towards the centre of its face by this fraction, so that it stays on the
# face's side of a seam.
INWARD_SHIFT = 0.01


@dataclass(frozen=True, eq=False)
class Sheets:
    """The sheets that each face of the target might be on, and its corners there."""

    candidates: Candidates  # the k candidates
    seed: Integers  # (k,) a triangle of the source on each
    row: Integers  # (k,) where the corners of each begin in the rows
    triangle: Integers  # (rows,) the triangle of the source in which each corner of each candidate's face is read
    weights: Floats  # (rows, 3) barycentric coordinates in it, outside the triangle where UVs are continued
    uv: Floats  # (rows, 2) UVs there
    gap: Floats  # (rows,) distance in space of the corner beyond the sheet's border

    @cached_property
    def size(self) -> Floats:
        """(k,) larger extent of each candidate's face in the atlas."""
        extent = [np.maximum.reduceat(axis, self.row) - np.minimum.reduceat(axis, self.row) for axis in self.uv.T]
        return np.maximum(*extent)

    def rows(self, candidate: Integers, corner: Integers, target: Surface) -> Integers:
        """(q,) the rows of corners (q,) for candidates (q,) of their faces."""
        return self.row[candidate] + corner - target.face_start[self.candidates.face[candidate]]


def sheets_of(chart: Chart, mapped: MappedTarget) -> Sheets:
    """One sheet for faces within borders, and for other faces those that their samples are on."""
    target, cut = mapped.target, chart.cut
    near = mapped.near_border(cut)
    safe = np.flatnonzero(~near)
    face, seed, middle, share = _sample_sheets(cut, mapped, np.flatnonzero(near))
    face, share = np.concatenate([safe, face]), np.concatenate([np.ones(len(safe)), share])
    order = np.argsort(face, kind="stable")
    first_vertex = target.corner_vertex[target.face_start[safe]]
    seed = np.concatenate([mapped.surface_map.triangle[first_vertex], seed])[order]
    middle = np.concatenate([mapped.points[first_vertex], middle])[order]
    return _read(chart, mapped, near, Candidates(face[order], share[order]), seed, middle)


def _read(
    chart: Chart, mapped: MappedTarget, near: Booleans, candidates: Candidates, seed: Integers, middle: Floats
) -> Sheets:
    """The corners of each candidate's face on its sheet, which are searched only for faces near a border."""
    target, cut, face = mapped.target, chart.cut, candidates.face
    candidate, corner = corners_of_faces(target, face)
    vertex = target.corner_vertex[corner]
    triangle, barycentric = mapped.surface_map.triangle[vertex], mapped.surface_map.barycentric[vertex]
    gap = np.zeros(len(vertex))
    walked = near[face[candidate]]
    points = mapped.points[vertex[walked]]
    inside = points + INWARD_SHIFT * (middle[candidate[walked]] - points)
    entered, _, _ = cut.walk(seed[candidate[walked]], inside)
    triangle[walked], barycentric[walked], gap[walked] = cut.walk(entered, points)
    uv = chart.at(triangle, barycentric)
    over = np.flatnonzero(gap > 0)
    uv[over], barycentric[over] = chart.beyond(triangle[over], barycentric[over], mapped.points[vertex[over]])
    return Sheets(candidates, seed, group_starts(candidate), triangle, barycentric, uv, gap)


def _sample_sheets(cut: CutSurface, mapped: MappedTarget, faces: Integers) -> tuple[Integers, Integers, Floats, Floats]:
    """The sheets that contain samples of some faces of the target.

    Returns:
        For each sheet: its face, a triangle of it and a point there, the sample nearest to the face's centre, and its
            share of the face's votes.
    """
    samples = mapped.samples(faces)
    points = np.einsum(
        "qc,qcx->qx", samples.barycentric, mapped.source.vertices[mapped.source.triangles[samples.triangle]]
    )
    count = np.bincount(samples.face, minlength=len(mapped.target.face_start) - 1)
    middle = segment_sum(points, samples.face, len(count))
    off_middle = np.linalg.norm(points - middle[samples.face] / count[samples.face, None], axis=1)
    order = np.lexsort((off_middle, samples.face))
    seed_of = np.full(len(order), -1)
    for _ in range(MAX_SHEETS):
        unclaimed = order[seed_of[order] < 0]
        if len(unclaimed) == 0:
            break
        begin = group_starts(samples.face[unclaimed])
        seed = np.repeat(unclaimed[begin], np.diff(begin, append=len(unclaimed)))
        _, _, left = cut.walk(samples.triangle[seed], points[unclaimed])
        reached = (left == 0) | (seed == unclaimed)
        seed_of[unclaimed[reached]] = seed[reached]
    claimed = np.flatnonzero(seed_of >= 0)
    seed, sheet = np.unique(seed_of[claimed], return_inverse=True)
    total = np.bincount(samples.face, samples.weight, minlength=len(count))
    share = np.bincount(sheet, samples.weight[claimed]) / total[samples.face[seed]]
    return samples.face[seed], samples.triangle[seed], points[seed], share
