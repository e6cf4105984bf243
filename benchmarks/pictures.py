"""Contact sheets: maps by the colours they carry over, and surfaces with a colour at each vertex, such as errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals

COLUMNS = 2
CELL = 7.0, 2.0  # inches
VIEW = 2.0, 2.2  # inches
# Brightness of a face seen edge-on; one that faces the viewer has 1.
DARKEST = 0.35
GAP = 1.15


@dataclass(frozen=True, eq=False)
class Picture:
    """A map to draw.

    Attributes:
        caption: a line above it.
        source: the surface that the map lands on.
        target: the surface that it starts from.
        surface_map: the map.
    """

    caption: str
    source: Surface
    target: Surface
    surface_map: SurfaceMap


@dataclass(frozen=True, eq=False)
class View:
    """A surface to draw from the front.

    Attributes:
        caption: a line above it.
        surface: the surface.
        colour: (n, 3) red, green and blue of its vertices, 0 to 1.
    """

    caption: str
    surface: Surface
    colour: Floats


def draw(path: Path, pictures: list[Picture]) -> None:
    """Write pictures to one PNG file: source and target, each from the front and from behind."""
    rows = -(-len(pictures) // COLUMNS)
    figure = Figure(figsize=(COLUMNS * CELL[0], rows * CELL[1]), layout="constrained")
    FigureCanvasAgg(figure)
    for number, picture in enumerate(pictures, start=1):
        axes = figure.add_subplot(rows, COLUMNS, number)
        axes.set_title(picture.caption, fontsize=9)
        axes.set_axis_off()
        colour = by_position(picture.source.vertices)
        _add(axes, picture.source, colour, 0)
        _add(axes, picture.target, picture.surface_map.interpolate(colour), 2)
        axes.set_xlim(-0.5, 3 * GAP + 0.5)
        axes.set_ylim(-0.5, 0.5)
        axes.set_aspect("equal")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def draw_views(path: Path, rows: Sequence[Sequence[View]]) -> None:
    """Write views to one PNG file, row by row."""
    columns = max(len(row) for row in rows)
    figure = Figure(figsize=(VIEW[0] * columns, VIEW[1] * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    for number, row in enumerate(rows):
        for place, view in enumerate(row):
            axes = figure.add_subplot(len(rows), columns, number * columns + place + 1)
            axes.set_title(view.caption, fontsize=9)
            axes.set_axis_off()
            _add(axes, view.surface, view.colour, 0, sides=1)
            axes.set(xlim=(-0.5, 0.5), ylim=(-0.5, 0.5), aspect="equal")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def heat(errors: Floats, most: float) -> Floats:
    """(n, 3) colours of errors, from white for none through yellow and red to black for `most` and more."""
    return np.asarray(colormaps["hot"](1 - np.clip(np.nan_to_num(errors / most, nan=1.0), 0, 1))[:, :3])


def spread(values: Floats, places: Integers, surface: Surface) -> Floats:
    """(n,) for every vertex of a surface the value at the nearest of some vertices.

    Args:
        values: (c,) at those vertices.
        places: (c,) their numbers.
        surface: the surface.
    """
    return values[nearest(surface.vertices, surface.vertices[places])]


def by_position(points: Floats) -> Floats:
    """(n, 3) red, green and blue by the place in the bounding box."""
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    return (points - low) / np.where(extent > 0, extent, 1)


def _add(axes: Axes, surface: Surface, colour: Floats, place: int, sides: int = 2) -> None:
    """Draw a surface at a place and, with two sides, from behind at the next.

    It is seen along the axis of its least extent; of the others the first points to the right, the second up.
    """
    depth = int(np.argmin(np.ptp(surface.vertices, axis=0)))
    right, up = (axis for axis in range(3) if axis != depth)
    towards = -1.0 if depth == 1 else 1.0  # so that the picture is no mirror image
    points = surface.vertices[:, [right, up, depth]] * [1, 1, towards]
    points = points - (points.max(axis=0) + points.min(axis=0)) / 2
    points /= max(float(np.ptp(points, axis=0).max()), 1e-300)
    for seen in (points, points * [-1, 1, -1])[:sides]:
        add_seen(axes, seen, surface.triangles, colour, place * GAP)
        place += 1


def add_seen(axes: Axes, points: Floats, triangles: Integers, colour: Floats, left: float) -> None:
    """Draw triangles as they are seen, the far ones first (painter's algorithm).

    Args:
        axes: what to draw on.
        points: (n, 3) vertices to the right, upwards and towards the viewer.
        triangles: (m, 3) vertex numbers.
        colour: (n, 3) red, green and blue of the vertices.
        left: how far to the right of their place.
    """
    order = np.argsort(points[triangles, 2].mean(axis=1))
    shade = DARKEST + (1 - DARKEST) * np.abs(triangle_normals(points, triangles)[:, 2])
    shaded = (colour[triangles].mean(axis=1) * shade[:, None])[order]
    corners = (points[:, :2] + [left, 0])[triangles[order]]
    axes.add_collection(PolyCollection(list(corners), facecolors=shaded, edgecolors=shaded, linewidths=0.2))
