# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs of characters with known correspondence, either exact or by the weights in their files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import TypeAlias, TypeVar

import numpy as np

import zoomout_core as zo
from benchmarks.characters.game import Body, Character, one_skin, read_character, shuffle
from benchmarks.characters.truth import Bones, Rest, bones_of
from zoomout_core.arrays import Booleans, Floats

# The kinds of cases: the same character posed, or posed as one skin; another character; a body and its outfits.
POSE, SKIN, OTHER, OUTFITS = "pose", "skin", "other", "outfits"
# Number of posed characters for each pack.
OF_PACK = 3
# Characters with more loose parts are remeshed into one skin.
FEW_PARTS = 5
# In packs with more characters, each pair has only one pose.
SMALL_PACK = 4
# Two skeletons are compatible if they share this fraction of the deforming bones of the smaller one.
SHARED = 0.7
# A character with a larger share of vertices without weights is broken.
UNMOVED = 0.01
# The `height` of an outfit in centimetres, so that errors are in centimetres.
CENTIMETRES = 170


@dataclass(frozen=True, eq=False)
class Case:
    """A pair to be matched.

    Attributes:
        kind: "pose", "skin", "other" or "outfits".
        name: of the character or characters, and the pose.
        source: the surface with the images.
        target: the surface to be mapped.
        truth: the known correspondence.
    """

    kind: str
    name: str
    source: zo.Surface
    target: zo.Surface
    truth: Bones | Rest


T = TypeVar("T")
Maker: TypeAlias = Callable[[], Case | None]


def cases(folder: Path, max_count: int | None) -> Iterator[Case]:
    """The cases of a folder of characters, or about `max_count` of each kind, evenly spread.

    Args:
        folder: with packs of characters under `game`, and outfits under `outfits`.
        max_count: largest number of a kind; None for all.
    """
    packs = [sorted(pack.glob("*.glb")) for pack in sorted((folder / "game").glob("*"))]
    chosen = list(chain.from_iterable(spread(pack, OF_PACK) for pack in packs))
    kinds: list[list[Maker]] = [
        [partial(_pose, path) for path in chosen],
        [partial(_as_one_skin, path) for path in chosen],
        [partial(_other, *pair) for pack in packs for pair in _cycle(pack)],
        [partial(outfit, path) for path in sorted((folder / "outfits").glob("*.npz"))],
    ]
    for makers in kinds:
        for make in spread(makers, max_count):
            case = make()
            if case is not None:
                yield case


def first_pairs(folder: Path) -> Iterator[Case]:
    """The first two compatible characters of each pack of game characters, at rest."""
    for pack in sorted(folder.glob("*")):
        found = (_other(*files, False) for files in pairwise(sorted(pack.glob("*.glb"))))
        yield from islice((case for case in found if case is not None), 1)


def spread(entries: list[T], max_count: int | None) -> list[T]:
    if max_count is None or max_count >= len(entries):
        return entries
    return [entries[i] for i in np.linspace(0, len(entries) - 1, max_count).round().astype(int)]


def _cycle(pack: list[Path]) -> Iterator[tuple[Path, Path, bool]]:
    """Each character of a pack paired with the next, and whether the latter is posed."""
    for i, path in enumerate(pack if len(pack) > 1 else []):
        for posed in (False, True) if len(pack) <= SMALL_PACK else (bool(i % 2),):
            yield path, pack[(i + 1) % len(pack)], posed


# --- makers -------------------------------------------------------------------------------------------------


def _pose(path: Path) -> Case | None:
    character = read_character(path)
    return None if is_broken(character) else _case(POSE, character, character, character.thinned, character.pose)


def _as_one_skin(path: Path) -> Case | None:
    character = read_character(path)
    if is_broken(character) or surface_of(character.rest).components.max() < FEW_PARTS:
        return None
    return _case(SKIN, character, character, one_skin(character.posed), character.pose)


def _other(source_path: Path, target_path: Path, posed: bool) -> Case | None:
    source, target = read_character(source_path), read_character(target_path)
    moving = [set(np.array(one.skeleton.names)[_moving(one.rest)]) for one in (source, target)]
    if is_broken(source) or is_broken(target) or len(moving[0] & moving[1]) < SHARED * min(map(len, moving)):
        return None
    body, pose = (target.posed, target.pose) if posed else (target.rest, "rest")
    return _case(OTHER, source, target, body, pose)


def outfit(path: Path) -> Case:
    with np.load(path) as file:
        arrays = dict(file)
    source, target = (_polygons(arrays, side) for side in ("source", "target"))
    rest = Rest(
        arrays["source_rest"].astype(np.float64),
        arrays["target_rest"].astype(np.float64),
        float(arrays["height"]) / CENTIMETRES,
        arrays["source_part"].astype(np.int64),
        arrays["target_part"].astype(np.int64),
    )
    return Case(OUTFITS, path.stem, source, target, rest)


def _polygons(arrays: dict[str, Floats], side: str) -> zo.Surface:
    start = np.concatenate([[0], np.cumsum(arrays[f"{side}_face_sizes"].astype(np.int64))])
    return zo.Surface.from_corners(arrays[f"{side}_vertices"], arrays[f"{side}_face_vertices"], start)


def _case(kind: str, source: Character, target: Character, body: Body, pose: str) -> Case:
    """A case from the first character at rest to a body of the other."""
    body = shuffle(body)
    name = source.name if source is target else f"{source.name} to {target.name}"
    truth = bones_of(source, target, body)
    return Case(kind, f"{source.pack} {name}, {pose}", surface_of(source.rest), surface_of(body), truth)


def surface_of(body: Body) -> zo.Surface:
    """The surface of a body."""
    return zo.Surface(body.vertices, body.triangles)


def is_broken(character: Character) -> bool:
    return bool((character.rest.weights.sum(axis=1) < 0.5).mean() > UNMOVED)


def _moving(body: Body) -> Booleans:
    """(b,) which bones have weights."""
    return np.asarray((body.weights > 0).any(axis=0))
