# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact sheets of the worst cases: the map, the parts that data come from, and the errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import zoomout_core as zo
from benchmarks.everywhere.cases import LEGS, OTHER, TOUCH, Case
from benchmarks.everywhere.left_out import BODIES, BUILDS, WHOLE
from benchmarks.everywhere.measures import Row, torn_edges, wrong_limb
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.colors import place_colors
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.plotting import draw_triangles

CELL = 14.0, 3.2  # inches
GAP = 1.1  # between the middles of views, whose longest extent is one
RIGHT, WRONG = np.array([0.75, 0.75, 0.75]), np.array([0.9, 0.1, 0.1])
PANELS = "source by place", "target by its images' places", "wrong part, limb or torn: red"


def draw(path: Path, entries: Sequence[tuple[Row, Case, zo.SurfaceMap]]) -> None:
    """Write cases to one PNG file, one row each, from the front and from the side."""
    figure = Figure(figsize=(CELL[0], len(entries) * CELL[1]), layout="constrained")
    for number, (row, case, surface_map) in enumerate(entries, start=1):
        axes = figure.add_subplot(len(entries), 1, number)
        axes.set_title(_caption(row), fontsize=9, pad=12)
        axes.set_axis_off()
        _add(axes, case, surface_map)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _caption(row: Row) -> str:
    figures = (f"{name} {row[name]:.2%}" for name in ("part", "limb", "torn", "off") if row[name] is not None)
    return f"{row['case']}: {', '.join(figures)}, certainty {row['certainty']:.0%}, {row['verdict']}"


def _add(axes: Axes, case: Case, surface_map: zo.SurfaceMap) -> None:
    places = place_colors(case.source.vertices, case.source.vertices)
    panels = (
        (case.source, places, _upward(case, is_source=True)),
        (case.target, surface_map.interpolate(places), _upward(case, is_source=False)),
        (case.target, np.where(_wrong(case, surface_map)[:, None], WRONG, RIGHT), _upward(case, is_source=False)),
    )
    left = 0.0
    for title, (surface, colour, upward) in zip(PANELS, panels, strict=True):
        axes.text(left + GAP / 2, 0.53, title, fontsize=7, ha="center")
        for seen in _views(surface.vertices, upward):
            draw_triangles(axes, seen, surface.triangles, colour, left)
            left += GAP
    axes.set_xlim(-GAP / 2, left - GAP / 2)
    axes.set_ylim(-0.5, 0.5)
    axes.set_aspect("equal")


def _wrong(case: Case, surface_map: zo.SurfaceMap) -> Booleans:
    """(n_t,) vertices with a wrong part or limb, or at a torn edge."""
    wrong = wrong_limb(case, surface_map)
    edges, _ = unique_edges(case.target.triangles)
    wrong[edges[torn_edges(case, surface_map)]] = True
    return wrong | ((case.target_part >= 0) & (case.source_part[surface_map.vertex] != case.target_part))


def _upward(case: Case, is_source: bool) -> int:
    """The up axis: y for MakeHuman and scanned bodies, z for game characters."""
    of_bodies = case.kind in (LEGS, TOUCH, BODIES, WHOLE) or (case.kind in (OTHER, BUILDS) and not is_source)
    return 1 if of_bodies else 2


def _views(vertices: Floats, upward: int) -> tuple[Floats, Floats]:
    """(n, 3) points to the right, upwards and towards the viewer, from the front and from the side."""
    points = vertices - (vertices.max(axis=0) + vertices.min(axis=0)) / 2
    points = points / np.ptp(points, axis=0).max()
    ahead = points[:, 2] if upward == 1 else -points[:, 1]
    up = points[:, upward]
    return np.stack([points[:, 0], up, ahead], axis=1), np.stack([-ahead, up, points[:, 0]], axis=1)
