# SPDX-License-Identifier: GPL-3.0-or-later
"""The map of a pair of a collection: made, written whole, and read again where it is there already."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.collection.shapes import ShapeSummary
from zoomout_core.maps.zoomout import nearest_samples
from zoomout_core.matching.pair import Pair, surface_vertices
from zoomout_core.matching.ranking import Candidate
from zoomout_core.matching.result import MatchResult
from zoomout_core.runtime.array_files import ArrayFileError, read_arrays

# Candidates of a pair that are kept to choose among.
MAX_CANDIDATES = 8
# Confidence below which a vertex counts as doubtful, as the commands say it.
LOW = 0.5
RECORD = "record"


class PairName(NamedTuple):
    """A pair of shapes, by their names: the map starts on the target and lands on the source."""

    source: str
    target: str

    def __str__(self) -> str:
        return f"{self.target} to {self.source}"


@dataclass(frozen=True, eq=False)
class CandidateMaps:
    """The maps of a pair that were found, between the samples of both shapes; the chosen one was the most likely.

    Attributes:
        forward: (m, s_t) for each sample of the target one of the source.
        backward: (m, s_s) for each sample of the source one of the target.
        certainty: (m,) probability of each among those that treat the orientation as it does.
        reverses_orientation: (m,).
    """

    forward: Integers
    backward: Integers
    certainty: Floats
    reverses_orientation: Booleans

    def with_another(self, forward: Integers, backward: Integers) -> CandidateMaps:
        """These, and one more map at the end, of which nothing is known."""
        return CandidateMaps(
            np.vstack([self.forward, forward]),
            np.vstack([self.backward, backward]),
            np.append(self.certainty, 0.0),
            np.append(self.reverses_orientation, False),
        )


@dataclass(frozen=True)
class PairRecord:
    """How the match of a pair went, as JSON can hold it.

    Attributes:
        key: a hash of both files and of the options.
        certainty: probability that it is right as a whole.
        mean_confidence: of its vertices.
        low_confidence: share of the vertices whose confidence is low.
        share_without_partner: of the target's area.
        source_share_without_partner: of the source's.
        candidates: how many maps were found.
        candidate: which of them this is.
        through: the shape that a map was composed through, where none of the candidates agreed with the others.
        notes: sentences for the user.
        seconds: that it took.
    """

    key: str
    certainty: float
    mean_confidence: float
    low_confidence: float
    share_without_partner: float
    source_share_without_partner: float
    candidates: int
    candidate: int = 0
    through: str = ""
    notes: tuple[str, ...] = ()
    seconds: float = 0.0

    @classmethod
    def load(cls, path: Path) -> PairRecord:
        """The record in the file of a map.

        Raises:
            FileNotFoundError: the file is missing.
            ArrayFileError: it cannot be read.
        """
        arrays = read_arrays(path, (RECORD,))
        try:
            held = json.loads(arrays[RECORD].tobytes())
            return cls(**{**held, "notes": tuple(held["notes"])})
        except (KeyError, TypeError, ValueError) as error:
            raise ArrayFileError("it is not the map of a pair") from error


def arrays_of(result: MatchResult, maps: CandidateMaps, key: str, seconds: float, through: str = "") -> dict[str, Any]:
    """Data stored with the map of a pair: see `zoomout match`, `CandidateMaps` and `PairRecord`."""
    record = PairRecord(
        key,
        result.certainty,
        float(result.confidence.mean()),
        float((result.confidence < LOW).mean()),
        result.share_without_partner,
        result.source_share_without_partner,
        len(result.candidates),
        result.chosen,
        through,
        result.notes,
        seconds,
    )
    return {
        "confidence": result.confidence,
        "functional_map": result.functional_map,
        "has_partner": result.has_partner,
        "source_has_partner": result.source_has_partner,
        "candidate_forward": maps.forward.astype(np.int16),
        "candidate_backward": maps.backward.astype(np.int16),
        "candidate_certainty": maps.certainty,
        "candidate_reverses_orientation": maps.reverses_orientation,
        RECORD: np.frombuffer(json.dumps(record.__dict__).encode(), dtype=np.uint8),
    }


def load_candidate_maps(path: Path) -> CandidateMaps:
    """The candidates in the file of a pair.

    Raises:
        ArrayFileError: they cannot be read.
    """
    names = ("candidate_forward", "candidate_backward", "candidate_certainty", "candidate_reverses_orientation")
    arrays = read_arrays(path, names)
    if len(arrays) < len(names):
        raise ArrayFileError("it is not the map of a pair")
    forward, backward, certainty, reverses = (arrays[name] for name in names)
    return CandidateMaps(forward.astype(np.int64), backward.astype(np.int64), certainty, reverses)


def candidate_maps_of(result: MatchResult, summaries: tuple[ShapeSummary, ShapeSummary]) -> CandidateMaps:
    """The candidates of a match, between the samples that the shapes of a collection are known by."""
    candidates = result.candidates[:MAX_CANDIDATES]
    there = [_between_samples(result.pair, each, summaries) for each in candidates]
    return CandidateMaps(
        np.array([forward for forward, _ in there]),
        np.array([backward for _, backward in there]),
        np.array([each.certainty for each in candidates]),
        np.array([each.reverses_orientation for each in candidates]),
    )


def _between_samples(
    pair: Pair, candidate: Candidate, summaries: tuple[ShapeSummary, ShapeSummary]
) -> tuple[Integers, Integers]:
    """A candidate as maps between the samples that the shapes of a collection are known by, both ways.

    The match may have taken another body of a shape than was prepared, such as a skin around it; then samples go by
    what is nearest.
    """
    shapes = pair.source_shape, pair.target_shape
    search = [each.search for each in shapes]
    back = nearest_samples(search[1], search[0], candidate.reverse_functional_map)
    own = [surface_vertices(shape, each.samples) for shape, each in zip(shapes, search, strict=True)]
    numbers = [
        summary.number_of(vertices, surface)
        for summary, vertices, surface in zip(summaries, own, (pair.source, pair.target), strict=True)
    ]
    forward, backward = numbers[0][candidate.sample_map], numbers[1][back]
    return _at_samples(summaries[1], numbers[1], forward), _at_samples(summaries[0], numbers[0], backward)


def _at_samples(summary: ShapeSummary, numbers: Integers, images: Integers) -> Integers:
    """(s,) images at all samples of a shape, of those (q,) at samples with numbers (q,)."""
    if np.array_equal(numbers, np.arange(len(summary.samples))):
        return images
    near = cKDTree(summary.points[numbers]).query(summary.points)[1]
    return np.asarray(images[near])
