# SPDX-License-Identifier: GPL-3.0-or-later
"""Find a second source for the part of a target that the best source fits worst, such as its head.

An asset with the right head may have another body, so that its descriptor is far from the target's. The surroundings of
places in the poor part therefore nominate a few assets, and these are matched too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans
from zoomout_core.assets.files import GLTF, read_asset
from zoomout_core.library.asset_match import match_asset
from zoomout_core.library.bodies import HULL, TIGHT_HULL, Body, LibraryAsset, analyse_body
from zoomout_core.library.descriptor import compare
from zoomout_core.library.found import FoundPart, FoundSource
from zoomout_core.library.parts import PARTS, JointParts, is_covered
from zoomout_core.library.surroundings import PartSurroundings
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.tuning import Tuning, tuned

# Bodies with all parts of a character; a main part may lack the head.
HULLS = HULL, TIGHT_HULL


@dataclass(frozen=True)
class SecondSourceTuning(Tuning, set_by="library"):
    """The assets that are tried as a second source."""

    nominated: int = tuned(3, "assets", 0, 1000)  # assets with the most similar surroundings in the poor part


SECOND_SOURCE = SecondSourceTuning()


def find_second_source(
    bodies: Mapping[str, Body], assets: Sequence[LibraryAsset], ranked: Sequence[FoundSource]
) -> FoundPart | None:
    """The part of a target that another asset fits much better than the best source; None if there is no such part.

    Args:
        bodies: the target's, by kind.
        assets: the assets to search.
        ranked: those that were matched, the best first.
    """
    best, *others = ranked
    if best.path.suffix.lower() not in GLTF:
        return None
    finished = read_asset(best.path)
    if finished.skin is None:
        return None
    of_best = next(asset for asset in assets if asset.path == best.path)
    parts = JointParts.of(best.path, finished, _cover(best, of_best, bodies))
    region = parts.poorest()
    if region is None:
        return None
    known = {each.path: each for each in others if each.match is not None and _covers(each.match.target, parts.body)}
    for number, asset in enumerate(_nominate(bodies, parts.body, region, of_best, assets)):
        if asset.path not in known:
            with portion(*((number + step) / (SECOND_SOURCE.nominated + 1) for step in (1, 2))):
                known[asset.path] = _match_hulls(asset, bodies)
        if parts.is_fitted(region, known[asset.path]):
            break
    return parts.find(list(known.values()))


def _cover(best: FoundSource, asset: LibraryAsset, bodies: Mapping[str, Body]) -> list[MatchResult]:
    """The match of the best source, and one of hulls if the former is of a main part that lacks others."""
    assert best.match is not None
    if all(_covers(best.match.target, bodies[kind].surface) for kind in HULLS):
        return [best.match]
    with portion(0.0, 1 / (SECOND_SOURCE.nominated + 1)):
        whole = _match_hulls(asset, bodies).match
    assert whole is not None
    return [best.match, whole]


def _nominate(
    bodies: Mapping[str, Body], body: Surface, region: Booleans, best: LibraryAsset, assets: Sequence[LibraryAsset]
) -> list[LibraryAsset]:
    """The few assets whose surroundings are the most similar to those of a region of a body (n,).

    Only assets that are more similar than the best source are nominated. The differences of both hulls count: for heads
    of women, the right asset is among the first three by their sum, but only the fourth by some tight hulls.
    """
    total = np.zeros(len(assets))
    near = cKDTree(body.vertices)
    for kind in HULLS:
        surface = bodies[kind].surface
        inside = region[near.query(surface.vertices)[1]]
        part = PartSurroundings.of_region(analyse_body(surface), inside)
        total += [part.difference(asset.bodies[kind].surroundings) for asset in assets]
    more_similar = np.flatnonzero(total < total[[asset.path for asset in assets].index(best.path)])
    order = more_similar[np.argsort(total[more_similar], kind="stable")]
    return [assets[number] for number in order[: SECOND_SOURCE.nominated]]


def _match_hulls(asset: LibraryAsset, bodies: Mapping[str, Body]) -> FoundSource:
    """The match of the hulls by which an asset is the most similar to a target."""

    def difference(kind: str) -> float:
        return compare(asset.bodies[kind].descriptor, bodies[kind].descriptor).total

    kind = min(HULLS, key=difference)
    with stage("Matching"):
        return match_asset(asset.path, asset.bodies[kind], bodies[kind])


def _covers(body: Surface, whole: Surface) -> bool:
    """Whether a body lacks at most as much of another one as the smallest part."""
    missing = ~is_covered(whole, body)
    return bool(whole.vertex_areas[missing].sum() < PARTS.min_share * whole.area)
