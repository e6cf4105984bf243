# SPDX-License-Identifier: GPL-3.0-or-later
"""The result of a search in libraries: assets that a target was matched with, and a part that another asset fits."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.formats.blender_files import split_asset
from zoomout_core.messages import Message, message, probability
from zoomout_core.runtime.summary import Summary
from zoomout_core.tuning import Tuning, tuned

IS_PART = "The target is only a part of '{name}', such as a bust."
BETTER = (
    "{file} fits the joint {joint} and all below it better than {best} does ({fit:.1%} instead of {fit_of_best:.1%}). "
    "To use both, transfer from the latter first, and then from the other one to this joint only."
)


@dataclass(frozen=True)
class FitTuning(Tuning, set_by="library"):
    """The conditions for an asset to fit a target."""

    max_distance: float = tuned(0.165, "1", 0, 10)  # of an asset that fits, see `FoundSource.distance`
    per_difference: float = tuned(0.02, "1", 0, 1)  # distance that a difference of one adds to the misfit
    min_certainty: float = tuned(0.5, "probability", 0, 1)  # of the match of an asset that fits


FIT = FitTuning()


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
        return self.misfit + FIT.per_difference * self.difference

    @property
    def fits(self) -> bool:
        """Whether it may be a source for the target."""
        # The certainty of a part depends on its fit.
        near_enough = self.is_part or self.distance <= FIT.max_distance
        return near_enough and self.certainty >= FIT.min_certainty


@dataclass(frozen=True)
class FoundPart:
    """A part of a target that another source fits better.

    Attributes:
        path: the file of the other source.
        best: the file of the best source.
        joint: the joint of the best source that moves the part, with all below it.
        joints: the names of these joints.
        fit: one minus the error of the other source, relative to the size of the part.
        fit_of_best: the same for the best source.

    Example:
        >>> part = zo.FoundPart("princess.glb", "hero.glb", "Head", ("Head", "Jaw"), fit=0.992, fit_of_best=0.957)
        >>> str(part.sentence)[:63]
        'princess.glb fits the joint Head and all below it better than h'
    """

    path: Path
    best: Path
    joint: str
    joints: tuple[str, ...]
    fit: float
    fit_of_best: float

    @property
    def sentence(self) -> Message:
        """The part, and how to use its source, for the user."""
        names = {"joint": self.joint, "file": str(self.path), "best": str(self.best)}
        return message(BETTER, **names, fit=self.fit, fit_of_best=self.fit_of_best)


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
