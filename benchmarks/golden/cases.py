# SPDX-License-Identifier: GPL-3.0-or-later
"""The cases of `golden`: small pairs and calls of every sort, computed by public functions alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, issparse

import zoomout_core as zo
from benchmarks.datasets import load_pair
from zoomout_core import samples
from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.triangles import unit_vectors, vertex_normals
from zoomout_core.samples.grids import grid_faces
from zoomout_core.samples.spheres import outward_hull

Fields: TypeAlias = dict[str, Any]
Shape: TypeAlias = zo.Surface | zo.PointCloud

# Number of hexadecimal digits of a stored hash.
DIGITS = 16
FAST: dict[str, Any] = {"k_final": 60, "samples": 500, "proxy_vertices": 2000}
# Number of vertices of generated shapes.
USUAL, SMALL, TINY = 2500, 1000, 150


@dataclass(frozen=True)
class Case:
    """A computation with recorded results.

    Attributes:
        name: its first word is the sort.
        fields: computes the recorded results, given the folder of the sets, from new shapes without cached results.
        needs: files in that folder.
    """

    name: str
    fields: Callable[[Path], Fields]
    needs: tuple[str, ...] = ()

    @property
    def sort(self) -> str:
        """The first word of the name."""
        return self.name.split()[0]


# --- hashes -------------------------------------------------------------------------------------------------


def hash_of(*arrays: Any) -> str:
    """A hash of the bytes of arrays, dense or sparse."""
    digest = sha256()
    for array in arrays:
        for each in ("data", "indices", "indptr") if issparse(array) else (None,):
            digest.update(np.ascontiguousarray(array if each is None else getattr(array, each)).tobytes())
    return digest.hexdigest()[:DIGITS]


def of_map(surface_map: zo.SurfaceMap) -> Fields:
    """The fields of a map."""
    return {"triangle": hash_of(surface_map.triangle), "barycentric": hash_of(surface_map.barycentric)}


def of_match(result: zo.MatchResult) -> Fields:
    """The fields of a match."""
    return of_map(result.surface_map) | {
        "confidence": hash_of(result.confidence),
        "functional_map": hash_of(result.functional_map),
        "partners": hash_of(result.has_partner, result.source_has_partner),
        "certainty": repr(float(result.certainty)),
        "candidates": hash_of([candidate.certainty for candidate in result.candidates]),
        "notes": list(result.notes),
    }


def of_symmetries(found: tuple[zo.Symmetry, ...]) -> Fields:
    """The fields of symmetries, numbered."""
    fields: Fields = {"count": len(found)}
    for number, symmetry in enumerate(found):
        each = of_map(symmetry.surface_map) | {
            "confidence": hash_of(symmetry.confidence),
            "functional_map": hash_of(symmetry.functional_map),
            "distance": hash_of(symmetry.distance),
            "order": symmetry.order,
            "certainty": repr(float(symmetry.certainty)),
            "scores": {name: repr(float(score)) for name, score in symmetry.scores.items()},
            "return_error": repr(float(symmetry.return_error)),
            "origin": symmetry.origin,
            "notes": list(symmetry.notes),
        }
        fields |= _with_prefix(str(number), each)
    return fields


def of_collection(result: zo.CollectionResult) -> Fields:
    """The fields of the maps of a collection, by pair."""
    fields: Fields = {"failures": result.failures, "matched": result.matched}
    for pair, record in sorted(result.records.items()):
        each = of_map(result.surface_map(pair.source, pair.target)) | {
            "certainty": repr(float(record.certainty)),
            "candidate": record.candidate,
            "through": record.through,
            "notes": list(record.notes),
        }
        fields |= _with_prefix(f"{pair.source} {pair.target}", each)
    return fields


def of_attribute(attribute: zo.Attribute) -> Fields:
    """The fields of an attribute."""
    return {"values": hash_of(attribute.values), "labels": list(attribute.labels), "notes": list(attribute.notes)}


def of_basis(basis: zo.SpectralBasis) -> Fields:
    """The fields of a basis."""
    return {name: hash_of(getattr(basis, name)) for name in ("eigenvalues", "eigenvectors", "areas")}


def _with_prefix(prefix: str, fields: Fields) -> Fields:
    return {f"{prefix} {name}": value for name, value in fields.items()}


# --- shapes -------------------------------------------------------------------------------------------------


def creature(
    count: int = USUAL, seed: int = 0, bend: float = 0.0, asymmetry: float = 0.3, without: int | None = None
) -> zo.Surface:
    """A creature, by default with longer left limbs."""
    return samples.creature(count, seed, bend, asymmetry, without).surface


def true_map(source_seed: int = 0, target_seed: int = 1, count: int = USUAL) -> Integers:
    """(n_t,) the source vertex of each vertex of a creature of the same size."""
    return samples.true_vertex(samples.creature(count, source_seed), samples.creature(count, target_seed))


def round_shape(radius: Callable[[Floats], Floats], count: int = USUAL, seed: int = 0) -> zo.Surface:
    """An irregular mesh of a star-shaped surface, given its radius in each direction."""
    where = samples.directions(count, seed)
    return zo.Surface(where * radius(where)[:, None], outward_hull(where))


def solid(normals: ArrayLike) -> Callable[[Floats], Floats]:
    """The radius of a solid with faces at unit distance in some directions and the opposite ones."""
    towards = unit_vectors(np.asarray(normals, dtype=float))
    return lambda where: 1 / np.abs(where @ towards.T).max(axis=1)


CUBE = solid(np.eye(3))
BOX = solid([[1.0, 0, 0], [0.0, 1, 0], [0.0, 0, 1], [1.0, 1, 0.3]])
_PHI = (1 + 5**0.5) / 2
ICOSAHEDRON = solid(
    np.array(
        [[a, b, c] for a in (1, -1) for b in (1, -1) for c in (1, -1)]
        + [np.roll([0, sign / _PHI, _PHI], turn).tolist() for sign in (1, -1) for turn in range(3)]
    )
)


def gear(where: Floats) -> Floats:
    """The radius of a star with five arms, which has rotations but no reflections."""
    angle = np.arctan2(where[:, 1], where[:, 0])
    return 1 + (1 - where[:, 2] ** 2) * (0.5 * np.cos(5 * angle) + 0.3 * np.sin(10 * angle)) + 0.3 * where[:, 2]


def egg(where: Floats) -> Floats:
    """The radius of a body without extremities and with three different axes."""
    return np.asarray(1 / np.linalg.norm(where / [1.0, 1.5, 2.1], axis=1) * (1 + 0.1 * where[:, 2]))


def torus(columns: int = 48, rows: int = 24) -> zo.Surface:
    """A torus of quads."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    around, across = 2 * np.pi * i / columns, 2 * np.pi * j / rows
    ring = 2 + np.cos(across) * (1 + 0.2 * np.cos(around))
    points = np.column_stack([ring * np.cos(around), ring * np.sin(around), np.sin(across)])
    return zo.Surface(points, grid_faces(columns, rows, (True, True)))


def keep_faces(surface: zo.Surface, inside: Callable[[Floats], Any]) -> zo.Surface:
    """The faces of a surface whose corners are all selected."""
    triangles = surface.triangles[np.asarray(inside(surface.vertices))[surface.triangles].all(axis=1)]
    used, compact = np.unique(triangles, return_inverse=True)
    return zo.Surface(surface.vertices[used], compact.reshape(-1, 3))


def shirt(seed: int, count: int = SMALL) -> zo.Surface:
    """A shell above the body and the arms of a creature at rest."""
    skin = creature(count, seed, asymmetry=0)
    above = skin.vertices + 0.06 * vertex_normals(skin.vertices, skin.triangles)
    shell = zo.Surface(above, skin.triangles)
    return keep_faces(shell, lambda points: (np.abs(points[:, 2]) < 0.85) & (np.abs(points[:, 0]) < 2.2))


def clothe(seed: int, bend: float) -> zo.Surface:
    """A creature with loose parts: a shirt, eyes and buttons."""
    balls = [((-0.3, -0.55, 1.3), 0.12), ((0.3, -0.55, 1.3), 0.12), ((0, -0.85, 0.3), 0.06), ((0, -0.85, -0.1), 0.06)]
    loose = [round_shape(lambda where: np.ones(len(where)), 80, seed + number) for number in range(len(balls))]
    placed = [
        ball.with_vertices(radius * unit_vectors(ball.vertices) + at)
        for ball, (at, radius) in zip(loose, balls, strict=True)
    ]
    everything = zo.Surface.joined([creature(USUAL, seed, asymmetry=0), shirt(seed + 20), *placed])
    return everything.with_vertices(samples.posed(everything.vertices, bend))


def scale(surface: zo.Surface, factor: float) -> zo.Surface:
    """Convert a surface to another unit."""
    return surface.with_vertices(factor * surface.vertices)


def landmarks(count: int = USUAL) -> tuple[Integers, Integers]:
    """Vertices at the tips of the limbs of the creatures 0 and 1."""
    ends = unit_vectors(samples.LIMBS)
    of_source, of_target = ((samples.directions(count, seed) @ ends.T).argmax(axis=0) for seed in (0, 1))
    return of_source, of_target


def regions() -> list[tuple[Integers, Integers]]:
    """The vertices of each limb of the creatures 0 and 1."""
    of_source, of_target = (samples.limb_weights(samples.directions(USUAL, seed))[:, 1:] > 0.5 for seed in (0, 1))
    return [(np.flatnonzero(a), np.flatnonzero(b)) for a, b in zip(of_source.T, of_target.T, strict=True)]


# --- matches ------------------------------------------------------------------------------------------------


def _of_files(name: str, source: str, target: str, **options: Any) -> Case:
    """A match of two files of the sets."""

    def fields(data: Path) -> Fields:
        return of_match(zo.match(_read(data / source), _read(data / target), **options))

    return Case(name, fields, (source, target))


def _read(path: Path) -> Shape:
    if path.suffix == ".glb":
        return zo.read_asset(path).surface
    return zo.read_point_cloud(path) if path.stem.startswith("cloud") else zo.read_surface(path)


def _make(name: str, make: Callable[[], tuple[Shape, Shape]], options: Callable[[], Mapping[str, Any]] = dict) -> Case:
    """A match of two generated shapes, source and target."""
    return Case(name, lambda _: of_match(zo.match(*make(), **options())))


def _creatures() -> tuple[zo.Surface, zo.Surface]:
    return creature(seed=0), creature(seed=1, bend=0.6)


def _known_places(data: Path, exact: bool) -> Fields:
    """A match of two people with some known places as landmarks."""
    pair = load_pair(data / "faust_r", "tr_reg_003", "tr_reg_008")
    few = np.linspace(0, len(pair.target_vertex) - 1, 7).astype(int)
    given = pair.source_vertex[few], pair.target_vertex[few]
    return of_match(zo.match(pair.source, pair.target, initial="landmarks", landmarks=given, exact_landmarks=exact))


def _points_as_landmarks() -> Mapping[str, Any]:
    of_source, of_target = landmarks()
    source, target = _creatures()
    return {
        "initial": "landmarks",
        "landmarks": (source.vertices[of_source], target.vertices[of_target]),
        "exact_landmarks": True,
    }


def _given_functional_map() -> Mapping[str, Any]:
    source, target = (zo.eigenbasis(surface, 30) for surface in _creatures())
    return {"initial": "given", "initial_map": zo.functional_map_of(true_map(), source, target, 20, 20)}


def _given_surface_map() -> Mapping[str, Any]:
    return {"initial": "given", "initial_map": zo.SurfaceMap.from_vertices(true_map(), _creatures()[0])}


def _cloud(surface: zo.Surface, normals: bool) -> zo.PointCloud:
    points = surface.vertices
    return zo.PointCloud(points, vertex_normals(points, surface.triangles) if normals else None)


def _other_candidate(data: Path) -> Fields:
    source, target = (_read(data / "faust_r" / f"{name}.off") for name in ("tr_reg_012", "tr_reg_007"))
    return of_match(zo.match(source, target, **FAST).use(1))


def _other_candidate_of_part() -> Fields:
    return of_match(zo.match(*_arm_and_whole()).use(1))


def _arm_and_whole() -> tuple[zo.Surface, zo.Surface]:
    return creature(), keep_faces(creature(4000, 1), lambda points: points[:, 0] > 0.2)


def _by_proximity() -> Fields:
    found = zo.match_by_proximity(creature(asymmetry=0), shirt(21))
    return of_map(found.surface_map) | {"confidence": hash_of(found.confidence), "notes": list(found.notes)}


# Pairs of files of each set; the first pair of a set has the usual options.
WHOLES = (
    ("faust_r", "off", ("tr_reg_002 tr_reg_007", "tr_reg_031 tr_reg_045")),
    ("smal_r", "off", ("cow_alph4 lion6", "fox-05 hippo5", "dog2 cougar")),
    ("tosca_r", "off", ("cat0 cat4", "horse0 horse6", "michael0 michael10", "wolf0 wolf2")),
    ("shrec19_r", "off", ("01 07", "12 20")),
    ("tosca_nonisometric", "off", ("8_gorilla_01 8_man_01",)),
    ("faust_discretisation", "ply", ("iso_080 qes_081", "mc_081 dense_082")),
)
PARTS = ("cut_cat_00", "cut_wolf_03", "holes_horse_01", "holes_cat_04", "pfarm_07", "pfarm_10", "both_partial_03")
CHARACTERS = (
    ("modular_men/Farmer", "modular_men/Worker"),
    ("modular_women/Worker", "modular_men/Punk"),
    ("animals_pack/Cow", "animals_pack/Bull"),
    ("mech_pack/Leela", "cyberpunk_pack/Enemy_2Legs"),
    ("easy_enemies_pack/Wasp", "easy_enemies_pack/Wasp"),
)


def _wholes() -> list[Case]:
    return [
        *(
            _whole_files(folder, ending, pair, FAST if number else {})
            for folder, ending, pairs in WHOLES
            for number, pair in enumerate(pairs)
        ),
        _of_files("whole molar", *(f"specimens/shapes/molar_{number}.ply" for number in (4, 0)), **FAST),
        _make("whole creatures", _creatures),
        _make(
            "whole mirror image",
            lambda: (creature(), creature(seed=1).with_vertices(creature(seed=1).vertices * [-1, 1, 1])),
        ),
        _make("whole unlike", lambda: (creature(), round_shape(BOX))),
        _make("whole torus", lambda: (torus(), torus(40, 20))),
        _make("whole decimated", lambda: (creature(9000), creature(12000, 1, 0.5))),
    ]


def _whole_files(folder: str, ending: str, pair: str, options: dict[str, Any]) -> Case:
    source, target = (f"{folder}/{name}.{ending}" for name in pair.split())
    return _of_files(f"whole {folder} {pair}", source, target, **options)


def _parts() -> list[Case]:
    return [
        *(_part_files(name, FAST if name.startswith("both") else {}) for name in PARTS),
        _of_files(
            "part source cut_horse_01", "partial/cut_horse_01_target.off", "partial/cut_horse_01_source.off", **FAST
        ),
        _make("part limb lacks", lambda: (creature(), creature(seed=1, without=5))),
        _make("part half", _arm_and_whole),
        _make("part half off", _arm_and_whole, lambda: {"partial": "off"}),
        _make("part other unit", lambda: (creature(), scale(_arm_and_whole()[1], 2.54))),
        _make("part landmarks", _arm_and_whole, lambda: {"landmarks": _landmarks_of_arm(), "initial": "landmarks"}),
        _make("part exact", _arm_and_whole, lambda: {"landmarks": _landmarks_of_arm(), "exact_landmarks": True}),
        _make("coarse part", lambda: (creature(USUAL), keep_faces(creature(TINY, 1), lambda p: p[:, 0] > 0))),
        Case("part use 1", lambda _: _other_candidate_of_part()),
    ]


def _part_files(name: str, options: dict[str, Any]) -> Case:
    return _of_files(f"part {name}", f"partial/{name}_source.off", f"partial/{name}_target.off", **options)


def _shells() -> list[Case]:
    return [
        *(_character_files(source, target, FAST if "mech" in source else {}) for source, target in CHARACTERS),
        _make("shells clothed", lambda: (clothe(0, 0.0), clothe(1, 0.5))),
        _make("shells clothed and bare", lambda: (clothe(0, 0.0), creature(seed=1, bend=0.3, asymmetry=0))),
        _make("shells shirts", lambda: (shirt(1), shirt(2))),
    ]


def _character_files(source: str, target: str, options: dict[str, Any]) -> Case:
    name = f"shells {source.split('/')[1]} {target.split('/')[1]}"
    return _of_files(name, f"characters/game/{source}.glb", f"characters/game/{target}.glb", **options)


def _clouds() -> list[Case]:
    return [
        _of_files("cloud faust", "faust_discretisation/iso_080.ply", "faust_discretisation/cloud_081.ply", **FAST),
        _make("cloud with normals", lambda: (_cloud(creature(4000), True), creature(seed=1, bend=0.5))),
        _make("cloud without", lambda: (creature(), _cloud(creature(4000, 1, 0.5), False)), lambda: FAST),
        _make("cloud both", lambda: (_cloud(creature(4000), True), _cloud(creature(3000, 1), True)), lambda: FAST),
    ]


def _evidence() -> list[Case]:
    """Matches with landmarks, a given map, or coinciding surfaces."""
    known, near = ("faust_r/correspondence.npz",), {"initial": "proximity"}
    return [
        Case("landmarks faust", lambda data: _known_places(data, False), known),
        Case("landmarks faust exact", lambda data: _known_places(data, True), known),
        _make("landmarks auto", _creatures, lambda: {"landmarks": landmarks()}),
        _make("landmarks as points exact", _creatures, _points_as_landmarks),
        _make(
            "landmarks twice",
            _creatures,
            lambda: {"initial": "landmarks", "landmarks": tuple(np.append(side, side[:2]) for side in landmarks())},
        ),
        _make("given vertices", _creatures, lambda: {"initial": "given", "initial_map": true_map()}),
        _make("given surface map", _creatures, _given_surface_map),
        _make("given functional map", _creatures, _given_functional_map),
        _make("given as evidence", _creatures, lambda: {"initial_map": true_map()}),
        _make("proximity creatures", lambda: (creature(), creature(seed=1, bend=0.1)), lambda: near),
        _make("proximity clothed", lambda: (clothe(0, 0.0), clothe(1, 0.1)), lambda: near),
        Case("proximity alone", lambda _: _by_proximity()),
    ]


def _options() -> list[Case]:
    return [
        _make("options two axes", _creatures, lambda: {"common_axes": [(0, 0, 1), (1, 0, 0)]}),
        _make("options regions", _creatures, lambda: {"regions": regions()}),
        _make("options small map", _creatures, lambda: {"k_final": 30, "step": 5, "samples": 300}),
        _make("options large map", _creatures, lambda: {"k_final": 200, "samples": 1500, "proxy_vertices": 8000}),
        _make("options fast", lambda: (creature(5000), creature(5000, 1, 0.6)), lambda: FAST),
        _make("options no stand-in", lambda: (creature(3000), creature(3000, 1)), lambda: {"proxy_vertices": None}),
        _make("options seed", _creatures, lambda: {"seed": 3}),
        Case(
            "options object",
            lambda _: of_match(
                zo.match(*_creatures(), zo.MatchOptions(k_final=80), common_axes=(0, 0, 1), regions=regions())
            ),
        ),
        Case("use faust 1", _other_candidate, ("faust_r/tr_reg_012.off", "faust_r/tr_reg_007.off")),
    ]


def _sizes_and_symmetries() -> list[Case]:
    return [
        *(_creatures_of_size(count) for count in (12, 60, 150, 400)),
        _make("small and large", lambda: (creature(TINY), creature(4000, 1))),
        _make("signs eggs", lambda: (round_shape(egg), round_shape(egg, seed=1))),
        _make("signs egg itself", lambda: (egg_twice := round_shape(egg, SMALL), egg_twice)),
        _make("turns cube", lambda: (round_shape(CUBE), round_shape(CUBE, seed=1)), lambda: FAST),
        _make("turns icosahedron", lambda: (round_shape(ICOSAHEDRON), round_shape(ICOSAHEDRON, seed=1)), lambda: FAST),
        _make("turns gear", lambda: (round_shape(gear), round_shape(gear, seed=1))),
        _make("turns symmetric creature", lambda: (creature(asymmetry=0), creature(seed=1, asymmetry=0, bend=0.5))),
    ]


def _creatures_of_size(count: int) -> Case:
    return _make(f"small {count}", lambda: (creature(count), creature(count, 1)))


def _landmarks_of_arm() -> tuple[Floats, Floats]:
    """Landmarks on the left arm, the left leg and the middle of the creatures of `_arm_and_whole`."""
    places = [creature(seed=0, count=USUAL).vertices, _arm_and_whole()[1].vertices]
    wanted = np.array([[3.0, 0.3, 1.0], [1.4, 0, -3.0], [1.0, 0, 0.2], [0.3, -0.7, 0]])
    of_source, of_target = (
        points[np.linalg.norm(points[:, None] - wanted, axis=-1).argmin(axis=0)] for points in places
    )
    return of_source, of_target


# --- symmetries ---------------------------------------------------------------------------------------------


SYMMETRIC = ("faust_r/tr_reg_005.off", "smal_r/dog2.off", "self_symmetry/alien.off", "tosca_r/cat1.off")


def _symmetric(name: str, make: Callable[[], Shape], **options: Any) -> Case:
    return Case(f"symmetry {name}", lambda _: of_symmetries(zo.detect_symmetry(make(), **options)))


def _symmetry_of_file(path: str) -> Case:
    return Case(
        f"symmetry {Path(path).stem}",
        lambda data: of_symmetries(zo.detect_symmetry(_read(data / path), most=3, k_final=60, samples=500)),
        (path,),
    )


def _symmetries() -> list[Case]:
    game = "characters/game/modular_men/Farmer.glb"
    return [
        *(_symmetry_of_file(path) for path in SYMMETRIC),
        _symmetric("creature", lambda: creature(asymmetry=0, bend=0.5), left=(1, 0, 0), seed=1),
        _symmetric("lopsided creature", lambda: creature(seed=2)),
        _symmetric("cube", lambda: round_shape(CUBE, SMALL), most=4, k_final=60, samples=500),
        _symmetric("icosahedron", lambda: round_shape(ICOSAHEDRON, SMALL), most=2, k_final=60, samples=500),
        _symmetric("gear", lambda: round_shape(gear), most=4, left=(0, 1, 0), k_final=60),
        _symmetric("clothed", lambda: clothe(0, 0.4), most=2),
        _symmetric("cloud", lambda: _cloud(creature(3000, asymmetry=0), True), most=2, k_final=60),
        Case("symmetry Farmer", lambda data: of_symmetries(zo.detect_symmetry(_read(data / game), most=2)), (game,)),
    ]


# --- collections --------------------------------------------------------------------------------------------


def _collect(count: int = 3, **options: Any) -> Fields:
    """The maps of a collection of creatures in several poses."""
    shapes = {
        f"pose{number}": creature(SMALL, number, bend, asymmetry=0.15)
        for number, bend in enumerate((0.0, 0.4, 0.8, 0.2)[:count])
    }
    return of_collection(zo.match_collection(shapes, options=zo.MatchOptions(**FAST), **options))


def _by_workers() -> Fields:
    from zoomout_core.collection.engine import local_engine

    with local_engine(2, 0) as engine:
        return _collect(template="pose0", engine=engine)


def _collections() -> list[Case]:
    return [
        Case("collection all", lambda _: _collect(pairs="all")),
        Case("collection template", lambda _: _collect(template="pose0")),
        Case("collection neighbours", lambda _: _collect(4, neighbours=1)),
        Case("collection pairs", lambda _: _collect(pairs=[("pose0", "pose1"), ("pose2", "pose1")], agree=False)),
        Case("collection workers", lambda _: _by_workers()),
    ]


# --- what is done with a map --------------------------------------------------------------------------------


def attributes(surface: zo.Surface) -> list[zo.Attribute]:
    """One attribute of each kind on each of its domains, given by formulas."""
    domain, kind = zo.Domain, zo.Kind
    corners = surface.vertices[surface.corner_vertex]
    middles = np.add.reduceat(corners, surface.face_start[:-1]) / np.diff(surface.face_start)[:, None]
    places = {
        domain.POINT: surface.vertices,
        domain.EDGE: surface.vertices[surface.edges].mean(axis=1),
        domain.FACE: middles,
        domain.CORNER: corners,
    }
    values: dict[zo.Kind, Callable[[Any], Any]] = {
        kind.SCALAR: lambda p: np.sin(2 * p[:, 0]) + p[:, 2],
        kind.VECTOR: lambda p: np.cos(p[:, :2]),
        kind.DIRECTION: lambda p: unit_vectors(p + np.array([0, 0, 0.1])),
        kind.NORMAL: lambda p: unit_vectors(p + np.array([0, 0.1, 0])),
        kind.COLOR: lambda p: np.clip(0.5 + 0.2 * np.column_stack([p, p[:, 0]]), 0, 1),
        kind.UV: lambda p: 0.5 + 0.1 * p[:, [0, 2]],
        kind.QUATERNION: lambda p: unit_vectors(np.column_stack([2 + p[:, 0] ** 2, p])),
        kind.MATRIX: lambda p: (np.eye(4) + 0.1 * np.sin(p).sum(axis=1)[:, None, None]).reshape(-1, 16),
        kind.LABEL: lambda p: np.floor(2 * p[:, 2]).astype(int),
        kind.BOOLEAN: lambda p: p[:, 0] > 0.3,
        kind.MARK: lambda p: (np.abs(p[:, 2] - 0.2) < 0.06).astype(float),
        kind.WEIGHT: lambda p: csr_array(np.maximum(0, np.column_stack([p[:, 0], -p[:, 0], p[:, 2]]))),
        kind.OFFSET: lambda p: np.stack([0.1 * np.sin(3 * p), 0.05 * np.cos(p)], axis=1),
    }
    everywhere = tuple(domain)
    on_faces = domain.POINT, domain.FACE, domain.CORNER
    domains = dict.fromkeys(kind, on_faces) | dict.fromkeys(
        (kind.SCALAR, kind.VECTOR, kind.COLOR, kind.LABEL, kind.BOOLEAN), everywhere
    )
    domains |= {
        kind.UV: (domain.CORNER,),
        kind.MARK: (domain.POINT, domain.EDGE),
        kind.WEIGHT: (domain.POINT,),
        kind.OFFSET: (domain.POINT,),
    }
    return [
        zo.Attribute(f"{each.name.lower()} {on.name.lower()}", on, each, make(places[on]))
        for each, make in values.items()
        for on in domains[each]
    ]


def _transfer(source: zo.Surface, target: zo.Surface, result: Any, fill_below: float | None = None) -> Fields:
    fields: Fields = {}
    for attribute in attributes(source):
        fields |= _with_prefix(attribute.name, of_attribute(zo.transfer(attribute, result, source, target, fill_below)))
    return fields | {"conform": hash_of(zo.conform(result, source, target))}


def _by_true_map() -> Fields:
    source, target = _creatures()
    return _transfer(source, target, zo.SurfaceMap.from_vertices(true_map(), source))


def _by_match(target: zo.Surface) -> Fields:
    source = creature()
    return _transfer(source, target, zo.match(source, target, **FAST), 0.3)


def _of_asset() -> Fields:
    source, target = samples.character(2000), zo.Asset(samples.scan(1500).surface)
    moved = zo.transfer_asset(source, target, zo.match(source.surface, target.surface, **FAST))
    fields: Fields = {"received": list(moved.received), "notes": list(moved.notes)}
    for attribute in moved.asset.attributes:
        fields |= _with_prefix(attribute.name, of_attribute(attribute))
    skin = moved.asset.skin
    return fields | ({} if skin is None else {"skin": hash_of(skin.weights, skin.inverse_bind, skin.rest)})


def _wrap(**options: Any) -> Fields:
    source, target = creature(USUAL), creature(SMALL, 1, 0.4)
    if options.pop("known", False):
        (of_source, _), (_, of_target) = landmarks(USUAL), landmarks(SMALL)
        options["landmarks"] = of_source, of_target
    if options.pop("upper", False):
        options["mask"] = (target.vertices[:, 2] > 0).astype(float)
    wrapped = zo.wrap(zo.match(source, target, **FAST), source, target, **options)
    return {
        "vertices": hash_of(wrapped.vertices),
        "turned_over": int(wrapped.turned_over),
        "notes": list(wrapped.notes),
    }


def _dress(**options: Any) -> Fields:
    source, target = creature(asymmetry=0), creature(seed=1, bend=0.4, asymmetry=0.2)
    tips = landmarks()[0]
    strands = np.concatenate([source.vertices[tips], 1.1 * source.vertices[tips]])
    hair = zo.Lines(strands, np.column_stack([np.arange(len(tips)), np.arange(len(tips)) + len(tips)]))
    dressed = zo.dress(zo.match(source, target, **FAST), source, target, [shirt(21), hair], **options)
    vertices = {f"vertices {number}": hash_of(each) for number, each in enumerate(dressed.vertices)}
    turns = {f"turns {number}": hash_of(each) for number, each in enumerate(dressed.turns)}
    return vertices | turns | {"notes": list(dressed.notes)}


def _bases(count: int = 3, k: int = 130) -> list[zo.SpectralBasis]:
    return [zo.eigenbasis(creature(1500, seed, 0.3 * seed), k) for seed in range(count)]


def _of_zoomout() -> Fields:
    source, target = _bases(2)
    vertex = true_map(count=1500)
    alone = zo.zoomout(source, target, vertex)
    from_functional = zo.zoomout(source, target, zo.functional_map_of(vertex, source, target, 20, 20), 100, step=3)
    there, back = zo.zoomout_both_ways(source, target, vertex)
    refined = {"vertices": alone, "functional": from_functional, "there": there, "back": back}
    fields = {
        f"{name} {field}": hash_of(getattr(each, field))
        for name, each in refined.items()
        for field in ("functional_map", "vertex")
    }
    precise = zo.precise_map_of(alone.functional_map, source, target, creature(1500))
    return fields | _with_prefix("precise", of_map(precise))


def _of_consistent_zoomout() -> Fields:
    maps = {(a, b): true_map(a, b, 1500) for a, b in ((0, 1), (1, 2), (2, 0))}
    found = zo.consistent_zoomout(_bases(), maps, k_final=80)
    return {"latent": hash_of(*found.latent), "vertex": hash_of(found.vertex_map(0, 2))}


def _of_fit() -> Fields:
    source, target = _bases(2)
    here, there = (zo.wave_kernel_signature(basis, 40) for basis in (source, target))
    return {"signatures": hash_of(here, there), "fit": hash_of(zo.fit_functional_map(source, target, here, there))}


def _of_shape() -> Fields:
    surface = creature(1500)
    potential = np.clip(surface.vertices[:, 2], 0, 1)
    return {
        "shot": hash_of(zo.shot(surface)),
        **_with_prefix("hamiltonian", of_basis(zo.hamiltonian_basis(surface, potential, 60))),
    }


def _uses() -> list[Case]:
    return [
        Case("transfer true map", lambda _: _by_true_map()),
        Case("transfer match", lambda _: _by_match(creature(SMALL, 1, 0.5))),
        Case("transfer match of part", lambda _: _by_match(creature(2000, 1, without=5))),
        Case("transfer asset", lambda _: _of_asset()),
        Case("wrap", lambda _: _wrap()),
        Case("wrap landmarks and mask", lambda _: _wrap(known=True, upper=True, smoothness=0.8, detail=0.5)),
        Case("wrap subdivided", lambda _: _wrap(subdivided=True)),
        Case("dress", lambda _: _dress()),
        Case("dress stiff", lambda _: _dress(stiffness=0.9, gap=0.02)),
        Case("basis mesh", lambda _: of_basis(zo.eigenbasis(creature()))),
        Case("basis cloud", lambda _: of_basis(zo.eigenbasis(_cloud(creature(1500), True), 80, seed=2))),
        Case("basis shells", lambda _: of_basis(zo.eigenbasis(clothe(0, 0.0), 60))),
        Case("basis others", lambda _: _of_shape()),
        Case("zoomout", lambda _: _of_zoomout()),
        Case("zoomout consistent", lambda _: _of_consistent_zoomout()),
        Case("zoomout fit", lambda _: _of_fit()),
    ]


# --- what is refused ----------------------------------------------------------------------------------------


def _refuse(name: str, work: Callable[[], Any]) -> Case:
    def fields(_: Path) -> Fields:
        work()
        return {"refused": False}

    return Case(f"error {name}", fields)


def _errors() -> list[Case]:
    def two() -> tuple[zo.Surface, zo.Surface]:
        return creature(TINY), creature(TINY, 1)

    flat = zo.Surface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    return [
        _refuse("one triangle", lambda: zo.match(flat, creature(TINY))),
        _refuse("no landmarks", lambda: zo.match(*two(), initial="landmarks")),
        _refuse("landmark out of range", lambda: zo.match(*two(), initial="landmarks", landmarks=([9999], [0]))),
        _refuse("map of other surfaces", lambda: zo.match(*two(), initial="given", initial_map=np.zeros(7, int))),
        _refuse("far apart", lambda: zo.match_by_proximity(two()[0], scale(two()[1], 1e4))),
        _refuse("no axis", lambda: zo.match(*two(), common_axes=(0, 0, 0))),
        _refuse("no region", lambda: zo.match(*two(), regions=[([0],)])),  # type: ignore[list-item]
        _refuse("no such candidate", lambda: zo.match(*two()).use(99)),
        _refuse("no symmetry", lambda: zo.detect_symmetry(creature(TINY), most=0)),
        _refuse("no file", lambda: zo.match("missing.ply", creature(TINY))),
        _refuse("no template", lambda: _collect(template="nobody")),
        _refuse("nothing to wrap", lambda: zo.wrap(zo.match(*two()), *two(), mask=np.zeros(TINY))),
        _refuse(
            "transfer by another map",
            lambda: zo.transfer(attributes(two()[0])[0], zo.SurfaceMap.from_vertices([0, 1], two()[0]), *two()),
        ),
    ]


CASES: tuple[Case, ...] = (
    *_wholes(),
    *_parts(),
    *_shells(),
    *_clouds(),
    *_evidence(),
    *_options(),
    *_sizes_and_symmetries(),
    *_symmetries(),
    *_collections(),
    *_uses(),
    *_errors(),
)
