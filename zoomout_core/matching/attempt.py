# SPDX-License-Identifier: GPL-3.0-or-later
"""Candidates by several bodies, such as a main part and the hull around all parts: which of them to go on with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.ranking import Candidate
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class AttemptTuning(Tuning, set_by="characters"):
    """When another body is tried, and which one is taken.

    Attributes:
        sure: smallest certainty of the map of a body at which no other body is tried.
        same_place: distance below which two images are the same place,
        same_share: where more of the places than this part have the same images, the maps of two bodies are one.
        clearly_better: factor by which the worth of a later attempt, such as that by a tight hull, which loses what is
            thin, has to exceed an earlier one's (of the table: a character in a roll as one hull, by 2.1; a mannequin
            whose knees touch gets worse by it at 1.2).
    """

    sure: float = tuned(0.8, "probability", 0, 1)
    same_place: float = tuned(0.15, "at unit area", 0, 2)
    same_share: float = tuned(0.75, "1", 0, 1)
    clearly_better: float = tuned(1.3, "1", 1, 10)


ATTEMPTS = AttemptTuning()


@dataclass(frozen=True, eq=False)
class Attempt:
    """A pair of bodies and its candidates.

    Attributes:
        pair: of the bodies' shapes.
        candidates: maps between them, the most likely first.
        coverage: the part of both surfaces, in [0, 1], that the bodies tell of.
    """

    pair: Pair
    candidates: Sequence[Candidate]
    coverage: float

    @property
    def worth(self) -> float:
        """The part of the surfaces that the first candidate is expected to be right for."""
        return self.candidates[0].certainty * self.coverage

    def outline(self) -> tuple[Floats, Floats]:
        """(s, 3) places of the target, in its frame and unit, and (s, 3) where the first candidate has them go."""
        source, target = self.pair.source_shape, self.pair.target_shape
        image = source.search.samples[self.candidates[0].sample_map]
        return (
            target.proxy.full.to_surface(target.proxy.vertices[target.search.samples]),
            source.proxy.full.to_surface(source.proxy.vertices[image]),
        )


def best_of(attempts: Sequence[Attempt]) -> Attempt:
    """The attempt of the most worth; or the one that tells of more, where all found the same map.

    They confirm each other then: it is as sure as the surest of them.

    Args:
        attempts: the most promising first; one that is not clearly better than an earlier one is not taken.
    """
    most = max(attempt.coverage for attempt in attempts)
    widest = _first_of_the_best([attempt for attempt in attempts if attempt.coverage == most])
    if not all(agree(widest, attempt) for attempt in attempts if attempt is not widest):
        return _first_of_the_best(attempts)
    return confirm(widest, max(attempt.candidates[0].certainty for attempt in attempts))


def confirm(attempt: Attempt, certainty: float) -> Attempt:
    """Raise the certainty of an attempt's first candidate to that of another one with the same map."""
    first, *others = attempt.candidates
    return replace(attempt, candidates=[replace(first, certainty=certainty), *others])


def _first_of_the_best(attempts: Sequence[Attempt]) -> Attempt:
    """The first attempt that none is clearly better than."""
    most = max(attempt.worth for attempt in attempts)
    return next(attempt for attempt in attempts if ATTEMPTS.clearly_better * attempt.worth >= most)


def agree(one: Attempt, other: Attempt) -> bool:
    """Whether the first candidates of two attempts lead to the same places."""
    (places, images), (their_places, their_images) = one.outline(), other.outline()
    near = cKDTree(places).query(their_places)[1]
    apart = np.linalg.norm(images[near] - their_images, axis=1) / one.pair.source_shape.proxy.full.scale
    return bool(np.mean(apart < ATTEMPTS.same_place) > ATTEMPTS.same_share)
