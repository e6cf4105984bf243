# SPDX-License-Identifier: GPL-3.0-or-later
"""Symmetries from the signs of the first four eigenfunctions, ranked by commutativity with the Laplacian.

As in Melzi et al. 2019, section 5.3: every diagonal map of signs is refined to size 100. They show a vase whose three
symmetries rank first. The constant function, whose sign is known, does not count among the four: on the vase here, no
eigenfunction before the fourth differs between front and back.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from time import perf_counter

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.paper.objects import rigid_motion, things
from benchmarks.pictures import View, draw_views
from benchmarks.tables import Record, Tables
from zoomout_core.arrays import Floats, Integers
from zoomout_core.colors import place_colors
from zoomout_core.evaluation import distance_distortion
from zoomout_core.matching.hypotheses.signs import sign_hypotheses
from zoomout_core.mesh.surface import Surface
from zoomout_core.symmetry.detect import isometry_errors
from zoomout_core.symmetry.self_map import main_shape

FOLDER = "self_symmetry"
# Sizes of the functional maps: steps of one while they are small, then of five.
SIZE = 5
SIZES = (*range(6, 21), *range(25, 101, 5))
SAMPLES = 500
# Number of rows of each shape in the table.
SHOWN = 5
# Maps are equal if the mean distance of their images, relative to the root of the area, is smaller than this.
SAME = 0.05


@dataclass(frozen=True, eq=False)
class Ranked:
    """A refined map of a shape onto itself.

    Attributes:
        signs: signs of the first eigenfunctions, such as `+--`, without the constant one's.
        functional_map: (k, k).
        vertex: (n,) image of each vertex.
        energies: commutativity and orthonormality, of all functions and of the first 20.
        seconds: time of ZoomOut.
    """

    signs: str
    functional_map: Floats
    vertex: Integers
    energies: dict[str, float]
    seconds: float


def run(data: Path, shapes: int | None, figure: Path | None) -> Tables:
    """Refine all signs on a vase, if Blender's module is installed to build it, and on the shapes of `self_symmetry`.

    `rows`, for each shape and the first five maps that are neither the identity nor a repetition, the best
    commutativity first: commutativity and orthonormality error of the functional map of size 100 and of its first 20
    functions; the mean change of geodesic distances, and the mean distance of a
    vertex from its image under the map applied twice (both times 1000, at unit area, zero for a reflection or a half
    turn); the distance of the map from a rigid motion, likewise, which is large for symmetries of bent poses;
    seconds without the basis. `pairs`: the same for all 15 choices, with the map that each repeats. All six shapes take
    about a minute of processor time, on 500 samples.

    Args:
        data: the folder of the sets.
        shapes: number of shapes, the vase first; all by default.
        figure: an image file for the shapes, with the colours transferred by each map.
    """
    rows: list[Record] = []
    pictures: list[list[View]] = []
    for name, surface in tqdm(list(islice(_shapes(data), shapes)), leave=False):
        body, ranked = ranked_signs(surface)
        of_shape = rows_of(body, ranked)
        rows += [{"shape": name} | row for row in of_shape]
        colour = place_colors(body.vertices, body.vertices)
        views = [
            View(f"{row['rank']}. {row['signs']} {row['commutativity']:.2f}", body, colour[each.vertex])
            for row, each in zip(of_shape, ranked, strict=True)
            if row["rank"]
        ]
        pictures.append([View(name, body, colour), *views[:SHOWN]])
    if figure is not None and pictures:
        draw_views(figure, pictures)
    return {"rows": distinct_rows(rows), "pairs": rows}


def distinct_rows(rows: list[Record]) -> list[Record]:
    """The first distinct maps of each shape, in the same order."""
    distinct = [row for row in rows if row["rank"]]
    return [row for name in dict.fromkeys(r["shape"] for r in rows) for row in _of(name, distinct)[:SHOWN]]


def _of(name: str, rows: list[Record]) -> list[Record]:
    return [row for row in rows if row["shape"] == name]


def ranked_signs(surface: Surface) -> tuple[Surface, list[Ranked]]:
    """The largest part of a surface, at unit area, and its refined choices of signs, the best commutativity first."""
    shape = main_shape(surface, SIZES[-1], SAMPLES, proxy_vertices=None)
    ranked = []
    for hypothesis in sign_hypotheses(shape, shape):
        start = hypothesis.functional_map
        if len(start) != SIZE or np.array_equal(start, np.eye(SIZE)):
            continue
        begin = perf_counter()
        refined = zo.zoomout(shape.basis, shape.basis, start, samples=SAMPLES, sizes=SIZES)
        seconds = perf_counter() - begin
        signs = "".join("+-"[int(sign < 0)] for sign in np.diag(start)[1:])
        energy = isometry_errors(refined.functional_map, shape.basis.eigenvalues)
        ranked.append(Ranked(signs, refined.functional_map, refined.vertex, energy, seconds))
    body = Surface(shape.mesh.vertices, shape.mesh.oriented_triangles)
    return body, sorted(ranked, key=lambda each: each.energies["commutativity"])


def rows_of(body: Surface, ranked: list[Ranked]) -> list[Record]:
    """A row for each map of a surface onto itself, in the same order."""
    every = np.arange(len(body.vertices))
    distinct: list[Integers] = []
    rows: list[Record] = []
    for each in ranked:
        same = [i for i, other in enumerate([every, *distinct]) if _apart(each.vertex, other, body) < SAME]
        if not same:
            distinct.append(each.vertex)
        surface_map = zo.SurfaceMap.from_vertices(each.vertex, body)
        rows.append(
            {"rank": None if same else len(distinct), "signs": each.signs}
            | each.energies
            | {
                "distortion": 1000 * distance_distortion(each.vertex, every, body, body),
                "there twice": 1000 * _apart(each.vertex[each.vertex], every, body),
                "off a rigid motion": 1000 * rigid_motion(body, surface_map)[1],
                "same as": None if not same else f"rank {same[0]}" if same[0] else "the identity",
                "seconds": each.seconds,
            }
        )
    return rows


def _apart(first: Integers, second: Integers, body: Surface) -> float:
    """Mean Euclidean distance between the images under two maps, relative to the square root of the area."""
    return float(np.linalg.norm(body.vertices[first] - body.vertices[second], axis=1).mean() / np.sqrt(body.area))


def _shapes(data: Path) -> Iterator[tuple[str, Surface]]:
    """Name and surface of each shape, the vase first."""
    if find_spec("bpy") is not None:
        name, vase, _ = next(things())
        yield name, vase
    for path in sorted(data.glob(f"{FOLDER}/*.off")):
        yield f"{FOLDER} {path.stem}", zo.read_surface(path)
