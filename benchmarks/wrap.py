# SPDX-License-Identifier: GPL-3.0-or-later
"""Wrap the target's topology to the source's shape: distance, distortion and folds, compared with closest points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from time import process_time
from typing import TypeAlias

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.datasets import evenly, load_pair, pair_names
from benchmarks.pictures import View, draw_views
from benchmarks.tables import NOT_SHOWN, Record, Tables
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals, unique_edges

# Default number of pairs of each set.
PEOPLE, ANIMALS, CHARACTERS = 4, 3, 3
# A vertex is on the source if its distance is at most this fraction of the source's height.
ON_SOURCE = 0.003
# An edge is a fold if the angle between its faces exceeds this, unless the target has a fold there.
FOLD = np.cos(np.radians(120))
Pair: TypeAlias = tuple[str, str, Surface, Surface]


def run(data: Path, pairs: int | None, pictures: Path | None = None) -> Tables:
    """Match pairs, and wrap each target to its source.

    `rows`: for each set and each of `METHODS`, which all get the same map, means over the pairs.

    Args:
        data: a folder with some or all of the sets `faust_r`, `smal_r` and `characters`.
        pairs: number of pairs of each set; by default 4, 3 and 3.
        pictures: for a picture of each pair.
    """
    records: list[Record] = []
    for kind, name, source, target in tqdm(list(pairs_in(data, pairs)), leave=False):
        match = zo.match(source, target)
        views = [View("source", source, _grey(source, np.zeros(len(source.triangles), dtype=bool)))]
        for method, shape in METHODS.items():
            begin = process_time()
            found = shape(match, source, target)
            about = {"set": kind, "pair": name, "method": method, "seconds": process_time() - begin}
            records.append(about | figures(found, source, target, match.has_partner))
            moved = target.with_vertices(found)
            views.append(View(method, moved, _grey(moved, facing_against(found, source, target))))
        if pictures is not None:
            draw_views(pictures / f"{name}.png", [views])
    return {"rows": _rows(records), NOT_SHOWN: records}


def pairs_in(data: Path, max_count: int | None) -> Iterator[Pair]:
    """Set, name, source and target of the pairs."""
    if (folder := data / "faust_r").is_dir():
        two_persons = [names for names in pair_names(folder, None) if names[0][:-1] != names[1][:-1]]
        yield from _load("people", folder, evenly(two_persons, max_count or PEOPLE))
    if (folder := data / "smal_r").is_dir():
        yield from _load("animals", folder, pair_names(folder, max_count or ANIMALS))
    if (folder := data / "characters" / "game").is_dir():
        from benchmarks.characters.cases import first_pairs  # it starts Blender, which must come before pymeshlab

        for case in islice(first_pairs(folder), max_count or CHARACTERS):
            yield "characters", case.name.replace(" ", "_"), case.source, case.target


def _load(kind: str, folder: Path, names: list[tuple[str, str]]) -> Iterator[Pair]:
    for target_name, source_name in names:
        pair = load_pair(folder, target_name, source_name)
        yield kind, f"{source_name}_{target_name}", pair.source, pair.target


# --- methods ------------------------------------------------------------------------------------------------


def closest_to_conformed(match: MatchResult, source: Surface, target: Surface) -> Floats:
    """Closest points of the source to the result of *Shape as Key*."""
    search = SurfaceSearch(source.vertices, source.triangles)
    return _on(source, *search.closest(zo.conform(match, source, target)))


METHODS: dict[str, Callable[[MatchResult, Surface, Surface], Floats]] = {
    "images": lambda match, source, target: match.surface_map.interpolate(source.vertices),
    "conform": zo.conform,
    "conform, closest": closest_to_conformed,
    "wrap": lambda match, source, target: zo.wrap(match, source, target).vertices,
    "wrap, smooth": lambda match, source, target: zo.wrap(match, source, target, smoothness=0.8).vertices,
}


# --- figures ------------------------------------------------------------------------------------------------


def figures(found: Floats, source: Surface, target: Surface, has_partner: Booleans) -> Record:
    """The figures of positions (n_t, 3) of the target's vertices, at those with a partner.

    `on source`: percentage of vertices within 0.3 % of the source's height. `angle`: mean change of the angles of
    faces, in degrees. `against`: faces on the source with opposite normals. `folds`: edges at which faces fold over.
    `crossing`: faces that cross others, beyond those of the target. `edges`: standard deviation of the logarithm of
    the ratio of edge lengths.
    """
    search = SurfaceSearch(source.vertices, source.triangles)
    distance = np.linalg.norm(_on(source, *search.closest(found)) - found, axis=1)
    triangles = target.triangles
    kept = has_partner[triangles].all(axis=1)
    edges, _ = unique_edges(triangles[kept])
    growth = np.log(np.maximum(_lengths(found, edges), 1e-300) / np.maximum(_lengths(target.vertices, edges), 1e-300))
    change = np.abs(_angles(found, triangles[kept]) - _angles(target.vertices, triangles[kept]))
    return {
        "vertices": len(found),
        "on source": 100 * float((distance < ON_SOURCE * np.ptp(source.vertices, axis=0).max())[has_partner].mean()),
        "angle": float(change.mean()),
        "against": int((facing_against(found, source, target) & kept).sum()),
        "folds": int((_folds(found, target) & ~_folds(target.vertices, target)).sum()),
        "crossing": crossing(found, target) - crossing(target.vertices, target),
        "edges": float(growth.std()),
    }


def facing_against(found: Floats, source: Surface, target: Surface) -> Booleans:
    """(m,) triangles of the target that are on the source and have opposite normals."""
    corners = _outward(target)
    middles = found[corners].mean(axis=1)
    triangle, weights = SurfaceSearch(source.vertices, source.triangles).closest(middles)
    near = np.linalg.norm(_on(source, triangle, weights) - middles, axis=1)
    normals = source.working.vertex_normals[source.working.vertex_of]
    normals = np.einsum("mc,mcx->mx", weights, normals[source.triangles[triangle]])
    facing = np.einsum("mx,mx->m", triangle_normals(found, corners), normals)
    return (facing < 0) & (near < ON_SOURCE * np.ptp(source.vertices, axis=0).max())


def crossing(points: Floats, target: Surface) -> int:
    """How many triangles cross others."""
    import pymeshlab  # must not be imported before Blender

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points, target.triangles.astype(np.int32)))
    meshes.compute_selection_by_self_intersections_per_face()
    return int(meshes.current_mesh().selected_face_number())


def _folds(points: Floats, target: Surface) -> Booleans:
    """(e,) edges between two triangles, one of which folds over the other."""
    corners = target.working.oriented_triangles
    normals = triangle_normals(points[_first_vertices(target)], corners)
    _, edge_of = unique_edges(corners)
    order = np.argsort(edge_of.ravel(), kind="stable")
    edge, face = edge_of.ravel()[order], order // 3
    same = edge[1:] == edge[:-1]
    return np.asarray(same & (np.einsum("mx,mx->m", normals[face[1:]], normals[face[:-1]]) < FOLD))


def _first_vertices(target: Surface) -> np.ndarray:
    """(n_w,) a vertex of the target for each vertex of its working mesh."""
    used = np.flatnonzero(target.working.vertex_of >= 0)
    first = np.empty(len(target.working.vertices), dtype=np.int64)
    first[target.working.vertex_of[used]] = used
    return first


def _outward(target: Surface) -> np.ndarray:
    """(m, 3) the target's triangles with outward orientation."""
    corners, working = target.triangles.copy(), target.working
    inward = working.triangle_of[working.flipped]
    corners[inward] = corners[inward][:, ::-1]
    return corners


def _on(source: Surface, triangle: np.ndarray, weights: Floats) -> Floats:
    """(q, 3) points of the source."""
    return np.asarray(np.einsum("qc,qcx->qx", weights, source.vertices[source.triangles[triangle]]))


def _lengths(points: Floats, edges: np.ndarray) -> Floats:
    return np.asarray(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1))


def _angles(points: Floats, triangles: np.ndarray) -> Floats:
    """(m, 3) angles of triangles, in degrees."""
    sides = points[np.roll(triangles, -1, axis=1)] - points[triangles]
    sides /= np.maximum(np.linalg.norm(sides, axis=2, keepdims=True), 1e-300)
    return np.degrees(np.arccos(np.clip(-(sides * np.roll(sides, 1, axis=1)).sum(axis=2), -1, 1)))


def _rows(records: list[Record]) -> list[Record]:
    """Means over the pairs of each set, and over all."""
    if not records:
        return []
    rows = []
    sets = [*dict.fromkeys(record["set"] for record in records), "all"]
    for kind, method in ((kind, method) for kind in sets for method in METHODS):
        chosen = [each for each in records if each["method"] == method and kind in (each["set"], "all")]
        numbers = [name for name in chosen[0] if name not in ("set", "pair", "method")]
        means = {name: float(np.mean([each[name] for each in chosen])) for name in numbers}
        rows.append({"set": kind, "method": method, "pairs": len(chosen)} | means)
    return rows


def _grey(surface: Surface, marked: Booleans) -> Floats:
    """(n, 3) grey, and red at the corners of triangles that are marked."""
    colours = np.full((len(surface.vertices), 3), 0.8)
    colours[surface.triangles[marked]] = [1.0, 0.1, 0.1]
    return colours
