# SPDX-License-Identifier: GPL-3.0-or-later
"""Outfits moved to other bodies: error, intersections with the skin, distortion, body keys and bones of their own."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from time import process_time

import bpy
import numpy as np
from bpy.types import Object
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.binding.pictures import draw
from benchmarks.outfits.cases import KINDS, WITHIN, Case, cases
from benchmarks.outfits.clothes import Wardrobe, move
from benchmarks.outfits.layers import Layers
from benchmarks.outfits.methods import BY_TRUE_MAP, WAYS, Fitted, bind_to_nearest
from benchmarks.stored import read_or_compute, storing
from benchmarks.tables import NOT_SHOWN, Record, Tables
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals, unique_edges
from zoomout_core.transfer import shape_of_source

# The authors' own outfit on the target, if it is known.
TRUE = "truth"
EVERY_WAY = (*WAYS, BY_TRUE_MAP, TRUE)
# Places farther from the skin, in centimetres, do not count for thickness.
NEAR = 5.0
# Places are in the skin if they are deeper than this, in centimetres.
DEEP = 0.1
# An edge is a fold if the angle between its faces exceeds this, unless it was one before.
FOLD = np.cos(np.radians(120))
# An edge is stretched if it grows by more than this multiple of the body's growth.
STRETCHED = 2.0
# A face is torn if one of its edges grows by more than this multiple, and is longer than this, in centimetres.
TORN, LONG = 5.0, 3.0
# A key that moves a garment by less, in centimetres, is left out.
MOVED = 0.1
CLOTHES, EYES = WORN = "clothes, hair", "eyes, teeth"
# Colours of the skin, and of the objects in turn.
SKIN = (0.85, 0.55, 0.42)
COLOURS = ((0.12, 0.25, 0.6), (0.6, 0.08, 0.08), (0.85, 0.8, 0.65), (0.1, 0.1, 0.09), (0.1, 0.4, 0.15))


def run(
    data: Path,
    pairs: int | None,
    pictures: Path | None = None,
    kinds: Collection[str] = KINDS,
    ways: Collection[str] = EVERY_WAY,
    records: Path | None = None,
) -> Tables:
    """Match bodies, and dress one in the clothes of the other.

    `rows`: for each kind, method and class of worn objects the means over its objects: clothes and hair, and separately
    eyes and teeth, which are inside the head.

    Args:
        data: a folder with the sets `clothes`, and `characters` with `faust_r` and `shrec19_r`, as far as they are
            there.
        pairs: largest number of each kind; all when not given.
        pictures: for a picture of each case that is computed.
        kinds: of the cases.
        ways: methods to compare.
        records: file of the cases that are done; a run of the same code resumes from it.
    """
    strict_keys, found = _strict_keys(data / "clothes"), list[Record]()
    with nullcontext() if records is None else storing(records, [Path(__file__).parent]):
        for case in tqdm([each for each in cases(data, pairs) if each.kind in kinds], leave=False):
            names = (case.kind, case.name, *ways)
            found += read_or_compute(names, partial(_records, case, strict_keys, ways, pictures))
    return {"rows": _rows(found), NOT_SHOWN: found}


def _records(case: Case, strict_keys: frozenset[str], ways: Collection[str], pictures: Path | None) -> list[Record]:
    """A record for each worn object of a case, fitted by each method; CPU seconds."""
    begin = process_time()
    match = zo.match(case.source, case.target)
    matched = process_time()
    shape = shape_of_source(match, case.source, case.target)
    about = {"kind": case.kind, "case": case.name, "match s": matched - begin, "shape s": process_time() - matched}
    found, measure, records = dict[str, Fitted](), _Measure(case, strict_keys), list[Record]()
    fits: dict[str, Callable[[], Fitted]] = {name: partial(way, case, shape) for name, way in WAYS.items()}
    if case.true_shape is not None:
        fits[BY_TRUE_MAP] = partial(bind_to_nearest, case, case.true_shape)
    if case.truth:
        fits[TRUE] = partial(_truth, case)
    for way, fit in fits.items():
        if way in ways:
            begin = process_time()
            found[way] = fit()
            seconds = (process_time() - begin) / len(case.things)
            records += (about | {"way": way, "s": seconds} | row for row in measure.rows(found[way]))
    if pictures is not None:
        _picture(pictures / f"{case.name.replace(' ', '_')}.png", case, shape, found)
    return records


def _strict_keys(folder: Path) -> frozenset[str]:
    """The keys whose effect on garments is not a matter of taste."""
    if not folder.is_dir():
        return frozenset()
    return frozenset(name for name, is_strict in Wardrobe(folder).key_is_strict.items() if is_strict)


def _truth(case: Case) -> Fitted:
    return Fitted(
        [case.truth[name] for name in case.things],
        [garment.keys for garment in case.garments.values()],
        [garment.true_joints for garment in case.garments.values()],
    )


class _Measure:
    """The figures of one case."""

    def __init__(self, case: Case, strict_keys: frozenset[str]) -> None:
        self._case, self._strict_keys = case, strict_keys
        self._expected = _at_rest(case)
        self._layers = {name: Layers(thing, case.source, case.centimetre) for name, thing in case.things.items()}
        self._poses = {} if case.body is None else {"posed": case.body.poses, "extreme": case.body.extremes}
        self._posed = {name: [_in_pose(case, pose) for pose in poses] for name, poses in self._poses.items()}
        keys = {} if case.body is None else case.body.keys
        self._skin = Skin(case.target)
        self._keyed = {
            name: Skin(case.target.with_vertices(case.target.vertices + offsets))
            for name, offsets in keys.items()
            if name in strict_keys
        }

    def rows(self, fitted: Fitted) -> Iterator[Record]:
        """A record for each worn object."""
        case = self._case
        for number, name in enumerate(case.things):
            found = fitted.vertices[number]
            record: Record = {"thing": name, "worn": EYES if name in WITHIN else CLOTHES, "vertices": len(found)}
            record |= self._expected[name].figures(found) | self._layers[name].figures(found)
            if case.body is not None:
                garment = case.garments[name]
                weights = fitted.weights[number] if fitted.weights else garment.weights
                for kind, poses in self._poses.items():
                    figures = [
                        posed[name].in_pose(move(found, weights, pose))
                        for pose, posed in zip(poses, self._posed[kind], strict=True)
                    ]
                    for figure in figures[0] if figures else ():
                        record[f"{kind} {figure}"] = max(each[figure] for each in figures)
            if fitted.keys:
                record |= key_figures(fitted.keys[number], case.garments[name].keys, self._strict_keys)
                record["keyed in skin"] = self._in_keyed_skin(case.things[name], found, fitted.keys[number])
            if fitted.joints and len(fitted.joints[number]):
                off = np.linalg.norm(fitted.joints[number] - case.garments[name].true_joints, axis=1)
                record["bones"] = float(off.mean())
            yield record

    def _in_keyed_skin(self, thing: Surface, found: Floats, keys: dict[str, Floats]) -> float:
        """The percentage of places in the skin with some strict key at 1 but not without; the mean over the keys."""
        still = self._skin.distances(_places(thing, found)) >= -DEEP * self._case.centimetre
        shares = [
            100
            * float(
                (still & (skin.distances(_places(thing, found + keys[key])) < -DEEP * self._case.centimetre)).mean()
            )
            for key, skin in self._keyed.items()
            if np.linalg.norm(keys[key], axis=1).max() >= MOVED
        ]
        return _mean(shares)


def _at_rest(case: Case) -> dict[str, Expected]:
    """The things by name, expected like the truth or, if that is unknown, like they are on the source."""
    skins = Skin(case.source), Skin(case.target)
    return {name: Expected(thing, skins, case.centimetre, case.truth.get(name)) for name, thing in case.things.items()}


def _in_pose(case: Case, pose: Floats) -> dict[str, Expected]:
    """The things by name, expected like the author's refit in the same pose, by transforms (b, 3, 4) of the bones."""
    assert case.body is not None
    skin = Skin(case.target.with_vertices(move(case.target.vertices, case.body.weights, pose)))
    places = {name: move(each.refitted, each.weights, pose) for name, each in case.garments.items()}
    return {
        name: Expected(case.things[name].with_vertices(points), (skin, skin), case.centimetre)
        for name, points in places.items()
    }


def key_figures(found: dict[str, Floats], true: dict[str, Floats], strict: frozenset[str]) -> dict[str, float]:
    """How well offsets (n, 3) of keys agree with the author's, over the keys that move the garment.

    `cosine`: of the offsets of all vertices as one vector; `key error`: sum of distances from the true offsets,
    relative to the sum of these; both over the strict keys. `other key error`: over the others.
    """
    moving = [name for name in true if np.linalg.norm(true[name], axis=1).max() >= MOVED]
    errors = {
        name: np.linalg.norm(found[name] - true[name], axis=1).sum() / np.linalg.norm(true[name], axis=1).sum()
        for name in moving
    }
    cosines = [
        (found[name] * true[name]).sum() / max(np.linalg.norm(found[name]) * np.linalg.norm(true[name]), 1e-12)
        for name in moving
        if name in strict
    ]
    return {
        "cosine": _mean(cosines),
        "key error": _mean([error for name, error in errors.items() if name in strict]),
        "other key error": _mean([error for name, error in errors.items() if name not in strict]),
    }


def _mean(numbers: list[float]) -> float:
    """The mean of the known numbers."""
    known = [number for number in numbers if not np.isnan(number)]
    return float(np.mean(known)) if known else np.nan


class Skin:
    """A body, with signed distances of points."""

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


class Expected:
    """The place of a worn object that is expected on the second of two skins.

    Args:
        thing: the object on the first skin.
        skins: both skins.
        centimetre: its length in units of the first one.
        truth: (n, 3) its vertices on the second one, if they are known.
    """

    def __init__(
        self, thing: Surface, skins: tuple[Skin, Skin], centimetre: float, truth: Floats | None = None
    ) -> None:
        self._thing, self._skin, self._truth = thing, skins[1], truth
        self._growth = skins[1].size / skins[0].size
        self._centimetre = centimetre
        self._was = skins[0].distances(_places(thing, thing.vertices)) / centimetre
        self._off = self._was if truth is None else self._distances(truth)
        self._edges, self._edge_of = unique_edges(thing.triangles)

    def figures(self, found: Floats) -> dict[str, float]:
        """The figures of vertices (n, 3).

        `error`: mean distance of vertices from the truth, in centimetres. `off surface`: mean distance from its
        surface, which is zero if the garment only slides along itself. `in skin`: percentage of places (vertices and
        centroids of triangles) that are in the target's skin but not so in the truth or, if that is unknown, on the
        source; `was in`: that are so there; `all in skin`: that are in the target's skin. `thickness`: median change of
        the distance from the skin, in centimetres, at equal body size. `spread`: standard deviation of the logarithm of
        the ratio of edge lengths. `stretched`: percentage of edges that grow by more than twice the body's growth.
        `torn`: faces with an edge that grows by far more. `folds`: edges at which faces fold over.
        """
        thing = self._thing
        off, near = self._distances(found), (self._was > 0) & (self._was < NEAR)
        stretch, _ = self._stretch(found)
        return {
            "error": np.nan if self._truth is None else self._mean_distance(found, self._truth),
            "off surface": np.nan if self._truth is None else self._mean_distance(found, self._on_truth(found)),
            **self.in_pose(found),
            "thickness": float(np.median(np.abs(off - self._was)[near])) if near.any() else np.nan,
            "spread": float(np.log(stretch).std()),
            "folds": float((_folds(thing, found) & ~_folds(thing, thing.vertices)).sum()),
        }

    def _mean_distance(self, found: Floats, others: Floats) -> float:
        """The mean distance of vertices (n, 3) from others (n, 3), in centimetres."""
        return float(np.linalg.norm(found - others, axis=1).mean() / self._centimetre)

    def _on_truth(self, found: Floats) -> Floats:
        """(n, 3) the points of the true surface closest to vertices (n, 3)."""
        assert self._truth is not None
        triangle, weights = closest_points(found, self._truth, self._thing.triangles)
        return np.asarray(np.einsum("nc,ncx->nx", weights, self._truth[self._thing.triangles[triangle]]))

    def in_pose(self, found: Floats) -> dict[str, float]:
        """Those of the figures that a pose may change."""
        off = self._distances(found)
        stretch, length = self._stretch(found)
        torn = (stretch > TORN * self._growth) & (length > LONG * self._centimetre * self._growth)
        return {
            "in skin": 100 * float(((off < -DEEP) & (self._off >= -DEEP)).mean()),
            "was in": 100 * float((self._off < -DEEP).mean()),
            "all in skin": 100 * float((off < -DEEP).mean()),
            "stretched": 100 * float((stretch > STRETCHED * self._growth).mean()),
            "torn": float(torn[self._edge_of].any(axis=1).sum()),
        }

    def _stretch(self, found: Floats) -> tuple[Floats, Floats]:
        """(e,) how many times as long as before the edges are, and (e,) their lengths."""
        before, after = (
            np.linalg.norm(np.diff(points[self._edges], axis=1)[:, 0], axis=1)
            for points in (self._thing.vertices, found)
        )
        return np.maximum(after, 1e-12) / np.maximum(before, 1e-12), after

    def _distances(self, points: Floats) -> Floats:
        """(p,) distances of places from the second skin, in centimetres at the size of the first one."""
        return self._skin.distances(_places(self._thing, points)) / self._centimetre / self._growth


def _places(thing: Surface, points: Floats) -> Floats:
    """(n + m, 3) vertices and centroids of triangles of a thing with vertices (n, 3)."""
    return np.concatenate([points, points[thing.triangles].mean(axis=1)])


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
    """Means over the objects of each kind, of known values only."""
    rows, of = [], ("kind", "worn", "way")
    for group in dict.fromkeys(tuple(record[name] for name in of) for record in records):
        chosen = [record for record in records if tuple(record[name] for name in of) == group]
        names = dict.fromkeys(name for record in chosen for name in record if name not in (*of, "case", "thing"))
        means = {name: _mean([record.get(name, np.nan) for record in chosen]) for name in names}
        known = {name: None if np.isnan(mean) else mean for name, mean in means.items()}
        rows.append({**dict(zip(of, group, strict=True)), "things": len(chosen), **known})
    return sorted(rows, key=lambda row: (KINDS.index(row["kind"]), WORN.index(row["worn"])))


def _picture(path: Path, case: Case, shape: Floats, found: dict[str, Fitted]) -> None:
    """The dressed source, and the target, turned like it, dressed by each method."""
    motion = procrustes(shape, case.source.vertices)
    things = list(case.things.values())
    shown = [_join_dressed(case.source.vertices, case.source, [thing.vertices for thing in things], things)]
    for way in (TRUE, "dress", "Surface Deform"):
        if way in found:
            positions = [motion(each) for each in found[way].vertices]
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
