# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases of `golden` that match two shapes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import zoomout_core as zo
from benchmarks.datasets import load_pair
from benchmarks.golden.case import FAST, Case, Fields, hash_of, of_map, of_match
from benchmarks.golden.shapes import (
    BOX,
    CUBE,
    ICOSAHEDRON,
    SMALL,
    TINY,
    USUAL,
    Shape,
    arm_and_whole,
    clothe,
    cloud,
    creature,
    creatures,
    egg,
    gear,
    keep_faces,
    landmarks,
    read,
    regions,
    round_shape,
    scale,
    shirt,
    torus,
    true_map,
)
from zoomout_core.arrays import Floats


def _of_files(name: str, source: str, target: str, **options: Any) -> Case:
    """A match of two files of the sets."""

    def fields(data: Path) -> Fields:
        return of_match(zo.match(read(data / source), read(data / target), **options))

    return Case(name, fields, (source, target))


def _make(name: str, make: Callable[[], tuple[Shape, Shape]], options: Callable[[], Mapping[str, Any]] = dict) -> Case:
    """A match of two generated shapes, source and target."""
    return Case(name, lambda _: of_match(zo.match(*make(), **options())))


def _known_places(data: Path, exact: bool) -> Fields:
    """A match of two people with some known places as landmarks."""
    pair = load_pair(data / "faust_r", "tr_reg_003", "tr_reg_008")
    few = np.linspace(0, len(pair.target_vertex) - 1, 7).astype(int)
    given = pair.source_vertex[few], pair.target_vertex[few]
    return of_match(zo.match(pair.source, pair.target, initial="landmarks", landmarks=given, exact_landmarks=exact))


def _points_as_landmarks() -> Mapping[str, Any]:
    of_source, of_target = landmarks()
    source, target = creatures()
    return {
        "initial": "landmarks",
        "landmarks": (source.vertices[of_source], target.vertices[of_target]),
        "exact_landmarks": True,
    }


def _given_functional_map() -> Mapping[str, Any]:
    source, target = (zo.eigenbasis(surface, 30) for surface in creatures())
    return {"initial": "given", "initial_map": zo.functional_map_of(true_map(), source, target, 20, 20)}


def _given_surface_map() -> Mapping[str, Any]:
    return {"initial": "given", "initial_map": zo.SurfaceMap.from_vertices(true_map(), creatures()[0])}


def _other_candidate(data: Path) -> Fields:
    source, target = (read(data / "faust_r" / f"{name}.off") for name in ("tr_reg_012", "tr_reg_007"))
    return of_match(zo.match(source, target, **FAST).use(1))


def _other_candidate_of_part() -> Fields:
    return of_match(zo.match(*arm_and_whole()).use(1))


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
        _make("whole creatures", creatures),
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
        _make("part half", arm_and_whole),
        _make("part half off", arm_and_whole, lambda: {"partial": "off"}),
        _make("part other unit", lambda: (creature(), scale(arm_and_whole()[1], 2.54))),
        _make("part landmarks", arm_and_whole, lambda: {"landmarks": _landmarks_of_arm(), "initial": "landmarks"}),
        _make("part exact", arm_and_whole, lambda: {"landmarks": _landmarks_of_arm(), "exact_landmarks": True}),
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
        _make("cloud with normals", lambda: (cloud(creature(4000), True), creature(seed=1, bend=0.5))),
        _make("cloud without", lambda: (creature(), cloud(creature(4000, 1, 0.5), False)), lambda: FAST),
        _make("cloud both", lambda: (cloud(creature(4000), True), cloud(creature(3000, 1), True)), lambda: FAST),
    ]


def _evidence() -> list[Case]:
    """Matches with landmarks, a given map, or coinciding surfaces."""
    known, near = ("faust_r/correspondence.npz",), {"initial": "proximity"}
    return [
        Case("landmarks faust", lambda data: _known_places(data, False), known),
        Case("landmarks faust exact", lambda data: _known_places(data, True), known),
        _make("landmarks auto", creatures, lambda: {"landmarks": landmarks()}),
        _make("landmarks as points exact", creatures, _points_as_landmarks),
        _make(
            "landmarks twice",
            creatures,
            lambda: {"initial": "landmarks", "landmarks": tuple(np.append(side, side[:2]) for side in landmarks())},
        ),
        _make("given vertices", creatures, lambda: {"initial": "given", "initial_map": true_map()}),
        _make("given surface map", creatures, _given_surface_map),
        _make("given functional map", creatures, _given_functional_map),
        _make("given as evidence", creatures, lambda: {"initial_map": true_map()}),
        _make("proximity creatures", lambda: (creature(), creature(seed=1, bend=0.1)), lambda: near),
        _make("proximity clothed", lambda: (clothe(0, 0.0), clothe(1, 0.1)), lambda: near),
        Case("proximity alone", lambda _: _by_proximity()),
    ]


def _options() -> list[Case]:
    return [
        _make("options two axes", creatures, lambda: {"common_axes": [(0, 0, 1), (1, 0, 0)]}),
        _make("options regions", creatures, lambda: {"regions": regions()}),
        _make("options small map", creatures, lambda: {"k_final": 30, "step": 5, "samples": 300}),
        _make("options large map", creatures, lambda: {"k_final": 200, "samples": 1500, "proxy_vertices": 8000}),
        _make("options fast", lambda: (creature(5000), creature(5000, 1, 0.6)), lambda: FAST),
        _make("options no stand-in", lambda: (creature(3000), creature(3000, 1)), lambda: {"proxy_vertices": None}),
        _make("options seed", creatures, lambda: {"seed": 3}),
        Case(
            "options object",
            lambda _: of_match(
                zo.match(*creatures(), zo.MatchOptions(k_final=80), common_axes=(0, 0, 1), regions=regions())
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
    """Landmarks on the left arm, the left leg and the middle of the creatures of `arm_and_whole`."""
    places = [creature(seed=0, count=USUAL).vertices, arm_and_whole()[1].vertices]
    wanted = np.array([[3.0, 0.3, 1.0], [1.4, 0, -3.0], [1.0, 0, 0.2], [0.3, -0.7, 0]])
    of_source, of_target = (
        points[np.linalg.norm(points[:, None] - wanted, axis=-1).argmin(axis=0)] for points in places
    )
    return of_source, of_target


def match_cases() -> list[Case]:
    """All cases of matches."""
    return [
        *_wholes(),
        *_parts(),
        *_shells(),
        *_clouds(),
        *_evidence(),
        *_options(),
        *_sizes_and_symmetries(),
    ]
