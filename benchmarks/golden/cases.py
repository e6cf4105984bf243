# SPDX-License-Identifier: GPL-3.0-or-later
"""The cases of `golden`: small pairs and calls of every sort, computed by public functions alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import zoomout_core as zo
from benchmarks.golden.case import FAST, Case, Fields, of_collection, of_symmetries
from benchmarks.golden.matches import match_cases
from benchmarks.golden.shapes import (
    CUBE,
    ICOSAHEDRON,
    SMALL,
    TINY,
    Shape,
    clothe,
    cloud,
    creature,
    gear,
    read,
    round_shape,
    scale,
)
from benchmarks.golden.uses import attributes, use_cases

SYMMETRIC = ("faust_r/tr_reg_005.off", "smal_r/dog2.off", "self_symmetry/alien.off", "tosca_r/cat1.off")


def _symmetric(name: str, make: Callable[[], Shape], **options: Any) -> Case:
    return Case(f"symmetry {name}", lambda _: of_symmetries(zo.detect_symmetry(make(), **options)))


def _symmetry_of_file(path: str) -> Case:
    return Case(
        f"symmetry {Path(path).stem}",
        lambda data: of_symmetries(zo.detect_symmetry(read(data / path), max_count=3, k_final=60, samples=500)),
        (path,),
    )


def _symmetries() -> list[Case]:
    game = "characters/game/modular_men/Farmer.glb"
    return [
        *(_symmetry_of_file(path) for path in SYMMETRIC),
        _symmetric("creature", lambda: creature(asymmetry=0, bend=0.5), left=(1, 0, 0), seed=1),
        _symmetric("lopsided creature", lambda: creature(seed=2)),
        _symmetric("cube", lambda: round_shape(CUBE, SMALL), max_count=4, k_final=60, samples=500),
        _symmetric("icosahedron", lambda: round_shape(ICOSAHEDRON, SMALL), max_count=2, k_final=60, samples=500),
        _symmetric("gear", lambda: round_shape(gear), max_count=4, left=(0, 1, 0), k_final=60),
        _symmetric("clothed", lambda: clothe(0, 0.4), max_count=2),
        _symmetric("cloud", lambda: cloud(creature(3000, asymmetry=0), True), max_count=2, k_final=60),
        Case(
            "symmetry Farmer", lambda data: of_symmetries(zo.detect_symmetry(read(data / game), max_count=2)), (game,)
        ),
    ]


def _collect(count: int = 3, **options: Any) -> Fields:
    """The maps of a collection of creatures in several poses."""
    shapes = {
        f"pose{number}": creature(SMALL, number, bend, asymmetry=0.15)
        for number, bend in enumerate((0.0, 0.4, 0.8, 0.2)[:count])
    }
    return of_collection(zo.match_collection(shapes, options=zo.MatchOptions(**FAST), **options))


def _by_workers() -> Fields:
    from zoomout_core.collection.dask_engine import local_engine

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
        _refuse("no symmetry", lambda: zo.detect_symmetry(creature(TINY), max_count=0)),
        _refuse("no file", lambda: zo.match("missing.ply", creature(TINY))),
        _refuse("no template", lambda: _collect(template="nobody")),
        _refuse("nothing to wrap", lambda: zo.wrap(zo.match(*two()), *two(), mask=np.zeros(TINY))),
        _refuse(
            "transfer by another map",
            lambda: zo.transfer(attributes(two()[0])[0], zo.SurfaceMap.from_vertices([0, 1], two()[0]), *two()),
        ),
    ]


CASES: tuple[Case, ...] = (*match_cases(), *_symmetries(), *_collections(), *use_cases(), *_errors())
