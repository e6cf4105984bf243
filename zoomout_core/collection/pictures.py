# SPDX-License-Identifier: GPL-3.0-or-later
"""Small pictures of the shapes of a collection, coloured through their maps: equal colours correspond."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats
from zoomout_core.collection.engine import Engine, Task, run_tasks
from zoomout_core.collection.pair_map import PairName, PairRecord
from zoomout_core.collection.tasks import place_of_map
from zoomout_core.colors import place_colors
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.formats.files import read_shape
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.child_process import empty_working_folder

if TYPE_CHECKING:
    from zoomout_core.collection.collection import CollectionResult

# Pixels along each side of a picture, and maximum number of vertices of a drawn surface.
PIXELS, MAX_VERTICES = 180, 6_000


@dataclass(frozen=True, eq=False)
class Picture:
    """A drawn shape: the content of a PNG file, and the colours (n, 3) of its vertices, 0 to 255."""

    png: bytes
    colors: NDArray[np.uint8]


def picture_tasks(result: CollectionResult, root: str | None = None) -> list[Task]:
    """Tasks that draw all shapes with a map: each after the shape that it takes its colours from.

    The root, such as a template, is coloured by position; without one, the shape with most maps.
    """
    tasks = []
    for name, parent in color_tree(list(result.records), result.records, root):
        path = result.items[name].path.absolute()
        after: tuple[str, ...] = ()
        map_file, forward, parent_path = None, True, None
        if parent is not None:
            pair = PairName(parent, name)
            forward = pair in result.records
            map_file = result.folder / place_of_map(pair if forward else PairName(name, parent))
            parent_path, after = result.items[parent].path.absolute(), (f"picture {parent}",)
        tasks.append(Task(f"picture {name}", draw_picture, (path, parent_path, map_file, forward), after))
    return tasks


def draw(result: CollectionResult, root: str | None, engine: Engine) -> dict[str, bytes]:
    """PNG files of all shapes with a map, by name, see `picture_tasks`; a shape that fails is left out."""
    tasks = picture_tasks(result, root)
    found: dict[str, bytes] = {}
    for done in run_tasks(engine, tasks, lambda _: f"Drawing {len(found)} of {len(tasks)}"):
        if isinstance(done.result, Picture):
            found[done.key.removeprefix("picture ")] = done.result.png
    return found


def color_tree(
    pairs: Sequence[PairName], records: Mapping[PairName, PairRecord], root: str | None
) -> list[tuple[str, str | None]]:
    """Each shape and the shape that it takes its colours from, along the tree of the most certain maps."""
    beside: dict[str, list[tuple[str, float]]] = {}
    for pair in pairs:
        for one, other in ((pair.source, pair.target), (pair.target, pair.source)):
            beside.setdefault(one, []).append((other, records[pair].certainty))
    found: list[tuple[str, str | None]] = []
    seen: set[str] = set()
    roots = [] if root is None or root not in beside else [root]
    for start in roots + sorted(beside, key=lambda name: -len(beside[name])):
        if start in seen:
            continue
        seen.add(start)
        found.append((start, None))
        ahead = [(certainty, start, other) for other, certainty in beside[start]]
        while ahead:
            step = max(ahead, key=lambda each: each[0])
            ahead.remove(step)
            _, parent, name = step
            if name not in seen:
                seen.add(name)
                found.append((name, parent))
                ahead += [(certainty, name, other) for other, certainty in beside[name] if other not in seen]
    return found


def draw_picture(
    path: Path, parent_path: Path | None, map_file: Path | None, forward: bool, parent: Picture | None = None
) -> Picture:
    """Draw the shape of a file.

    Its colours come from the drawn parent through a map file, whose map leads from this shape to the parent if
    `forward`, else back. Without a parent they depend on position.
    """
    surface = as_surface(read_shape(path))
    if parent is None or parent_path is None or map_file is None:
        colors = place_colors(surface.vertices, surface.vertices)
    else:
        other = as_surface(read_shape(parent_path))
        if forward:
            surface_map = SurfaceMap.load(map_file, other)
        else:
            surface_map = SurfaceMap.load(map_file, surface).invert(surface, other)
        colors = surface_map.interpolate(parent.colors / 255)
    return Picture(_draw(surface, colors), np.rint(255 * colors.clip(0, 1)).astype(np.uint8))


def _draw(surface: Surface, colors: Floats) -> bytes:
    """Draw a surface with colours (n, 3) as a PNG."""
    with empty_working_folder():  # matplotlib takes its settings from the current one
        from matplotlib.figure import Figure

        from zoomout_core.plotting import draw_surface

    if len(surface.vertices) > MAX_VERTICES:
        vertices, triangles, _ = decimate(surface.vertices, surface.triangles, MAX_VERTICES)
        colors = colors[cKDTree(surface.vertices).query(vertices)[1]]
        surface = Surface(vertices, triangles)
    figure = Figure(figsize=(1, 1), dpi=PIXELS)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    width = draw_surface(axes, surface, colors)
    axes.set(xlim=(width / 2 - 0.52, width / 2 + 0.52), ylim=(-0.52, 0.52), aspect="equal")
    image = BytesIO()
    figure.savefig(image, format="png", transparent=True)
    return image.getvalue()
