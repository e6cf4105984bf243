# SPDX-License-Identifier: GPL-3.0-or-later
"""The map of a pair of a collection: made, written atomically, and read again on the next run."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.collection.shapes import ShapeSummary
from zoomout_core.maps.upsample import nearest_samples
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.report.verdict import Faults
from zoomout_core.matching.result import MatchResult
from zoomout_core.messages import from_json, to_json
from zoomout_core.runtime.array_files import ArrayFileError, read_arrays

# Number of candidates kept for each pair.
MAX_CANDIDATES = 8
RECORD = "record"


class PairName(NamedTuple):
    """A pair of shapes, by their names: the map starts on the target and lands on the source.

    For the user it leads from the source, which has the data, to the target.
    """

    source: str
    target: str

    def __str__(self) -> str:
        return f"{self.source} to {self.target}"


@dataclass(frozen=True, eq=False)
class CandidateMaps:
    """The candidate maps of a pair, between the samples of both shapes, most likely first.

    Attributes:
        forward: (m, s_t) the source sample of each sample of the target.
        backward: (m, s_s) the target sample of each sample of the source.
        certainty: (m,) probability of each among the candidates that treat the orientation alike.
        reverses_orientation: (m,) whether each reverses the orientation.
    """

    forward: Integers
    backward: Integers
    certainty: Floats
    reverses_orientation: Booleans

    def with_another(self, forward: Integers, backward: Integers, certainty: float) -> CandidateMaps:
        """These candidates, and one more map at the end, which treats the orientation like the first."""
        return CandidateMaps(
            np.vstack([self.forward, forward]),
            np.vstack([self.backward, backward]),
            np.append(self.certainty, certainty),
            np.append(self.reverses_orientation, self.reverses_orientation[0]),
        )


@dataclass(frozen=True)
class PairRecord:
    """How the match of a pair went, in values that JSON can store.

    Attributes:
        key: a hash of both files and the options.
        certainty: probability that the map is right as a whole.
        mean_confidence: mean confidence of its vertices.
        low_confidence: the part of the target's area of low confidence.
        share_without_partner: share of the target's area without a partner.
        source_share_without_partner: share of the source's area without a partner.
        candidates: how many maps were found.
        candidate: which of them this is.
        through: the shape that the map was composed through, if no candidate agreed with the other pairs.
        notes: sentences for the user.
        seconds: duration of the match.
        torn: share of the target's area at which the map is torn.
        silent: share of the source's outside on parts from which the target receives almost nothing reliable.
        mirrored: whether the map reverses the orientation.
        doubtful_vertices: the part of the target's vertices of low confidence.
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
    torn: float = 0.0
    silent: float = 0.0
    mirrored: bool = False
    doubtful_vertices: float = 0.0

    @property
    def faults(self) -> Faults:
        """The faults that the verdict on the map depends on."""
        return Faults(
            self.torn,
            self.silent,
            self.low_confidence,
            self.share_without_partner,
            self.mirrored,
            doubtful_vertices=self.doubtful_vertices,
        )

    @classmethod
    def load(cls, path: Path) -> PairRecord:
        """The record in the file of a map.

        Raises:
            FileNotFoundError: the file is missing.
            ArrayFileError: it cannot be read.
        """
        arrays = read_arrays(path, (RECORD,))
        try:
            held = from_json(json.loads(arrays[RECORD].tobytes()))
            return cls(**{**held, "notes": tuple(held["notes"])})
        except (KeyError, TypeError, ValueError) as error:
            raise ArrayFileError("it is not the map of a pair") from error


def arrays_of(result: MatchResult, maps: CandidateMaps, key: str, seconds: float, through: str = "") -> dict[str, Any]:
    """Data stored with the map of a pair: see `zoomout match`, `CandidateMaps` and `PairRecord`."""
    faults = result.faults
    record = PairRecord(
        key=key,
        certainty=result.certainty,
        mean_confidence=float(result.confidence.mean()),
        low_confidence=faults.doubtful,
        share_without_partner=faults.alone,
        source_share_without_partner=result.source_share_without_partner,
        candidates=len(result.candidates),
        candidate=result.chosen,
        through=through,
        notes=result.notes,
        seconds=seconds,
        torn=faults.torn,
        silent=faults.silent,
        mirrored=faults.mirrored,
        doubtful_vertices=faults.doubtful_vertices,
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
        RECORD: np.frombuffer(json.dumps(to_json(record.__dict__)).encode(), dtype=np.uint8),
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


def candidate_maps_of(result: MatchResult, summaries: Sequence[ShapeSummary]) -> CandidateMaps:
    """The candidates of a match, as maps between the samples of the summaries of its source and target."""
    candidates = result.candidates[:MAX_CANDIDATES]
    forward, backward = zip(*(_between_samples(result.pair, each, summaries) for each in candidates), strict=True)
    return CandidateMaps(
        np.array(forward),
        np.array(backward),
        np.array([each.certainty for each in candidates]),
        np.array([each.reverses_orientation for each in candidates]),
    )


def _between_samples(pair: Pair, candidate: Candidate, summaries: Sequence[ShapeSummary]) -> tuple[Integers, Integers]:
    """A candidate as maps between the samples of two summaries, in both directions.

    The match may have used another body of a shape than was prepared, such as the hull around it. Then samples are
    assigned to the nearest vertices.
    """
    back = nearest_samples(pair.target_shape.search, pair.source_shape.search, candidate.reverse_functional_map)
    source, target = summaries
    on_source = source.number_of(pair.source_shape.surface_vertex[pair.source_shape.search.samples], pair.source)
    on_target = target.number_of(pair.target_shape.surface_vertex[pair.target_shape.search.samples], pair.target)
    forward, backward = on_source[candidate.sample_map], on_target[back]
    return _at_samples(target, on_target, forward), _at_samples(source, on_source, backward)


def _at_samples(summary: ShapeSummary, numbers: Integers, images: Integers) -> Integers:
    """(s,) images at all samples of a shape, from the images (q,) at samples with numbers (q,)."""
    if np.array_equal(numbers, np.arange(len(summary.samples))):
        return images
    near = cKDTree(summary.points[numbers]).query(summary.points)[1]
    return np.asarray(images[near])
