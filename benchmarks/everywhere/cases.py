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
from collections.abc import Callable, Iterator, Sequence
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
from benchmarks.characters.cases import is_broken, spread, surface_of
from benchmarks.characters.game import Body, Character, one_skin, read_character
from benchmarks.characters.skeleton import limbs_of
from benchmarks.everywhere.touching import ALL_POSES, POSES, Bodies, arms_and_legs, feet_together, number_limbs
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
# Names of the first bones of fore legs, which count as arms, and of other legs.
FORE_LEG, LEG = re.compile("front|fore|arm", re.IGNORECASE), re.compile("leg|thigh|foot|hip|back|hind", re.IGNORECASE)
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
        target_limb: (n_t,) the same for the target; bodies have 0 beside another limb, too.
        rig: the source's rig, if the target is at rest.
        image: (n_t,) the source vertex at the place of each target vertex, -1 if unknown; None if all are unknown.
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
    image: Integers | None = None


Maker: TypeAlias = Callable[[], Case | None]


def cases(data: Path, max_count: int | None) -> Iterator[Case]:
    """All cases whose files a data folder has, or about `max_count` of each kind, evenly spread."""
    game = data / "characters" / "game"
    skins: list[Maker] = [
        partial(skin_case, path, posed) for path in sorted(game.glob("*/*.glb")) for posed in (False, True)
    ]
    legs: list[Maker] = []
    touches: list[Maker] = []
    others: list[Maker] = []
    if (data / "clothes" / "bodies.npz").exists():
        clothes = read_module(data / "clothes" / "clothes.py")
        legs = [partial(legs_case, clothes, build, *onto) for build, onto in product(TOUCHING, ONTO)]
        touches = [
            partial(touching_case, clothes, pose, build, *ONTO[number % len(ONTO)], is_source=number % 2 == 0)
            for number, (pose, build) in enumerate(product(POSES, TOUCHING))
        ]
        files = [game / pack / f"{name}.glb" for pack, name in CHARACTERS]
        pairs = product([file for file in files if file.exists()], BUILDS)
        others = [partial(other_case, clothes, path, build) for path, build in pairs]
    kinds: list[list[Maker]] = [skins, legs, touches, others]
    for makers in kinds:
        for make in spread(makers, max_count):
            case = make()
            if case is not None:
                yield case


def skin_case(path: Path, posed: bool, voxels: Sequence[float] = VOXELS, bend: float = 1.0) -> Case | None:
    """A character, and one skin around it, at rest or in the frame of that rank by its bend."""
    character = read_character(path, bend)
    source = surface_of(character.rest)
    if is_broken(character) or source.components.max() == 0:
        return None
    body = character.posed if posed else character.rest
    made = whole_skin(body, voxels)
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
        outer_part(skin, body, source.components, voxel),
        limbs_of_body(character, character.rest),
        limbs_of_body(character, skin),
        None if posed else rig_of_body(character, character.rest),
    )


def whole_skin(body: Body, voxels: Sequence[float] = VOXELS) -> tuple[Body, float] | None:
    """One skin around a character, of the finest voxels that join all parts, and the voxels' width; None if none do."""
    for voxel in voxels:
        skin = one_skin(body, voxel)
        if (np.ptp(skin.vertices, axis=0) > WHOLE * np.ptp(body.vertices, axis=0)).all():
            return skin, voxel
    return None


def outer_part(skin: Body, body: Body, part: Integers, voxel: float) -> Integers:
    """(n,) the part of a body outermost at each vertex of a skin; -1 within a voxel of a border between parts."""
    triangle, _ = closest_points(skin.vertices, body.vertices, body.triangles)
    shown = part[body.triangles[triangle, 0]]
    edges, _ = unique_edges(skin.triangles)
    part_of_end = shown[edges]
    border = np.unique(edges[part_of_end[:, 0] != part_of_end[:, 1]])
    if len(border):
        width = voxel * np.ptp(body.vertices, axis=0).max()
        shown = np.where(cKDTree(skin.vertices[border]).query(skin.vertices)[0] <= width, -1, shown)
    return shown


def legs_case(clothes: ModuleType, build: str, onto: str, topology: str) -> Case:
    posed, other = clothes.Bodies(), clothes.Bodies(topology=topology)
    return case_of_bodies(
        LEGS,
        f"{build}, feet together, to {onto} ({topology})",
        zo.Surface(feet_together(posed, build), posed.polygons),
        zo.Surface(other.vertices(onto), other.polygons),
        arms_and_legs(posed),
        arms_and_legs(other),
        rig_of_bodies(posed, build),
    )


def touching_case(clothes: ModuleType, pose: str, build: str, onto: str, topology: str, *, is_source: bool) -> Case:
    posed, other = clothes.Bodies(), clothes.Bodies(topology=topology)
    make, limbs = ALL_POSES[pose]
    sides = [
        (f"{build}, {pose}", zo.Surface(make(posed, build), posed.polygons), limbs(posed)),
        (f"{onto} ({topology})", zo.Surface(other.vertices(onto), other.polygons), limbs(other)),
    ]
    (from_name, source, source_limb), (to_name, target, target_limb) = sides if is_source else sides[::-1]
    rig = rig_of_bodies(posed, build) if is_source else None
    return case_of_bodies(TOUCH, f"{from_name} to {to_name}", source, target, source_limb, target_limb, rig)


def other_case(clothes: ModuleType, path: Path, build: str, topology: str = "base") -> Case | None:
    found = character_as_skin(path)
    if found is None:
        return None
    character, skin = found
    name = f"{character.pack} {character.name} as one skin to {build}{'' if topology == 'base' else f' ({topology})'}"
    bodies = clothes.Bodies(topology=topology)
    target = zo.Surface(bodies.vertices(build), bodies.polygons)
    limbs, rig = limbs_of_body(character, skin), rig_of_body(character, skin)
    return case_of_bodies(OTHER, name, surface_of(skin), target, limbs, arms_and_legs(bodies), rig)


def character_as_skin(path: Path) -> tuple[Character, Body] | None:
    """A character, and one skin around its rest pose; None if it is broken or cannot be joined."""
    character = read_character(path)
    made = None if is_broken(character) else whole_skin(character.rest)
    return None if made is None else (character, made[0])


def case_of_bodies(
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
    clear = _clear_limbs(target_limb, target)
    return Case(kind, name, source, target, source.components, unknown, source_limb, clear, rig)


def _clear_limbs(limb: Integers, surface: zo.Surface) -> Integers:
    """(n,) limbs (n,), but 0 at vertices beside another limb, such as between the fingers of a coarse mesh."""
    edges, _ = unique_edges(surface.triangles)
    one, other = limb[edges].T
    clear = limb.copy()
    clear[edges[(one != other) & (one != 0) & (other != 0)]] = 0
    return clear


def rig_of_bodies(bodies: Bodies, build: str) -> Rig:
    names = bodies.bone_names
    parents = np.array([names.index(parent) if parent else -1 for parent in bodies.bone_parents])
    return Rig(bodies.vertices(build), csr_array(bodies.weights), bodies.heads(build), parents)


def rig_of_body(character: Character, body: Body) -> Rig:
    skeleton = character.skeleton
    weights = csr_array(body.weights.astype(np.float64))
    return Rig(body.vertices, weights, skeleton.head, skeleton.parent)


def limbs_of_body(character: Character, body: Body) -> Integers:
    """(n,) the limb of each vertex, numbered as by `arms_and_legs`."""
    limbs = limbs_of(character.skeleton)
    is_leg = [bool(LEG.search(name)) and not FORE_LEG.search(name) for name in limbs.limb]
    kind = np.where(is_leg, 2, 1) * np.where(np.array(limbs.limb) == "head", 0, limbs.side)
    return number_limbs(body.weights, {number: np.flatnonzero(kind == number) for number in (1, 2, -1, -2)})


def read_module(path: Path) -> ModuleType:
    """Import the reader that is shipped with a set."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
