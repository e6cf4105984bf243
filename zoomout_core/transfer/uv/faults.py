# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults of transferred UVs: flipped, degenerate and stretched faces."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_lengths, triangle_areas
from zoomout_core.messages import warning
from zoomout_core.transfer.cut_mesh import face_edges
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.uv.chart import Chart, signed_areas, uv_seams

# Stretch of a face's UVs relative to the source's, or its inverse, above which the face is reported.
MAX_STRETCH = 4.0
# UV area of a face, relative to that on the source, below which the face is reported as degenerate.
MIN_UV_AREA = 1e-3

# UV area of a face across a fold of the source's UVs, relative to that on the source, below which its texture looks
# squeezed, and the share of the target's area on such faces above which they are reported.
FOLDED_UV_AREA, FOLDED_SHARE = 0.25, 0.005

# Ratio of the lengths of target and source seams, and length of an edge relative to the extent, above which seams look
# jagged.
JAGGED, COARSE = 1.1, 0.015


def fault_notes(name: str, chart: Chart, mapped: MappedTarget, seed: Integers, uv: Floats) -> tuple[str, ...]:
    """Describe the faults of transferred UVs (c, 2), whose faces (f,) have seeds, in sentences for the user."""
    flipped, degenerate, stretched = (int(mask.sum()) for mask in _faults(chart, mapped, seed, uv))
    faces, islands = len(seed), len(chart.density)
    missing = islands - len(np.unique(chart.cut.triangle_island[seed]))
    cases = (
        (flipped, faces, "{layer}: {count:,} of {total:,} faces have flipped UVs."),
        (degenerate, faces, "{layer}: {count:,} of {total:,} faces have collapsed UVs."),
        (stretched, faces, "{layer}: {count:,} of {total:,} faces have strongly stretched UVs."),
        (missing, islands, "{layer}: {count:,} of {total:,} UV islands of the source received no face."),
    )
    notes = tuple(warning(text, layer=name, count=count, total=total) for count, total, text in cases if count)
    folded = _folded_share(chart, mapped, seed, uv)
    if folded > FOLDED_SHARE:
        text = (
            "{layer}: {share:.1%} of the area is on faces across which the source's UVs are mirrored, and shows "
            "smeared textures: cut these faces there, such as by Bisect, and match again."
        )
        notes += (warning(text, layer=name, share=folded),)
    return notes


def has_jagged_seams(source: Surface, source_uv: Floats, target: Surface, uv: Floats) -> bool:
    """Whether the seams of a target's transferred UV map (c_t, 2) zigzag visibly.

    They do if they are longer than those of the source's UV map (c_s, 2), and along long edges.
    """
    before, after = _seam_lengths(source, source_uv), _seam_lengths(target, uv)
    scale = float(np.sqrt(target.area / source.area))
    extent = float(np.ptp(target.vertices, axis=0).max())
    return len(after) > 0 and after.sum() > JAGGED * scale * before.sum() and after.mean() > COARSE * extent


def _seam_lengths(surface: Surface, uv: Floats) -> Floats:
    """(s,) lengths of the edges that are seams of a UV map (c, 2)."""
    ends = surface.vertices[surface.edges[uv_seams(surface, uv)]]
    return np.asarray(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))


def _folded_share(chart: Chart, mapped: MappedTarget, seed: Integers, uv: Floats) -> float:
    """The share of the target's area on faces that span a fold, such as the middle of mirrored UVs, and lack UV area.

    Their corners are on triangles of the source whose UVs have both orientations.
    """
    target = mapped.target
    covered, area, expected = _uv_areas(chart, mapped, seed, uv)
    signs = np.sign(signed_areas(chart.uv[mapped.source.triangle_corners]) * _outward(mapped.source))
    of_corner = signs[mapped.surface_map.triangle][target.corner_vertex]
    start = target.face_start[:-1]
    spans = np.minimum.reduceat(of_corner, start) * np.maximum.reduceat(of_corner, start) < 0
    return float(area[spans & (np.abs(covered) < FOLDED_UV_AREA * expected)].sum() / area.sum())


def _uv_areas(chart: Chart, mapped: MappedTarget, seed: Integers, uv: Floats) -> tuple[Floats, Floats, Floats]:
    """(f,) signed UV areas of the target's faces, their areas, and the UV areas expected from those of their seeds."""
    target = mapped.target
    of_triangles = signed_areas(uv[target.triangle_corners]), triangle_areas(target.vertices, target.triangles)
    covered, area = (np.bincount(target.triangle_face, each).astype(np.float64) for each in of_triangles)
    density = chart.density[chart.cut.triangle_island[seed]]
    return covered, area, density**2 * area * mapped.source.area / target.area


def _faults(chart: Chart, mapped: MappedTarget, seed: Integers, uv: Floats) -> tuple[Booleans, Booleans, Booleans]:
    """Which faces have UVs (c, 2) that are flipped relative to the source's, degenerate, or strongly stretched.

    The seeds (f,) are triangles of the source, one at each face.
    """
    source, target = mapped.source, mapped.target
    island = chart.cut.triangle_island[seed]
    signed = signed_areas(uv[target.triangle_corners])
    covered, _, expected = _uv_areas(chart, mapped, seed, uv)
    degenerate = np.abs(covered) < MIN_UV_AREA * expected
    flipped = _flipped_faces(chart, mapped, seed, signed) & ~degenerate

    around_face, around_seed = face_edges(target), source.triangle_corners[seed][:, [[0, 1], [1, 2], [2, 0]]]
    in_space = edge_lengths(source.vertices[source.corner_vertex], around_seed).sum(axis=1)
    in_uv = edge_lengths(chart.uv, around_seed).sum(axis=1)
    local = np.divide(in_uv, in_space, out=np.zeros(len(seed)), where=in_space > 0)
    length = mapped.circumference * np.sqrt(source.area / target.area)
    found = np.bincount(target.corner_face, edge_lengths(uv, around_face))
    long = found > MAX_STRETCH * length * np.maximum(local, chart.density[island])
    short = found * MAX_STRETCH < length * np.minimum(local, chart.density[island])
    return flipped, degenerate, (long | short) & ~degenerate


def _flipped_faces(chart: Chart, mapped: MappedTarget, seed: Integers, signed: Floats) -> Booleans:
    """(f,) which faces of the target, whose triangles have UV areas (m,), are flipped relative to the source's seeds.

    Where the source's own UVs are flipped or fold, such as mirrored ones at the middle of a character, faces beside the
    fold may have either orientation. So a face is flipped only if no triangle around its seed has its orientation.
    """
    source, target = mapped.source, mapped.target
    turns = np.bincount(target.triangle_face, signed * _outward(target))
    turns_of_source = signed_areas(chart.uv[source.triangle_corners]) * _outward(source)
    corners = chart.cut.cut_vertex[source.triangle_corners]  # (m_s, 3) no islands share these
    around = corners[seed]
    flipped = turns * turns_of_source[seed] < 0
    for sign in (1, -1):
        has_sign = np.zeros(corners.max() + 1, dtype=bool)
        has_sign[corners[turns_of_source * sign > 0]] = True
        flipped &= ~((turns * sign > 0) & has_sign[around].any(axis=1))
    return flipped


def _outward(surface: Surface) -> Floats:
    """(m,) 1 for triangles that are wound outwards, -1 for the others, 0 for degenerate ones."""
    winding = np.zeros(len(surface.triangles))
    winding[surface.working.triangle_of] = np.where(surface.working.flipped, -1.0, 1.0)
    return winding
