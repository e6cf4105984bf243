# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs whose maps are right globally but may be wrong locally, with the truth at each vertex.

`skin`: a character of many parts, and one skin around it in a pose; the truth is the part visible from outside.
`legs`: a body whose legs touch, and a body of other proportions; the truth is the limb.
`touch`: bodies whose arms, hands, fingers or lips touch; the truth is the limb, the finger or the lip.
`other`: a game character as one skin, and a MakeHuman body; the truth is the limb, and no edge may tear.
"""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

import zoomout_core as zo
from benchmarks.characters.cases import FEW_PARTS, is_broken, spread, surface_of
from benchmarks.characters.game import Body, Character, one_skin, read_character
from benchmarks.characters.skeleton import limbs_of
from benchmarks.everywhere.touching import POSES, Bodies, arms_and_legs, feet_together, number_limbs
from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.triangles import unique_edges

SKIN, LEGS, TOUCH, OTHER = "skin", "legs", "touch", "other"
# Widths of a voxel of a one-skin target over its longest extent, and the part of each extent that one piece must have:
# characters whose pieces do not touch cannot be joined.
VOXELS = 1 / 190, 1 / 140, 1 / 100
WHOLE = 0.9
# Builds that are posed, in turn, and the bodies that they are matched with.
TOUCHING = ("woman", "heavy_man", "child", "broad_man")
ONTO = (("slim_woman", "base"), ("muscular_man", "female_generic"), ("curvy_woman", "male1591"))
# Names of the first bones of legs.
LEG = re.compile("leg|thigh|foot|hip", re.IGNORECASE)
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


class Rig(NamedTuple):
    """The bones that move a source.

    Attributes:
        rest: (n_s, 3) the source's vertices at rest.
        weights: (n_s, b) skin weights.
        heads: (b, 3) the place that each bone turns about, at rest.
        parents: (b,) the number of each bone's parent, -1 for none.
    """

    rest: Floats
    weights: csr_array
    heads: Floats
    parents: Integers


@dataclass(frozen=True, eq=False)
class Case:
    """A pair of shapes with true parts and limbs.

    Attributes:
        kind: "skin", "legs", "touch" or "other".
        name: names both shapes.
        source: the surface with the images.
        target: the surface to be mapped.
        source_part: (n_s,) the number of each source vertex's loose part.
        target_part: (n_t,) the part that each target vertex should receive from; -1 near a border or if unknown.
        source_limb: (n_s,) the number of the limb that each source vertex belongs to, 0 for none or if unknown.
        target_limb: (n_t,) the same for the target.
        rig: the source's rig, if the target is at rest.
    """

    kind: str
    name: str
    source: zo.Surface
    target: zo.Surface
    source_part: Integers
    target_part: Integers
    source_limb: Integers
    target_limb: Integers
    rig: Rig | None = None


Maker: TypeAlias = Callable[[], Case | None]


def cases(data: Path, most: int | None) -> Iterator[Case]:
    """All cases whose files a data folder has, or about `most` of each kind, evenly spread."""
    game = data / "characters" / "game"
    skins: list[Maker] = [
        partial(_skin, path, posed) for path in sorted(game.glob("*/*.glb")) for posed in (False, True)
    ]
    legs: list[Maker] = []
    touches: list[Maker] = []
    others: list[Maker] = []
    if (data / "clothes" / "bodies.npz").exists():
        clothes = _module(data / "clothes" / "clothes.py")
        legs = [partial(_legs, clothes, build, *onto) for build, onto in product(TOUCHING, ONTO)]
        touches = [
            partial(_touching, clothes, pose, build, *ONTO[number % len(ONTO)], is_source=number % 2 == 0)
            for number, (pose, build) in enumerate(product(POSES, TOUCHING))
        ]
        files = [game / pack / f"{name}.glb" for pack, name in CHARACTERS]
        pairs = product([file for file in files if file.exists()], BUILDS)
        others = [partial(_other, clothes, path, build) for path, build in pairs]
    kinds: list[list[Maker]] = [skins, legs, touches, others]
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
        _limbs_of_body(character, character.rest),
        _limbs_of_body(character, skin),
        None if posed else _rig_of_body(character, character.rest),
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
    posed, other = clothes.Bodies(), clothes.Bodies(topology=topology)
    return _of_bodies(
        LEGS,
        f"{build}, feet together, to {onto} ({topology})",
        zo.Surface(feet_together(posed, build), posed.polygons),
        zo.Surface(other.vertices(onto), other.polygons),
        arms_and_legs(posed),
        arms_and_legs(other),
        _rig_of_bodies(posed, build),
    )


def _touching(clothes: ModuleType, pose: str, build: str, onto: str, topology: str, *, is_source: bool) -> Case:
    posed, other = clothes.Bodies(), clothes.Bodies(topology=topology)
    make, limbs = POSES[pose]
    sides = [
        (f"{build}, {pose}", zo.Surface(make(posed, build), posed.polygons), limbs(posed)),
        (f"{onto} ({topology})", zo.Surface(other.vertices(onto), other.polygons), limbs(other)),
    ]
    (from_name, source, source_limb), (to_name, target, target_limb) = sides if is_source else sides[::-1]
    rig = _rig_of_bodies(posed, build) if is_source else None
    return _of_bodies(TOUCH, f"{from_name} to {to_name}", source, target, source_limb, target_limb, rig)


def _other(clothes: ModuleType, path: Path, build: str) -> Case | None:
    character = read_character(path)
    if is_broken(character):
        return None
    made = _whole_skin(character.rest)
    if made is None:
        return None
    skin, _ = made
    name = f"{character.pack} {character.name} as one skin to {build}"
    bodies = clothes.Bodies()
    target = zo.Surface(bodies.vertices(build), bodies.polygons)
    limbs, rig = _limbs_of_body(character, skin), _rig_of_body(character, skin)
    return _of_bodies(OTHER, name, surface_of(skin), target, limbs, arms_and_legs(bodies), rig)


def _of_bodies(
    kind: str,
    name: str,
    source: zo.Surface,
    target: zo.Surface,
    source_limb: Integers,
    target_limb: Integers,
    rig: Rig | None,
) -> Case:
    """A case without known parts."""
    unknown = np.full(len(target.vertices), -1)
    return Case(kind, name, source, target, source.components, unknown, source_limb, target_limb, rig)


def _rig_of_bodies(bodies: Bodies, build: str) -> Rig:
    names = bodies.bone_names
    parents = np.array([names.index(parent) if parent else -1 for parent in bodies.bone_parents])
    return Rig(bodies.vertices(build), csr_array(bodies.weights), bodies.heads(build), parents)


def _rig_of_body(character: Character, body: Body) -> Rig:
    skeleton = character.skeleton
    weights = csr_array(body.weights.astype(np.float64))
    return Rig(body.vertices, weights, skeleton.head, skeleton.parent)


def _limbs_of_body(character: Character, body: Body) -> Integers:
    """(n,) the limb of each vertex, numbered as by `arms_and_legs`."""
    limbs = limbs_of(character.skeleton)
    kind = np.array([2 if LEG.search(name) else 1 for name in limbs.limb]) * limbs.side
    return number_limbs(body.weights, {number: np.flatnonzero(kind == number) for number in (1, 2, -1, -2)})


def _module(path: Path) -> ModuleType:
    """Import the reader that is shipped with a set."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
