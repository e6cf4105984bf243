"""The ranked maps that a match found, to choose another one from, as where left and right are swapped.

The list is kept with the match on the target's mesh: for each map its probability, and the colours of the places on
the source that it leads to from some vertices of the target. These draw a picture of it, and recognise it when the
file was opened again and the two are matched anew; before that the full results are at hand in memory.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache

import numpy as np
from bpy.types import Mesh

import zoomout_core as zo
from zoomout_core.arrays import Floats, Integers
from zoomout_core.matching.ranking import Candidate
from zoomout_core.runtime.stepping import Steps
from zoomout_core.symmetry.detect import LEAST_CERTAINTY

from ..mesh_data.arrays import from_text, hash_of, to_text
from ..services.pair import ObjectPair
from ..viewport.colors import DARK, LIGHT, place_colors

PROPERTY = "zoomout_candidates"
# How many are listed at most: likely ones, and the most likely mirror images, which rank behind all others.
MOST_DIRECT, MOST_MIRRORED = 6, 2
# Pairs of objects of which results are held, those used last.
MOST_HELD = 2


@dataclass(frozen=True, eq=False)
class Listed:
    """A candidate.

    Attributes:
        number: of the candidate in the result.
        certainty: probability that it is the right one.
        mirrored: whether it maps the mirror image.
        colors: (s, 3) of the places on the source that it leads to, 0 to 255.
    """

    number: int
    certainty: float
    mirrored: bool
    colors: Integers


@dataclass(frozen=True, eq=False)
class Listing:
    """The candidates of a match.

    Attributes:
        key: of this list among all.
        chosen: place in the list of the one that is used.
        vertices: (s,) of the target, which the candidates are known at.
        points: (s, 3) where these were, in world space, for a picture.
        box: (3,) edges of the box around the source, which colours tell places in.
        candidates: the most likely first.
    """

    key: str
    chosen: int
    vertices: Integers
    points: Floats
    box: Floats
    candidates: tuple[Listed, ...]

    def swapped(self) -> int | None:
        """Place in the list of the map that swaps sides most nearly, or None if none does."""
        return _swapping(self.chosen, [candidate.colors for candidate in self.candidates])


# Computed results, by the list's key and the candidate's number.
_held: OrderedDict[str, dict[int, zo.MatchResult]] = OrderedDict()


def listing_of(result: zo.MatchResult, pair: ObjectPair) -> Listing:
    """The candidates of a result that are worth a look, the one that it was made from always among them.

    These are the most likely one, others that are likely at all, mirror images, and whatever swaps the sides of a
    likely one, however unlikely that is.
    """
    outlines = [result.outline(number) for number in range(len(result.candidates))]
    vertices = outlines[0][0]
    around = pair.source.vertices
    box = np.array([np.nanmin(around, axis=0), np.nanmax(around, axis=0)])
    colors = [np.rint(255 * place_colors(around[images], box)).astype(np.uint8) for _, images in outlines]
    numbers = sorted({*_worth_a_look(result.candidates, colors), result.chosen})
    return Listing(
        hash_of("", vertices, *(colors[number] for number in numbers)),
        numbers.index(result.chosen),
        vertices,
        pair.target.vertices[vertices],
        np.nan_to_num(np.ptp(around[np.isfinite(around).all(axis=1)], axis=0)),
        tuple(
            Listed(
                number,
                result.candidates[number].certainty * result.placed,
                result.candidates[number].reverses_orientation,
                colors[number],
            )
            for number in numbers
        ),
    )


def write(mesh: Mesh, result: zo.MatchResult, pair: ObjectPair) -> None:
    """List the candidates of a match on the target's mesh, and hold its result."""
    listing = listing_of(result, pair)
    hold(listing.key, result)
    content = asdict(listing) | {
        "vertices": to_text(listing.vertices, np.int32),
        "points": to_text(listing.points, np.float32),
        "box": listing.box.tolist(),
        "candidates": [asdict(one) | {"colors": to_text(one.colors, np.uint8)} for one in listing.candidates],
    }
    mesh[PROPERTY] = json.dumps(content)


def read(mesh: Mesh) -> Listing | None:
    """The candidates that are listed on a mesh, or None if there are none."""
    text = mesh.get(PROPERTY)
    return None if text is None else _parsed(text)


def remove(mesh: Mesh) -> None:
    """Take the list from a mesh that has one."""
    if PROPERTY in mesh:
        del mesh[PROPERTY]


def hold(key: str, result: zo.MatchResult) -> None:
    """Hold a result in memory, with those of other candidates of the same match."""
    _held.setdefault(key, {})[result.chosen] = result
    _held.move_to_end(key)
    while len(_held) > MOST_HELD:
        _held.popitem(last=False)


def forget() -> None:
    """Let go of all results."""
    _held.clear()
    _parsed.cache_clear()


def is_held(listing: Listing) -> bool:
    """Whether other candidates can be had without matching anew."""
    return listing.key in _held


def result_steps(listing: Listing, place: int) -> Steps[zo.MatchResult]:
    """The full result of a listed candidate, of a match whose results are held."""
    number, held = listing.candidates[place].number, _held[listing.key]
    if number not in held:
        result = yield from next(iter(held.values())).use_steps(number)
        hold(listing.key, result)
    return _held[listing.key][number]


def most_alike(place: int, listing: Listing, found: Listing) -> int:
    """The place in a new list of the candidate that is most like one of an old list of the same objects."""
    wanted = listing.candidates[place].colors.astype(float)
    near = np.linalg.norm(found.points[:, None] - listing.points[None], axis=2).argmin(axis=1)
    return int(np.argmin([np.abs(wanted[near] - other.colors).mean() for other in found.candidates]))


def _worth_a_look(found: Sequence[Candidate], colors: Sequence[Integers]) -> set[int]:
    """Numbers of the candidates to list, whichever is used; of them all, with their colours."""
    order = range(len(found))
    direct = [number for number in order if not found[number].reverses_orientation]
    likely = [one for one in direct if one == direct[0] or found[one].certainty >= LEAST_CERTAINTY][:MOST_DIRECT]
    mirrored = [number for number in order if found[number].reverses_orientation][:MOST_MIRRORED]
    swapping = (_swapping(number, colors) for number in likely)
    return {*likely, *mirrored, *(number for number in swapping if number is not None)}


def _swapping(chosen: int, colors: Sequence[Integers]) -> int | None:
    """Number of the map, of some that are known by their colours, that swaps the sides of one of them most nearly.

    Wherever the sides are, the box around the source has one of its middle planes between them: this map leads
    to the mirror images in one of the three, rather than to the same places.
    """
    here = colors[chosen].astype(float)
    best, least = None, np.inf
    for number, other in enumerate(colors):
        kept = np.abs(other - here).mean()
        for axis in range(3):
            mirrored = here.copy()
            mirrored[:, axis] = _mirrored(here[:, axis])
            apart = np.abs(other - mirrored).mean()
            if number != chosen and apart < min(least, kept):
                best, least = number, apart
    return best


def _mirrored(color: Floats) -> Floats:
    return 255 * (DARK + LIGHT) - color


@lru_cache(maxsize=8)
def _parsed(text: str) -> Listing:
    kept = json.loads(text)
    return Listing(
        kept["key"],
        kept["chosen"],
        from_text(kept["vertices"], np.int32),
        from_text(kept["points"], np.float32, 3),
        np.array(kept["box"]),
        tuple(Listed(**one | {"colors": from_text(one["colors"], np.uint8, 3)}) for one in kept["candidates"]),
    )
