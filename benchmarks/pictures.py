# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact sheets of maps, shown by transferred colours, and of surfaces with vertex colours, such as errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from zoomout_core.arrays import Floats, Integers
from zoomout_core.colors import place_colors
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.plotting import GAP, draw_surface

COLUMNS = 2
CELL = 7.0, 2.0  # inches
VIEW = 2.0, 2.2  # inches


@dataclass(frozen=True, eq=False)
class Picture:
    """A map to draw.

    Attributes:
        caption: a line above it.
        source: the surface with the images.
        target: the surface to be mapped.
        surface_map: the map.
    """

    caption: str
    source: Surface
    target: Surface
    surface_map: SurfaceMap


@dataclass(frozen=True, eq=False)
class View:
    """A surface to be drawn from the front.

    Attributes:
        caption: a line above it.
        surface: the surface.
        colour: (n, 3) red, green and blue of its vertices, from 0 to 1.
    """

    caption: str
    surface: Surface
    colour: Floats


def draw(path: Path, pictures: list[Picture]) -> None:
    """Write pictures to one PNG file: source and target, each from the front and from behind."""
    rows = -(-len(pictures) // COLUMNS)
    figure = Figure(figsize=(COLUMNS * CELL[0], rows * CELL[1]), layout="constrained")
    for number, picture in enumerate(pictures, start=1):
        axes = figure.add_subplot(rows, COLUMNS, number)
        axes.set_title(picture.caption, fontsize=9)
        axes.set_axis_off()
        colour = place_colors(picture.source.vertices, picture.source.vertices)
        middle = draw_surface(axes, picture.source, colour, sides=2) + GAP
        right = draw_surface(axes, picture.target, picture.surface_map.interpolate(colour), middle, sides=2)
        axes.set(xlim=(0, right), ylim=(-0.5, 0.5), aspect="equal")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def draw_views(path: Path, rows: Sequence[Sequence[View]]) -> None:
    """Write views to one PNG file, row by row."""
    columns = max(len(row) for row in rows)
    figure = Figure(figsize=(VIEW[0] * columns, VIEW[1] * len(rows)), layout="constrained")
    for number, row in enumerate(rows):
        for place, view in enumerate(row):
            axes = figure.add_subplot(len(rows), columns, number * columns + place + 1)
            axes.set_title(view.caption, fontsize=9)
            axes.set_axis_off()
            right = draw_surface(axes, view.surface, view.colour)
            axes.set(xlim=(right / 2 - 0.5, right / 2 + 0.5), ylim=(-0.5, 0.5), aspect="equal")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def heat(errors: Floats, max_error: float) -> Floats:
    """(n, 3) colours of errors, from white for 0 through yellow and red to black for `max_error` and more."""
    return np.asarray(colormaps["hot"](1 - np.clip(np.nan_to_num(errors / max_error, nan=1.0), 0, 1))[:, :3])


def spread(values: Floats, places: Integers, surface: Surface) -> Floats:
    """(n,) the value of each vertex of a surface, taken from the nearest of some vertices.

    Args:
        values: (c,) at these vertices.
        places: (c,) their indices.
        surface: the surface.
    """
    return values[nearest(surface.vertices, surface.vertices[places])]
