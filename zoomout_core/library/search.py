# SPDX-License-Identifier: GPL-3.0-or-later
"""Search for the assets that fit a target: descriptors choose a few, and matches between bodies rank them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zoomout_core.library.asset_match import match_asset
from zoomout_core.library.bodies import MAIN_PART, Body, LibraryAsset, bodies_of, may_be_part
from zoomout_core.library.descriptor import Difference, compare
from zoomout_core.library.found import FIT, FoundSource, FoundSources
from zoomout_core.library.second_source import find_second_source
from zoomout_core.library.wholes import find_wholes
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import Message, message, probability, sentences
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.tuning import Tuning, tuned

NOTHING_FITS = (
    "Nothing in the library fits: the nearest asset is '{name}', but {reason}. Add an asset like the target, or choose "
    "a source by hand."
)
# Added if the target may be a part.
ONLY_A_PART = (
    "The target may be only a part, such as a bust, but its place on no character of the library is certain: choose a "
    "whole character as the source by hand."
)
NO_ASSETS = "The library has no assets: add files of finished characters, and prepare it again."
# The reason why the nearest asset does not fit, by its largest difference.
REASONS = {
    "spectrum": "its proportions are different",
    "limbs": "its limbs differ in number or length",
    "volume": "it is much thicker or thinner",
    "curvature": "its surface has a different form",
}
DEFORMED = "the best map onto it deforms the target too much (fit {fit:.0%})"
UNCERTAIN = "the best map onto it is only {certainty} certain"


# Misfit that equals a difference of one when found assets are sorted. Assets with the same body have equal maps, and
# differ in their clothes only.
TIE = 0.001
# Fraction of the progress at which the search for a second source begins.
RANKED = 0.75


@dataclass(frozen=True)
class SearchTuning(Tuning, set_by="library"):
    """The number of assets to match."""

    matched: int = tuned(4, "assets", 1, 1000)  # maximum number of assets that are matched
    # The same if a target was searched for as a part before, and is not nearly a whole. With four, a chair and a vase
    # take 23 and 21 s.
    matched_after: int = tuned(2, "assets", 1, 1000)
    beyond: float = tuned(2.5, "1", 1, 100)  # maximum difference of matched assets, relative to that of the nearest
    max_difference: float = tuned(4.0, "1", 0, 1000)  # assets with a larger one are refused without a match


SEARCH = SearchTuning()


def search(target: Surface, assets: Iterable[LibraryAsset], compare: int | None = None) -> FoundSources:
    """Find the assets that fit a target.

    Args:
        target: the target.
        assets: the assets to search.
        compare: number of nearest assets to match; by default few, and fewer if the nearest is much nearer.

    Raises:
        MeshError: the target cannot be analysed.
    """
    assets = list(assets)
    if not assets:
        return FoundSources((), None, message(NO_ASSETS))
    with portion(0.0, 0.2):
        bodies = bodies_of(target)
    is_open, matched = may_be_part(bodies), SEARCH.matched
    if is_open:
        with portion(0.2, 0.5):
            wholes = _search_wholes(bodies[MAIN_PART], assets, compare)
        if wholes and wholes[0].fits:
            return FoundSources(wholes, wholes[0].path, "")
        if wholes is not None:
            matched = SEARCH.matched_after
    begin = 0.5 if is_open else 0.2
    compared = [_compare(asset, bodies) for asset in assets]
    closest = _closest(compared, compare or matched)
    nearest = closest[0]
    limit = SEARCH.max_difference
    if compare is None:
        limit = min(SEARCH.beyond * nearest.difference.total, limit)
    chosen = [each for each in closest if each.difference.total <= limit]
    found = []
    for number, each in enumerate(chosen):
        with stage("Matching", *(begin + (RANKED - begin) * each / len(chosen) for each in (number, number + 1))):
            source = match_asset(each.path, each.source, each.target)
        found.append(((not source.fits, source.misfit + TIE * each.overall), source))
    ranked = tuple(source for _, source in sorted(found, key=lambda pair: pair[0]))
    nearest_path = ranked[0].path if ranked else nearest.path
    refusal = _refusal(ranked, nearest)
    if refusal and is_open:
        refusal = sentences(refusal, message(ONLY_A_PART))
    if refusal:
        return FoundSources(ranked, nearest_path, refusal)
    with portion(RANKED, 1.0):
        return FoundSources(ranked, nearest_path, refusal, find_second_source(bodies, assets, ranked))


def _search_wholes(part: Body, assets: Sequence[LibraryAsset], count: int | None) -> tuple[FoundSource, ...] | None:
    """The assets of which a body may be a part, the most certain first; None if it is nearly a whole."""
    found = find_wholes(part, assets, count)
    if found is None:
        return None
    return tuple(
        FoundSource(each.path, each.difference, each.certainty, each.misfit, each.match, is_part=True) for each in found
    )


@dataclass(frozen=True, eq=False)
class _Compared:
    """An asset, and the pair of bodies by which it is most similar to the target."""

    path: Path
    source: Body
    target: Body
    difference: Difference
    overall: float  # the mean difference of all kinds of bodies that both have


def _compare(asset: LibraryAsset, targets: Mapping[str, Body]) -> _Compared:
    kinds = [kind for kind in asset.bodies if kind in targets]
    differences = [compare(asset.bodies[kind].descriptor, targets[kind].descriptor) for kind in kinds]
    totals = [each.total for each in differences]
    least = int(np.argmin(totals))
    kind = kinds[least]
    return _Compared(asset.path, asset.bodies[kind], targets[kind], differences[least], float(np.mean(totals)))


def _closest(compared: Sequence[_Compared], count: int) -> list[_Compared]:
    """The assets to match: the nearest by their most similar bodies, and last the nearest by all of its bodies.

    Builds of one base mesh differ in few of their bodies, and these depend on the pose. The asset with the target's own
    build may be only the fifth.
    """
    first = sorted(compared, key=lambda each: each.difference.total)
    closest, rest = first[: max(count - 1, 1)], first[max(count - 1, 1) :]
    return closest + sorted(rest, key=lambda each: each.overall)[: count - len(closest)]


def _refusal(ranked: Sequence[FoundSource], nearest: _Compared) -> str:
    """Why nothing fits; empty if the first asset does."""
    if not ranked:
        largest = max(zip(nearest.difference, nearest.difference._fields, strict=True))[1]
        return message(NOTHING_FITS, name=nearest.path.name, reason=message(REASONS[largest]))
    best = ranked[0]
    if best.fits:
        return ""
    if best.distance > FIT.max_distance:
        reason: Message = message(DEFORMED, fit=1 - best.misfit)
    else:
        reason = message(UNCERTAIN, certainty=probability(best.certainty))
    return message(NOTHING_FITS, name=best.path.name, reason=reason)
