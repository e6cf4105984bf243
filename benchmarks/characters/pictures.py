# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheets of the worst cases: positions of the images, wrong ones, and the match's confidence."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import zoomout_core as zo
from benchmarks.characters.cases import OUTFITS, Case
from benchmarks.characters.figures import wrong
from zoomout_core.arrays import Floats
from zoomout_core.colors import place_colors
from zoomout_core.plotting import draw_triangles

CELL = 14.0, 2.3  # inches
# Distance between the centres of views, whose longest extent is one.
GAP = 1.15
RIGHT, WRONG = np.array([0.75, 0.75, 0.75]), np.array([0.9, 0.1, 0.1])
SURE, UNSURE = np.array([0.95, 0.9, 0.2]), np.array([0.2, 0.05, 0.4])
PANELS = (
    "source by place",
    "target by its images' places",
    "wrong limb or place: red",
    "confidence, from violet to yellow",
)


class Picture(NamedTuple):
    """A case to draw.

    Attributes:
        row: of the table.
        case: the matched pair.
        result: of the match.
    """

    row: dict[str, Any]
    case: Case
    result: zo.MatchResult


def draw(path: Path, pictures: list[Picture]) -> None:
    """Write cases to one PNG file, a row each, from the front and from the side."""
    figure = Figure(figsize=(CELL[0], len(pictures) * CELL[1]), layout="constrained")
    for number, picture in enumerate(pictures, start=1):
        axes = figure.add_subplot(len(pictures), 1, number)
        axes.set_title(_caption(picture.row), fontsize=9, pad=12)
        axes.set_axis_off()
        _add(axes, picture)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _caption(row: dict[str, Any]) -> str:
    figure = f"limb {row['limb']:.2f}" if row["limb"] is not None else f"error {row['cm'] or 0:.1f} cm"
    return f"{row['case']}: {figure}, certainty {row['certainty']:.0%}"


def _add(axes: Axes, picture: Picture) -> None:
    case, surface_map = picture.case, picture.result.surface_map
    places = place_colors(case.source.vertices, case.source.vertices)
    confidence = picture.result.confidence[:, None]
    panels = (
        (case.source, places),
        (case.target, surface_map.interpolate(places)),
        (case.target, np.where(wrong(case, surface_map)[:, None], WRONG, RIGHT)),
        (case.target, confidence * SURE + (1 - confidence) * UNSURE),
    )
    left = 0.0
    for title, (surface, colour) in zip(PANELS, panels, strict=True):
        axes.text(left + GAP / 2, 0.53, title, fontsize=7, ha="center")
        for seen in _views(surface.vertices, upward=1 if case.kind == OUTFITS else 2):
            draw_triangles(axes, seen, surface.triangles, colour, left)
            left += GAP
    axes.set_xlim(-GAP / 2, left - GAP / 2)
    axes.set_ylim(-0.5, 0.5)
    axes.set_aspect("equal")


def _views(vertices: Floats, upward: int) -> tuple[Floats, Floats]:
    """(n, 3) points to the right, upwards and towards the viewer, from the front and from the side.

    Args:
        vertices: (n, 3) positions.
        upward: the axis that points up. Characters face along +z if it is y, and along -y if it is z.

    """
    points = vertices - (vertices.max(axis=0) + vertices.min(axis=0)) / 2
    points = points / np.ptp(points, axis=0).max()
    ahead = points[:, 2] if upward == 1 else -points[:, 1]
    up = points[:, upward]
    return np.stack([points[:, 0], up, ahead], axis=1), np.stack([-ahead, up, points[:, 0]], axis=1)
