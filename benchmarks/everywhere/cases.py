# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs whose maps are right globally but may be wrong locally, with the truth at each vertex.

`skin`: a character of many parts, and one skin around it in a pose; the truth is the part visible from outside.
`legs`: a body whose legs touch, and a body of other proportions; the truth is the side.
`other`: a game character as one skin, and a MakeHuman body; the truth is the side, and no edge may tear.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np
from scipy.spatial import cKDTree

import zoomout_core as zo
from benchmarks.characters.cases import FEW_PARTS, is_broken, spread, surface_of
from benchmarks.characters.game import Body, Character, one_skin, read_character
from benchmarks.characters.skeleton import limbs_of
from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.triangles import unique_edges

SKIN, LEGS, OTHER = "skin", "legs", "other"
# Widths of a voxel of a one-skin target over its longest extent, and the part of each extent that one piece must have:
# characters whose pieces do not touch cannot be joined.
VOXELS = 1 / 190, 1 / 140, 1 / 100
WHOLE = 0.9
# A vertex has a side where the bones of that side have this share of its weights.
SIDED = 0.9
# Builds and meshes whose legs are put together, in turn, and the bodies that they are matched to.
TOUCHING = ("woman", "heavy_man", "child", "broad_man")
ONTO = (("slim_woman", "base"), ("muscular_man", "female_generic"), ("curvy_woman", "male1591"))
# Degrees by which each leg is turned inwards, smallest first; the first at which the feet touch is taken.
TURNS = np.arange(4.0, 16.0, 0.5)
# Bodies of other characters: the pack and file, and the builds that they are matched to.
CHARACTERS = (
    ("modular_men", "Beach"),
    ("modular_men", "Suit"),
    ("modular_women", "Suit"),
    ("modular_women", "Punk"),
    ("single_knight_pack", "KnightCharacter"),
    ("ultimate_space_pack", "Astronaut_FernandoTheFlamingo-transformed"),
)
BUILDS = ("woman", "heavy_man", "child")
LIMBS = ("upperleg01", "upperarm01")
Bodies: TypeAlias = Any  # the class of `clothes.py`, which comes with the data


@dataclass(frozen=True, eq=False)
class Case:
    """A pair of shapes with true parts and sides.

    Attributes:
        kind: "skin", "legs" or "other".
        name: names both shapes.
        source: the surface with the images.
        target: the surface to be mapped.
        source_part: (n_s,) the number of each source vertex's loose part.
        target_part: (n_t,) the part that each target vertex should receive from; -1 near a border or if unknown.
        source_side: (n_s,) 1 on the left, -1 on the right, 0 in the middle or if unknown.
        target_side: (n_t,) the same for the target.
    """

    kind: str
    name: str
    source: zo.Surface
    target: zo.Surface
    source_part: Integers
    target_part: Integers
    source_side: Integers
    target_side: Integers


Maker: TypeAlias = Callable[[], Case | None]


def cases(data: Path, most: int | None) -> Iterator[Case]:
    """All cases whose files a data folder has, or about `most` of each kind, evenly spread."""
    game = data / "characters" / "game"
    skins: list[Maker] = [
        partial(_skin, path, posed) for path in sorted(game.glob("*/*.glb")) for posed in (False, True)
    ]
    legs: list[Maker] = []
    others: list[Maker] = []
    if (data / "clothes" / "bodies.npz").exists():
        clothes = _module(data / "clothes" / "clothes.py")
        legs = [partial(_legs, clothes, build, *onto) for build, onto in product(TOUCHING, ONTO)]
        files = [game / pack / f"{name}.glb" for pack, name in CHARACTERS]
        pairs = product([file for file in files if file.exists()], BUILDS)
        others = [partial(_other, clothes, path, build) for path, build in pairs]
    kinds: list[list[Maker]] = [skins, legs, others]
    for makers in kinds:
        for make in spread(makers, most):
            case = make()
            if case is not None:
                yield case


def _skin(path: Path, posed: bool) -> Case | None:
    character = read_character(path)
    source = surface_of(character.rest)
    if is_broken(character) or source.components.max() < FEW_PARTS:
        return None
    body = character.posed if posed else character.rest
    made = _whole_skin(body)
    if made is None:
        return None
    skin, voxel = made
    name = f"{character.pack} {character.name}, {character.pose if posed else 'rest'}"
    return Case(
        SKIN,
        name,
        source,
        surface_of(skin),
        source.components,
        _outer_part(skin, body, source.components, voxel),
        _side_of_body(character, character.rest),
        _side_of_body(character, skin),
    )


def _whole_skin(body: Body) -> tuple[Body, float] | None:
    """One skin around a character, of the finest voxels that join all parts, and the voxels' width; None if none do."""
    for voxel in VOXELS:
        skin = one_skin(body, voxel)
        if (np.ptp(skin.vertices, axis=0) > WHOLE * np.ptp(body.vertices, axis=0)).all():
            return skin, voxel
    return None


def _outer_part(skin: Body, body: Body, part: Integers, voxel: float) -> Integers:
    """(n,) the part of a body outermost at each vertex of a skin; -1 within a voxel of a border between parts."""
    triangle, _ = closest_points(skin.vertices, body.vertices, body.triangles)
    shown = part[body.triangles[triangle, 0]]
    edges, _ = unique_edges(skin.triangles)
    border = np.unique(edges[shown[edges[:, 0]] != shown[edges[:, 1]]])
    if len(border):
        width = voxel * np.ptp(body.vertices, axis=0).max()
        shown = np.where(cKDTree(skin.vertices[border]).query(skin.vertices)[0] <= width, -1, shown)
    return shown


def _legs(clothes: ModuleType, build: str, onto: str, topology: str) -> Case:
    source = clothes.Bodies()
    vertices = _feet_together(source, build)
    return _of_bodies(
        LEGS,
        f"{build}, feet together, to {onto} ({topology})",
        zo.Surface(vertices, source.polygons),
        clothes.Bodies(topology=topology),
        onto,
        _side_of_limbs(source),
    )


def _feet_together(bodies: Bodies, build: str) -> Floats:
    """(n, 3) a body with both legs turned inwards until the feet touch."""
    vertices, heads, weights = bodies.vertices(build), bodies.heads(build), bodies.weights
    of_leg = {side: _below(bodies, f"upperleg01.{side}") for side in "LR"}
    for degrees in TURNS:
        moved = vertices.copy()
        for side, members in of_leg.items():
            sign = 1.0 if heads[bodies.bone_names.index(f"upperleg01.{side}"), 0] > 0 else -1.0
            angle = -sign * np.radians(degrees)
            turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
            joint = heads[bodies.bone_names.index(f"upperleg01.{side}")]
            share = weights[:, members].sum(axis=1)[:, None]
            moved += share * ((vertices - joint) @ turn.T + joint - vertices)
        low = moved[:, 1] < np.quantile(moved[:, 1], 0.05)
        left, right = (low & (weights[:, of_leg[side]].sum(axis=1) > SIDED) for side in "LR")
        gap = np.asarray(cKDTree(moved[left]).query(moved[right])[0]).min()
        if gap < 0.3:  # centimetres
            break
    return np.asarray(moved)


def _below(bodies: Bodies, bone: str) -> Integers:
    """The indices of a bone and of all its descendants."""
    parent = dict(zip(bodies.bone_names, bodies.bone_parents, strict=True))

    def hangs(name: str) -> bool:
        return name == bone or (name in parent and hangs(parent[name]))

    return np.flatnonzero([hangs(name) for name in bodies.bone_names])


def _other(clothes: ModuleType, path: Path, build: str) -> Case | None:
    character = read_character(path)
    if is_broken(character):
        return None
    made = _whole_skin(character.rest)
    if made is None:
        return None
    skin, _ = made
    name = f"{character.pack} {character.name} as one skin to {build}"
    return _of_bodies(OTHER, name, surface_of(skin), clothes.Bodies(), build, _side_of_body(character, skin))


def _of_bodies(kind: str, name: str, source: zo.Surface, bodies: Bodies, build: str, source_side: Integers) -> Case:
    """A case whose target is a MakeHuman body."""
    target = zo.Surface(bodies.vertices(build), bodies.polygons)
    return Case(
        kind,
        name,
        source,
        target,
        source.components,
        np.full(len(target.vertices), -1),
        source_side,
        _side_of_limbs(bodies),
    )


def _side_of_body(character: Character, body: Body) -> Integers:
    return _side(body.weights, limbs_of(character.skeleton).side)


def _side_of_limbs(bodies: Bodies) -> Integers:
    side = np.zeros(len(bodies.bone_names), dtype=np.int64)
    for bone, (name, sign) in product(LIMBS, (("L", 1), ("R", -1))):
        side[_below(bodies, f"{bone}.{name}")] = sign
    return _side(bodies.weights, side)


def _side(weights: Floats, side: Integers) -> Integers:
    """(n,) the side of limb vertices, by the weights (n, b) of bones with a side (b,)."""
    return (weights[:, side > 0].sum(axis=1) > SIDED).astype(np.int64) - (weights[:, side < 0].sum(axis=1) > SIDED)


def _module(path: Path) -> ModuleType:
    """Import the reader that is shipped with a set."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
