# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose between the candidates of several bodies, such as a main part and the hull around all parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import are_rivals, confirmed_certainty
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class AttemptTuning(Tuning, set_by="characters"):
    """When to try another body, and which one to choose."""

    certain: float = tuned(0.8, "probability", 0, 1)  # certainty of a body's map from which no other body is tried
    same_place: float = tuned(0.15, "at unit area", 0, 2)  # distance below which two images count as the same place
    same_share: float = tuned(0.75, "1", 0, 1)  # maps of two bodies are the same if more of their images are
    # Minimum ratio of the worth of a later attempt to that of an earlier one. Later attempts, such as tight hulls, lose
    # thin parts. In the table a rolling character as one hull improves by 2.1; a mannequin whose knees touch gets worse
    # at 1.2.
    clearly_better: float = tuned(1.3, "1", 1, 10)


ATTEMPTS = AttemptTuning()


@dataclass(frozen=True, eq=False)
class Attempt:
    """A pair of bodies and its candidates."""

    pair: Pair  # of the bodies' shapes
    candidates: Sequence[Candidate]  # maps between them, the most likely first
    coverage: float  # the part of both surfaces, in [0, 1], that the bodies cover

    @property
    def worth(self) -> float:
        """Expected part of the surfaces that the first candidate maps correctly."""
        return self.candidates[0].certainty * self.coverage

    def outline(self) -> tuple[Floats, Floats]:
        """(s, 3) points of the target, in its frame and unit, and (s, 3) their images by the first candidate."""
        source, target = self.pair.source_shape, self.pair.target_shape
        image = source.search.samples[self.candidates[0].sample_map]
        return (
            target.proxy.full.to_surface(target.proxy.vertices[target.search.samples]),
            source.proxy.full.to_surface(source.proxy.vertices[image]),
        )


def best_of(attempts: Sequence[Attempt]) -> Attempt:
    """The attempt of the highest worth, or the one of the largest coverage if all found the same map.

    In that case they confirm each other (see `confirm`). The most promising attempts come first; a later one is chosen
    only if it is clearly better.
    """
    most = max(attempt.coverage for attempt in attempts)
    widest = _first_of_the_best([attempt for attempt in attempts if attempt.coverage == most])
    if not all(agree(widest, attempt) for attempt in attempts if attempt is not widest):
        return _first_of_the_best(attempts)
    return confirm(widest, max(attempts, key=lambda attempt: attempt.candidates[0].certainty))


def confirm(attempt: Attempt, by: Attempt) -> Attempt:
    """Raise the certainty of an attempt's first candidate to that of another attempt with the same map.

    Maps that agree in most places may still differ on a leg. If the other attempt also agrees with a rival of the first
    candidate, it does not decide between the two, and the rival keeps its share.
    """
    first, *others = attempt.candidates
    shapes = attempt.pair.source_shape, attempt.pair.target_shape
    rivals = [other for other in others if are_rivals(first, other, *shapes)]
    undecided = (other.certainty for other in rivals if agree(replace(attempt, candidates=[other]), by))
    certainty = confirmed_certainty(first.certainty, max(undecided, default=0.0), by.candidates[0].certainty)
    return replace(attempt, candidates=[replace(first, certainty=certainty), *others])


def _first_of_the_best(attempts: Sequence[Attempt]) -> Attempt:
    """The first attempt to which no other is clearly superior."""
    most = max(attempt.worth for attempt in attempts)
    return next(attempt for attempt in attempts if ATTEMPTS.clearly_better * attempt.worth >= most)


def agree(one: Attempt, other: Attempt) -> bool:
    """Whether the first candidates of two attempts have the same images."""
    (places, images), (their_places, their_images) = one.outline(), other.outline()
    near = cKDTree(places).query(their_places)[1]
    apart = np.linalg.norm(images[near] - their_images, axis=1) / one.pair.source_shape.proxy.full.scale
    return bool(np.mean(apart < ATTEMPTS.same_place) > ATTEMPTS.same_share)
