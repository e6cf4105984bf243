# SPDX-License-Identifier: GPL-3.0-or-later
"""Search for the assets that fit a target: descriptors choose a few, and matches between bodies rank them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from zoomout_core.library.bodies import MAIN_PART, Body, bodies_of, match_options, may_be_part
from zoomout_core.library.descriptor import Difference, compare
from zoomout_core.library.parts import FoundPart, find_part
from zoomout_core.library.wholes import find_wholes
from zoomout_core.matching.pipeline import match
from zoomout_core.matching.ranking.scores import SCORES
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.formats.blender_files import split_asset
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import Message, message, probability, sentences
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.runtime.summary import Summary
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
IS_PART = "The target is only a part of '{name}', such as a bust."
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


@dataclass(frozen=True)
class SearchTuning(Tuning, set_by="library"):
    """The number of assets to match, and the conditions for a fit."""

    matched: int = tuned(4, "assets", 1, 1000)  # maximum number of assets that are matched
    # The same if a target was searched for as a part before, and is not nearly a whole. With four, a chair and a vase
    # take 23 and 21 s.
    matched_after: int = tuned(2, "assets", 1, 1000)
    beyond: float = tuned(2.5, "1", 1, 100)  # maximum difference of matched assets, relative to that of the nearest
    max_difference: float = tuned(4.0, "1", 0, 1000)  # assets with a larger one are refused without a match
    max_distance: float = tuned(0.165, "1", 0, 10)  # of an asset that fits, see `FoundSource.distance`
    per_difference: float = tuned(0.02, "1", 0, 1)  # distance that a difference of one adds to the misfit
    min_certainty: float = tuned(0.5, "probability", 0, 1)  # of the match of an asset that fits


SEARCH = SearchTuning()


@dataclass(frozen=True, eq=False)
class LibraryAsset:
    """A prepared file of a library.

    Attributes:
        path: the file, or the asset in a .blend file, see `split_asset`.
        bodies: meshes that represent its shape, by kind.
    """

    path: Path
    bodies: dict[str, Body]


@dataclass(frozen=True)
class FoundSource:
    """An asset that a target was matched with.

    Attributes:
        path: its file, or the asset in a .blend file: `FILE.blend/Collection/Hero`.
        difference: difference of its descriptor from the target's; 0.2 to 2.7 for the same body in another pose.
        certainty: the probability, in [0, 1], that the match is right as a whole.
        misfit: the weighted geometric mean of the errors that rank maps. It is mostly 0.04 to 0.11 for the same body in
            another pose, and above 0.12 for another species.
        match: the match of small bodies that represent both, for pictures; None if there was none.
        is_part: whether the target is only a part of it, such as a bust. Then `difference` is the mean difference of
            the surroundings of places.

    Example:
        >>> zo.FoundSource("hero.glb", difference=0.4, certainty=0.97, misfit=0.06).fits
        True
    """

    path: Path
    difference: float
    certainty: float
    misfit: float
    match: MatchResult | None = field(default=None, repr=False, compare=False)
    is_part: bool = False

    @property
    def name(self) -> str:
        """The name of the asset, or of the file without its extension."""
        return self.path.name if split_asset(self.path)[1] else self.path.stem

    @property
    def distance(self) -> float:
        """The misfit plus a share of the difference: maps between similar bodies may deform more."""
        return self.misfit + SEARCH.per_difference * self.difference

    @property
    def fits(self) -> bool:
        """Whether it may be a source for the target."""
        # The certainty of a part depends on its fit.
        near_enough = self.is_part or self.distance <= SEARCH.max_distance
        return near_enough and self.certainty >= SEARCH.min_certainty


@dataclass(frozen=True, eq=False, repr=False)
class FoundSources(Summary):
    """The result of a search.

    Attributes:
        ranked: the assets that were matched, those that fit first, by increasing misfit; by decreasing certainty if the
            target is only a part of them.
        nearest: the file of the nearest asset, by its descriptor if none was matched; None if there are no assets.
        refusal: why nothing fits; empty if the first asset does.
        part: the part of the target that another asset fits much better than the first; None if no part does.

    Example:
        >>> hero = zo.FoundSource("hero.glb", difference=0.4, certainty=0.97, misfit=0.06)
        >>> zo.FoundSources((hero,), hero.path, refusal="").best.path
        'hero.glb'
    """

    ranked: tuple[FoundSource, ...]
    nearest: Path | None
    refusal: str
    part: FoundPart | None = None

    @property
    def best(self) -> FoundSource | None:
        """The asset that fits best; None if nothing does."""
        return None if self.refusal else self.ranked[0]

    @property
    def note(self) -> str:
        """A note that the target is only a part of the best source, else empty."""
        best = self.best
        return message(IS_PART, name=best.name) if best is not None and best.is_part else ""

    def _summary(self) -> dict[str, str]:
        rows = {
            each.path.name: f"fit {1 - each.misfit:.0%}, {probability(each.certainty)} certain" for each in self.ranked
        }
        return {"best": self.refusal or self.ranked[0].path.name} | rows


def search(target: Surface, assets: Sequence[LibraryAsset], compare: int | None = None) -> FoundSources:
    """Find the assets that fit a target.

    Args:
        target: the target.
        assets: the assets to search.
        compare: number of nearest assets to match; by default few, and fewer if the nearest is much nearer.

    Raises:
        MeshError: the target cannot be analysed.
    """
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
        with stage("Matching", *(begin + (1 - begin) * each / len(chosen) for each in (number, number + 1))):
            result = match(each.source.surface, each.target.surface, match_options())
        source = FoundSource(each.path, each.difference.total, result.certainty, misfit_of(result), result)
        found.append(((not source.fits, source.misfit + TIE * each.overall), source))
    ranked = tuple(source for _, source in sorted(found, key=lambda pair: pair[0]))
    nearest_path = ranked[0].path if ranked else nearest.path
    refusal = _refusal(ranked, nearest)
    if refusal and is_open:
        refusal = sentences(refusal, message(ONLY_A_PART))
    return FoundSources(ranked, nearest_path, refusal, find_part(ranked))


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


def misfit_of(result: MatchResult) -> float:
    """The weighted geometric mean of the errors that rank the candidates of a match."""
    weights = (
        SCORES.place + SCORES.facing + SCORES.commutativity + SCORES.frequency + SCORES.distance + SCORES.curvature
    )
    return float(np.exp(result.candidates[result.chosen].scores["total"] / weights))


def _refusal(ranked: Sequence[FoundSource], nearest: _Compared) -> str:
    """Why nothing fits; empty if the first asset does."""
    if not ranked:
        largest = max(zip(nearest.difference, nearest.difference._fields, strict=True))[1]
        return message(NOTHING_FITS, name=nearest.path.name, reason=message(REASONS[largest]))
    best = ranked[0]
    if best.fits:
        return ""
    if best.distance > SEARCH.max_distance:
        reason: Message = message(DEFORMED, fit=1 - best.misfit)
    else:
        reason = message(UNCERTAIN, certainty=probability(best.certainty))
    return message(NOTHING_FITS, name=best.path.name, reason=reason)
