# SPDX-License-Identifier: GPL-3.0-or-later
"""Accuracy of a target that is bound to a rig, in other poses, compared with the posed source."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

import bpy
import numpy as np
from bpy.types import Object
from tqdm import tqdm

from benchmarks.binding.cases import Case, bone_matrices, make_cases, positions, take, weights_of
from benchmarks.binding.methods import WAYS, match_bare
from benchmarks.binding.pictures import draw
from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.mesh.affine_maps import transform_points

# The method with true weights and the true rest pose, which the others are compared with.
TRUE = "true weights"
# A case counts as good as with true weights if its median error is at most this multiple of that.
AS_GOOD = 1.3

Row = dict[str, Any]


def run(data: Path, max_count: int | None, picture_folder: Path | None) -> dict[str, list[Row]]:
    """Bind posed characters to the source's rig, and put the rig into other poses.

    Errors are in percent of the largest extent: the distance to the posed source's surface, and the distance to
    a vertex's true place on it.

    Args:
        data: folder of the sets, with characters among them.
        max_count: largest number of characters of each kind; None for all.
        picture_folder: for a picture of each case.

    Returns:
        `rows`: for each kind, mesh and way medians over cases, and in how many the median distance from the surface is
        at most 1.3 times that with true weights; `cases`: each case and way.
    """
    found: list[Row] = []
    for case in tqdm(make_cases(data, max_count), desc="binding", leave=False):
        found += _rows(case, picture_folder)
    groups = dict.fromkeys((row["kind"], row["mesh"], row["way"]) for row in found)
    ways = [TRUE, *WAYS]
    summary = [
        _sum_up(*group, [row for row in found if (row["kind"], row["mesh"], row["way"]) == group])
        for group in sorted(groups, key=lambda group: (*group[:2], ways.index(group[2])))
    ]
    return {"rows": summary, "cases": found}


def _rows(case: Case, picture_folder: Path | None) -> Iterator[Row]:
    truth = _Truth(case)
    bare, seconds, certainty = match_bare(case)
    exact = _figures([truth.off(points, number) for number, points in enumerate(_by_true_weights(case))])
    shared = {
        "kind": case.kind,
        "mesh": case.mesh,
        "case": case.name,
        "vertices": len(case.target.vertices),
        "certainty": round(certainty, 3),
    }
    yield {**shared, "way": TRUE, **exact, "ratio": 1.0}
    targets = {}
    for name, way in WAYS.items():
        target = bare.copy()
        target.data = bare.data.copy()
        bpy.context.scene.collection.objects.link(target)
        bpy.context.view_layer.update()
        begin = perf_counter()
        way(case, target)
        spent = perf_counter() - begin
        figures = _figures([truth.off(points, number) for number, points in enumerate(_take(case, target))])
        ratio = figures["surface"] / max(exact["surface"], 1e-9)
        yield {**shared, "way": name, **figures, "ratio": ratio, "match s": seconds, "s": spent}
        targets[name] = target
    if picture_folder is not None:
        take(case.armature, case.taken[0])
        shown = [case.source, bare, targets["Bind to Rig"], targets["weights alone"]]
        draw(picture_folder / f"{case.name} {case.mesh}.png".replace(" ", "_").replace(",", ""), shown)
    for target in (bare, *targets.values()):
        bpy.data.meshes.remove(target.data)


class _Truth:
    """The true positions of a target in each of the poses."""

    def __init__(self, case: Case) -> None:
        self.extent = float(np.ptp(case.target.vertices, axis=0).max())
        self.places, self.searches = [], []
        for stance in case.taken:
            take(case.armature, stance)
            points = positions(case.source)
            self.places.append(case.truth.interpolate(points))
            self.searches.append(SurfaceSearch(points, case.truth.source_triangles))
        take(case.armature, {})

    def off(self, points: Floats, number: int) -> Floats:
        """(n, 2) distances of vertices (n, 3) from the surface and from their true places in a pose, in percent."""
        search = self.searches[number]
        triangle, barycentric = search.closest(points)
        nearest = np.einsum("nc,ncx->nx", barycentric, search.vertices[search.triangles[triangle]])
        off = np.stack([points - nearest, points - self.places[number]], axis=1)
        return np.asarray(100 / self.extent * np.linalg.norm(off, axis=2))


def _by_true_weights(case: Case) -> Iterator[Floats]:
    """(n, 3) the target in each pose, with true weights and the true rest pose."""
    names = tuple(bone.name for bone in case.armature.data.bones if bone.use_deform)
    weights = weights_of(case.source, names)
    own = case.truth.interpolate(weights.toarray())

    def matrices() -> Floats:
        return np.einsum("nb,bxy->nxy", own, bone_matrices(case.armature, names))[:, :3]

    take(case.armature, case.bound_in)
    posed = matrices()
    rest = np.einsum("nxy,ny->nx", np.linalg.pinv(posed[:, :, :3]), case.target.vertices - posed[:, :, 3])
    for stance in case.taken:
        take(case.armature, stance)
        yield transform_points(matrices(), rest)
    take(case.armature, {})


def _take(case: Case, target: Object) -> Iterator[Floats]:
    """(n, 3) a bound target in each pose."""
    for stance in case.taken:
        take(case.armature, stance)
        yield positions(target)
    take(case.armature, {})


def _figures(off: list[Floats]) -> Row:
    surface, place = np.concatenate(off).T
    return {
        "surface": float(np.median(surface)),
        "surface p95": float(np.percentile(surface, 95)),
        "place": float(np.median(place)),
        "place p95": float(np.percentile(place, 95)),
    }


def _sum_up(kind: str, mesh: str, way: str, rows: list[Row]) -> Row:
    numbers = ("surface", "surface p95", "place", "place p95", "ratio", "match s", "s")
    known = {name: [row[name] for row in rows if row.get(name) is not None] for name in numbers}
    return {
        "kind": kind,
        "mesh": mesh,
        "way": way,
        "cases": len(rows),
        **{name: float(np.median(values)) if values else None for name, values in known.items()},
        "as good": sum(row["ratio"] <= AS_GOOD for row in rows),
    }
