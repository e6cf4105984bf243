# SPDX-License-Identifier: GPL-3.0-or-later
"""Outfits moved to other bodies: their error, intersections with the skin, and distortion."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from time import perf_counter

import bpy
import numpy as np
from bpy.types import Object
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.binding.pictures import draw
from benchmarks.dressing.cases import SAME, WITHIN, Case, cases
from benchmarks.dressing.methods import WAYS
from benchmarks.tables import NOT_SHOWN, Record, Tables
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals, unique_edges
from zoomout_core.transfer import shape_of_source

# The authors' own outfit on the target, if it is known.
TRUE = "truth"
# Places farther from the skin, in centimetres, do not count for thickness and intersections.
NEAR = 5.0
# An edge is a fold if the angle between its faces exceeds this, unless it was one before.
FOLD = np.cos(np.radians(120))
CLOTHES, EYES = WORN = "clothes, hair", "eyes, teeth"
# Colours of the skin, and of the objects in turn.
SKIN = (0.85, 0.55, 0.42)
COLOURS = ((0.12, 0.25, 0.6), (0.6, 0.08, 0.08), (0.85, 0.8, 0.65), (0.1, 0.1, 0.09), (0.1, 0.4, 0.15))


def run(data: Path, pairs: int | None, pictures: Path | None = None) -> Tables:
    """Match bodies, and dress one in the clothes of the other.

    `rows`: for each kind, method and class of worn objects the means over its cases, each of them a mean over the
    objects: clothes and hair, and separately eyes and teeth, which are inside the head.

    Args:
        data: a folder with the set `characters`, and `faust_r` and `shrec19_r` or not.
        pairs: largest number of each kind; all when not given.
        pictures: for a picture of each case.
    """
    records: list[Record] = []
    for case in tqdm(list(cases(data, pairs)), leave=False):
        begin = perf_counter()
        match = zo.match(case.source, case.target)
        matched = perf_counter()
        shape = shape_of_source(match, case.source, case.target)
        about = {"kind": case.kind, "case": case.name, "match s": matched - begin, "shape s": perf_counter() - matched}
        found: dict[str, list[Floats]] = {}
        for way, carried in WAYS.items():
            begin = perf_counter()
            found[way] = carried(case, shape)
            records += _of_case(about | {"way": way, "s": perf_counter() - begin}, case, found[way])
        if case.truth:
            found[TRUE] = [case.truth[name] for name in case.things]
            records += _of_case(about | {"way": TRUE, "s": 0.0}, case, found[TRUE])
        if pictures is not None:
            _picture(pictures / f"{case.name.replace(' ', '_')}.png", case, shape, found)
    return {"rows": _rows(records), NOT_SHOWN: records}


def _of_case(about: Record, case: Case, found: list[Floats]) -> Iterator[Record]:
    """Means over the worn objects, eyes and teeth separately; `folds` are summed."""
    skins, named = (_Skin(case.source), _Skin(case.target)), dict(zip(case.things, found, strict=True))
    for worn in WORN:
        names = [name for name in named if (name in WITHIN) == (worn == EYES)]
        each = [figures(case.things[n], named[n], skins, case.centimetre, case.truth.get(n)) for n in names]
        if not each:
            continue
        means = {name: _mean([one[name] for one in each]) for name in each[0]}
        count, folds = sum(len(named[name]) for name in names), sum(int(one["folds"]) for one in each)
        yield {**about, "worn": worn, "vertices": count, **means, "folds": folds}


def _mean(numbers: list[float]) -> float:
    """The mean of the known numbers."""
    known = [number for number in numbers if not np.isnan(number)]
    return float(np.mean(known)) if known else np.nan


class _Skin:
    """A body, with a test of whether points are inside."""

    def __init__(self, body: Surface) -> None:
        self.size = float(np.sqrt(body.area))
        self._body = body
        self._search = OrientedSurface(body.vertices, body.triangles, np.zeros(len(body.triangles), dtype=bool), 0.0)
        self._normals = body.working.vertex_normals[body.working.vertex_of]

    def distances(self, points: Floats) -> Floats:
        """(q,) distances from the skin, negative inside."""
        triangle, weights, distance = self._search.closest(points, np.zeros_like(points))
        corners = self._body.triangles[triangle]
        off = points - np.einsum("qc,qcx->qx", weights, self._body.vertices[corners])
        along = np.einsum("qx,qc,qcx->q", off, weights, self._normals[corners])
        return np.where(along < 0, -distance, distance)


def figures(
    thing: Surface, found: Floats, skins: tuple[_Skin, _Skin], centimetre: float, truth: Floats | None
) -> dict[str, float]:
    """The figures of one worn object.

    `error`: mean distance from the truth, in centimetres. `in skin`: percentage of places (vertices and centroids of
    triangles near the skin) that are inside the target's skin and were outside the source's; `was in`: that were inside
    the source's. `thickness`: median change of the distance from the skin, in centimetres, at equal body size.
    `stretch`: standard deviation of the logarithm of the ratio of edge lengths. `folds`: edges at which faces fold
    over.
    """
    growth = skins[1].size / skins[0].size
    before, after = (
        np.concatenate([points, points[thing.triangles].mean(axis=1)]) for points in (thing.vertices, found)
    )
    was, off = skins[0].distances(before) / centimetre, skins[1].distances(after) / centimetre / growth
    outside = (was > 0) & (was < NEAR)
    edges, _ = unique_edges(thing.triangles)
    lengths = [np.linalg.norm(np.diff(points[edges], axis=1)[:, 0], axis=1) for points in (thing.vertices, found)]
    stretch = np.log(np.maximum(lengths[1], 1e-12) / np.maximum(lengths[0], 1e-12))
    return {
        "error": np.nan if truth is None else float(np.linalg.norm(found - truth, axis=1).mean() / centimetre),
        "in skin": 100 * float((outside & (off < 0) & (off > -NEAR)).sum() / max(1, outside.sum())),
        "was in": 100 * float(((was < 0) & (was > -NEAR)).mean()),
        "thickness": float(np.median(np.abs(off - was)[outside])) if outside.any() else np.nan,
        "stretch": float(stretch.std()),
        "folds": float((_folds(thing, found) & ~_folds(thing, thing.vertices)).sum()),
    }


def _folds(thing: Surface, points: Floats) -> Booleans:
    """(e,) edges between two triangles, one of which folds over the other."""
    working = thing.working
    used = np.flatnonzero(working.vertex_of >= 0)
    first = np.empty(len(working.vertices), dtype=np.int64)
    first[working.vertex_of[used]] = used
    corners = working.oriented_triangles
    normals = triangle_normals(points[first], corners)
    _, edge_of = unique_edges(corners)
    order = np.argsort(edge_of.ravel(), kind="stable")
    edge, face = edge_of.ravel()[order], order // 3
    same = edge[1:] == edge[:-1]
    return np.asarray(same & (np.einsum("mx,mx->m", normals[face[1:]], normals[face[:-1]]) < FOLD))


def _rows(records: list[Record]) -> list[Record]:
    """Means over the cases of each kind, of known values only."""
    rows, of = [], ("kind", "worn", "way")
    for group in dict.fromkeys(tuple(record[name] for name in of) for record in records):
        chosen = [record for record in records if tuple(record[name] for name in of) == group]
        means = {name: _mean([record[name] for record in chosen]) for name in chosen[0] if name not in (*of, "case")}
        known = {name: mean for name, mean in means.items() if not np.isnan(mean)}
        rows.append({**dict(zip(of, group, strict=True)), "cases": len(chosen), **dict.fromkeys(means), **known})
    return sorted(rows, key=lambda row: (row["kind"] != SAME, WORN.index(row["worn"])))


def _picture(path: Path, case: Case, shape: Floats, found: dict[str, list[Floats]]) -> None:
    """The dressed source, and the target, turned like it, dressed by each method."""
    motion = procrustes(shape, case.source.vertices)
    things = list(case.things.values())
    shown = [_join_dressed(case.source.vertices, case.source, [thing.vertices for thing in things], things)]
    for way in (TRUE, "dress", "Surface Deform"):
        if way in found:
            positions = [motion(each) for each in found[way]]
            shown.append(_join_dressed(motion(case.target.vertices), case.target, positions, things))
    draw(path, shown)
    for obj in shown:
        bpy.data.meshes.remove(obj.data)


def _join_dressed(points: Floats, body: Surface, worn: list[Floats], things: list[Surface]) -> Object:
    """A body and its clothes as one object, each in its own colour."""
    parts = [body.with_vertices(points), *(thing.with_vertices(each) for thing, each in zip(things, worn, strict=True))]
    whole = Surface.joined(parts)
    mesh = bpy.data.meshes.new("Dressed")
    faces = np.split(whole.corner_vertex, whole.face_start[1:-1])
    # The outfits have y up.
    mesh.from_pydata(whole.vertices[:, [0, 2, 1]] * [1, -1, 1], [], [face.tolist() for face in faces])
    for number in range(len(parts)):
        colour = SKIN if number == 0 else COLOURS[(number - 1) % len(COLOURS)]
        material = bpy.data.materials.new("Colour")
        if material.node_tree is None:  # before Blender 5.0, nodes must be enabled
            material.use_nodes = True
        material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*colour, 1)
        mesh.materials.append(material)
    index = np.repeat(np.arange(len(parts)), [len(part.face_start) - 1 for part in parts])
    mesh.polygons.foreach_set("material_index", index.astype(np.int32))
    obj = bpy.data.objects.new("Dressed", mesh)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj
