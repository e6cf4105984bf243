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
from zoomout_core.library.asset_match import match_asset
from zoomout_core.library.bodies import HULL, TIGHT_HULL, Body, LibraryAsset, analyse_body
from zoomout_core.library.descriptor import compare
from zoomout_core.library.found import FoundPart, FoundSource
from zoomout_core.library.parts import PARTS, JointParts, is_covered
from zoomout_core.library.surroundings import PartSurroundings
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.progress import stage
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
    by_path = {asset.path: asset for asset in assets}
    if best.match is None or best.path not in by_path:
        return None
    matches = [best.match]
    kind = _most_similar_hull(by_path[best.path], bodies)
    if kind is not None and not _covers(best.match.target, bodies[kind].surface):
        with stage("Matching", 0.0, 0.25):
            hulls = match_asset(best.path, by_path[best.path].bodies[kind], bodies[kind])
        if hulls.match is not None:
            matches.append(hulls.match)
    parts = JointParts.of(best.path, matches)
    region = None if parts is None else parts.poorest()
    if parts is None or region is None:
        return None
    nominees = nominate(bodies, parts.body, region, by_path[best.path], assets)
    covering = {each.path for each in others if each.match is not None and _covers(each.match.target, parts.body)}
    for number, asset in enumerate(nominees):
        other_kind = _most_similar_hull(asset, bodies)
        if asset.path not in covering and other_kind is not None:
            with stage("Matching", 0.25 * (number + 1), 0.25 * (number + 2)):
                others.append(match_asset(asset.path, asset.bodies[other_kind], bodies[other_kind]))
        if any(each.path == asset.path and parts.is_fitted(region, each) for each in others):
            break
    return parts.find(others)


def nominate(
    bodies: Mapping[str, Body], body: Surface, region: Booleans, best: LibraryAsset, assets: Sequence[LibraryAsset]
) -> list[LibraryAsset]:
    """The few assets whose surroundings are most similar to those in a region of a body (n,), and more than the best's.

    The mean difference of both hulls counts.
    """
    total = np.zeros(len(assets))
    for kind in HULLS:
        if kind in bodies:
            surface = bodies[kind].surface
            inside = region[cKDTree(body.vertices).query(surface.vertices)[1]]
            part = PartSurroundings.of_region(analyse_body(surface), inside)
            total += [
                part.difference(asset.bodies[kind].surroundings) if kind in asset.bodies else np.inf
                for asset in assets
            ]
    order = [assets[number] for number in np.argsort(total, kind="stable") if np.isfinite(total[number])]
    better = order[: order.index(best)] if best in order else order
    return better[: SECOND_SOURCE.nominated]


def _most_similar_hull(asset: LibraryAsset, bodies: Mapping[str, Body]) -> str | None:
    """The kind of hull by which an asset is most similar to a target; None if they have none in common."""
    common = [kind for kind in HULLS if kind in asset.bodies and kind in bodies]
    differences = {kind: compare(asset.bodies[kind].descriptor, bodies[kind].descriptor).total for kind in common}
    return min(common, key=lambda kind: differences[kind], default=None)


def _covers(body: Surface, whole: Surface) -> bool:
    """Whether a body lacks at most as much of another one as the smallest part."""
    missing = ~is_covered(whole, body)
    return bool(whole.vertex_areas[missing].sum() < PARTS.min_share * whole.area)
