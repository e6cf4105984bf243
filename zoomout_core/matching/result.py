# SPDX-License-Identifier: GPL-3.0-or-later
"""The result of a match: the map of one candidate with its confidence, verdict and alternatives."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from numbers import Integral
from os import PathLike

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.maps.anchors import Anchors
from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.components.lift import lift
from zoomout_core.matching.constraints import meet_exact_landmarks
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape
from zoomout_core.matching.partial.part_candidates import PartCandidate
from zoomout_core.matching.partial.part_registration import RegisteredPart
from zoomout_core.matching.partial.region import Region
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.proxy import Proxy
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import certainty_of_torn, is_closed
from zoomout_core.matching.refinement.dense_map import dense_map
from zoomout_core.matching.refinement.repair import repair
from zoomout_core.matching.report.notes import notes_on_map, notes_on_rest
from zoomout_core.matching.report.verdict import LOW_CONFIDENCE, VERDICT, Faults, Verdict, judge
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.messages import probability
from zoomout_core.runtime.array_files import ArrayFileError, read_arrays
from zoomout_core.runtime.object_files import fields_of, load_object, save_object
from zoomout_core.runtime.progress import stage
from zoomout_core.runtime.summary import Summary
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.spectral.eigenbasis import SpectralBasis

# Mean confidence below which a loose part is lost: its place on the source is unknown. On 22 pairs of game characters,
# 38 % of the area of parts below .1 is on the wrong limb. Of pieces of 12 people and animals from which slabs were cut,
# five of six below .15 were in a wrong place, and none of 14 above, which had .35 at least.
LOST = 0.15
# Visible share of loose parts below which they are details: if other parts of the same name arrive, losing them is no
# fault. A character of many parts loses pieces of 0.2 % of its skin; eyes and glasses have names of their own.
MAX_DETAIL = 0.005


@dataclass(frozen=True, eq=False, repr=False)
class MatchResult(Summary):
    """A map from the target to the source, with its confidence, verdict and alternatives.

    Attributes:
        surface_map: for every target vertex a point on the source surface.
        confidence: (n_t,) in [0, 1]. It is 0 where the map was not computed but taken from nearby, and small on parts
            that tears cut off from the rest.
        has_partner: (n_t,) whether a vertex of the target has a partner on the source. A part without one, such as
            a tail that the source lacks, maps to where its surroundings do. True for vertices without a face.
        source_has_partner: (n_s,) the same for the source's vertices.
        functional_map: (k_target, k_source) between the bases of the main parts.
        candidates: all maps that were found, the most likely first.
        chosen: number of the candidate that this result was computed from.
        notes: sentences for the user.
        pair: the analysed surfaces, from which results of other candidates are computed.
        placed: the share of the target's area, in [0, 1], that has a partner and a known place, so is neither cut off
            by tears nor a loose part of very low confidence.
        filled: (n_t,) vertices at which the map was torn, and whose images were filled in from their surroundings.
        torn: (n_t,) vertices at which the map is torn still, and those on parts that tears cut off.
        names: (c,) number of the name of each of the source's components; None if they have none.

    Example:
        >>> result.surface_map.interpolate(source.vertices).shape == target.vertices.shape
        True
    """

    surface_map: SurfaceMap
    confidence: Floats
    has_partner: Booleans
    source_has_partner: Booleans
    functional_map: Floats
    candidates: tuple[Candidate, ...]
    chosen: int
    notes: tuple[str, ...]
    pair: Pair
    placed: float
    filled: Booleans
    torn: Booleans
    names: Integers | None = field(default=None, kw_only=True)

    @property
    def source(self) -> Surface:
        """The surface that the map lands on."""
        return self.pair.source

    @property
    def target(self) -> Surface:
        """The surface that the map starts from."""
        return self.pair.target

    @property
    def certainty(self) -> float:
        """Probability that the map as a whole is right: no sides swapped, and not turned front to back.

        It refers to the whole target, and decreases with the area that has no partner or no known place. No map that
        tears closed shapes is certain.
        """
        return self.candidates[self.chosen].certainty * self.placed

    @property
    def share_without_partner(self) -> float:
        """The part of the target's area, in [0, 1], to which nothing on the source corresponds."""
        return self.pair.target.share_of_area(~self.has_partner)

    @property
    def source_share_without_partner(self) -> float:
        """The part of the source's area, in [0, 1], to which nothing on the target corresponds."""
        return self.pair.source.share_of_area(~self.source_has_partner)

    @property
    def arrived(self) -> Floats:
        """(c,) the part of the target's area that receives from each component of the source."""
        return self._receiver_areas(np.ones(len(self.confidence)))

    @property
    def silent(self) -> Integers:
        """(s,) the components of the source that its outside shows, but from which the target hardly receives."""
        visible, arrived = self.pair.shares, self.arrived[: len(self.pair.shares)]
        return np.flatnonzero((visible >= VERDICT.visible) & (arrived < VERDICT.arrived * visible))

    @property
    def uncertain(self) -> Integers:
        """(u,) the components that the source shows on its outside, but whose partners on the target are doubtful.

        These include the silent ones. What arrives is weighted by its confidence.
        """
        return np.flatnonzero(self._is_uncertain(np.arange(len(self.pair.shares))))

    @property
    def missed(self) -> Integers:
        """(m,) the uncertain components that are a fault: all but a few details of names that arrive."""
        uncertain = self.uncertain
        if self.names is None:
            return uncertain
        shares = self.pair.shares[uncertain]
        is_detail = (shares < MAX_DETAIL) & ~self._is_uncertain(self.names)[self.names[uncertain]]
        return uncertain if shares[is_detail].sum() >= MAX_DETAIL else uncertain[~is_detail]

    def _is_uncertain(self, group: Integers) -> Booleans:
        """Whether the outside shows groups of components (c,), from which the target receives little for certain."""
        count = len(self.pair.shares)
        visible, arrived, trusted = (
            np.bincount(group, areas[:count])
            for areas in (self.pair.shares, self.arrived, self._receiver_areas(self.confidence))
        )
        little = (arrived < VERDICT.arrived * visible) | (trusted < VERDICT.trusted * visible)
        return np.asarray((visible >= VERDICT.visible) & little)

    def _receiver_areas(self, weights: Floats) -> Floats:
        """(c,) the part of the target's area, times weights (n_t,), that receives from each component of the source."""
        component, areas = self.source.components[self.surface_map.vertex], self.target.vertex_areas
        received = np.bincount(component, areas * weights, len(self.pair.shares))
        return np.asarray(received / np.bincount(component, areas).sum())

    @property
    def faults(self) -> Faults:
        """The faults of the map that its verdict depends on, besides its certainty."""
        is_doubtful = self.confidence < LOW_CONFIDENCE
        return Faults(
            torn=self.target.share_of_area(self.torn),
            silent=float(self.pair.shares[self.missed].sum()),
            doubtful=self.target.share_of_area(is_doubtful),
            alone=self.share_without_partner,
            mirrored=self.candidates[self.chosen].reverses_orientation,
            unplaced=1 - self.placed,
            doubtful_vertices=float(is_doubtful.mean()),
        )

    @property
    def verdict(self) -> Verdict:
        """Whether to use the map, to check a place of it, or to try another one."""
        return judge(self.certainty, self.faults)

    def _summary(self) -> dict[str, str]:
        candidate, without = self.candidates[self.chosen], self.share_without_partner
        mean, low = self.confidence.mean(), (self.confidence < LOW_CONFIDENCE).mean()
        return {
            "source": f"{len(self.pair.source.vertices):,} vertices",
            "target": f"{len(self.pair.target.vertices):,} vertices, {without:.1%} of its area without a partner",
            "verdict": self.verdict.line,
            "certainty": probability(self.certainty),
            "confidence": f"{mean:.2f} on average; {low:.1%} of the vertices are doubtful (below {LOW_CONFIDENCE})",
            "candidate": f"{self.chosen} of {len(self.candidates)}, from {candidate.origin}",
            "notes": " ".join(self.notes) or "none",
        }

    def outline(self, candidate: int) -> tuple[Integers, Integers]:
        """Rough images of a candidate, before its full map is computed.

        Returns (s,) some vertices of the target's main part, the same for all candidates, and (s,) a vertex of the
        source for each of them.
        """
        return outline(self.pair, self.candidates[candidate].sample_map)

    @memory_in_words
    @on_one_blas_thread
    def use(self, candidate: int) -> MatchResult:
        """The result of another candidate, by its number.

        Raises:
            ValueError: there is no such candidate.

        Example:
            >>> result.use(1).chosen  # the map with left and right exchanged, for example
            1
        """
        if not (isinstance(candidate, Integral) and 0 <= candidate < len(self.candidates)):
            raise ValueError(f"There is no candidate {candidate!r}: they are numbered 0 to {len(self.candidates) - 1}.")
        return replace(make_result(self.pair, self.candidates, candidate), names=self.names)

    def meet_landmarks(self, surface_map: SurfaceMap) -> SurfaceMap:
        """Bend a map that was corrected later to the exact landmarks, if the match has any."""
        return meet_exact_landmarks(surface_map, self.pair)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the whole result, other candidates included, to an .npz file that `load_result` reads.

        Raises:
            OutputError: the file cannot be written.

        Example:
            >>> result.save(folder / "result.npz")
            >>> again = zo.load_result(folder / "result.npz")
        """
        save_object(path, self, STORED)


def check_result(result: object) -> None:
    """Raise a TypeError unless a user's result is one of `match`."""
    if not isinstance(result, MatchResult):
        raise TypeError(f"A result of `match` is needed, not a {type(result).__name__}.")


def outline(pair: Pair, sample_map: Integers) -> tuple[Integers, Integers]:
    """(s,) some vertices of the target's main part, and (s,) vertices of the source near their images.

    The map (s,) gives the number of the source sample of each search sample.
    """
    source, target = pair.source_shape, pair.target_shape
    images = source.search.samples[sample_map]
    return target.surface_vertex[target.search.samples], source.surface_vertex[images]


def load_result(path: str | PathLike[str]) -> MatchResult:
    """Read a result that `MatchResult.save` has written.

    Raises:
        FileNotFoundError: there is no such file.
        MeshError: it contains no result, or one of another version.

    Example:
        >>> result.save(folder / "result.npz")
        >>> zo.load_result(folder / "result.npz").certainty == result.certainty
        True
    """
    try:
        result = load_object(path, STORED)
    except ArrayFileError as error:
        with suppress(ArrayFileError):
            if len(read_arrays(path, ("triangle", "barycentric"))) == 2:
                raise MeshError(f"{path} is a map, not a result: use zo.SurfaceMap.load(path, source).") from error
        raise MeshError(f"{path} is not a saved result ({error}): save one with `result.save(path)`.") from error
    if not isinstance(result, MatchResult):
        raise MeshError(f"{path} is not a saved result: save one with `result.save(path)`.")
    return result


# The classes that a stored result consists of.
STORED = {
    Surface: ("vertices", "corner_vertex", "face_start", "triangle_corners", "_edges", "_working", "_rounding"),
    **fields_of(
        MatchResult,
        SurfaceMap,
        Candidate,
        Anchors,
        Pair,
        ShapeAnalysis,
        Proxy,
        WorkingMesh,
        SpectralBasis,
        SampledBasis,
        PartCandidate,
        Region,
        IncompleteShape,
        RegisteredPart,
    ),
}


def make_result(pair: Pair, candidates: tuple[Candidate, ...], chosen: int) -> MatchResult:
    """Refine a candidate, by its number, and lift its map to the whole surfaces."""
    with stage("Refining", 0.0, 0.8):
        dense = dense_map(pair, candidates[chosen])
    with stage("Extending to all vertices", 0.8, 0.95):
        whole = lift(pair, dense.fit, dense.confidence, dense.partners)
        surface_map = meet_exact_landmarks(whole.surface_map, pair)
    with stage("Repairing torn places", 0.95, 1.0):
        is_part = candidates[chosen].part_match is not None
        repaired = repair(pair, surface_map, whole.partners.target if is_part else None)
    confidence, cut_off = whole.confidence * repaired.connected, repaired.connected < LOW_CONFIDENCE
    lost = _on_lost_parts(pair.target, whole.confidence)
    torn_off = pair.target.share_of_area(cut_off & ~lost)
    placed = min(whole.placed, 1 - pair.target.share_of_area(lost)) * (1 - torn_off)
    candidates = _doubt_torn(pair, candidates, chosen, pair.target.share_of_area(repaired.torn), torn_off)
    doubts = notes_on_map(candidates, chosen, placed, dense.flipped)
    return MatchResult(
        surface_map=repaired.surface_map,
        confidence=confidence,
        has_partner=whole.partners.target,
        source_has_partner=whole.partners.source,
        functional_map=dense.functional_map,
        candidates=candidates,
        chosen=chosen,
        notes=(*doubts, *notes_on_rest(pair, whole.partners), *whole.notes, *pair.notes),
        pair=pair,
        placed=placed,
        filled=repaired.filled,
        torn=repaired.torn | cut_off,
    )


def _doubt_torn(
    pair: Pair, candidates: tuple[Candidate, ...], chosen: int, torn: float, torn_off: float
) -> tuple[Candidate, ...]:
    """The candidates, with a lower certainty of the chosen one if its map is torn; see `certainty_of_torn`."""
    closed = is_closed(pair.source_shape) and is_closed(pair.target_shape)
    certainty = certainty_of_torn(candidates[chosen].certainty, torn, torn_off, closed)
    if certainty == candidates[chosen].certainty:
        return candidates
    return (*candidates[:chosen], replace(candidates[chosen], certainty=certainty), *candidates[chosen + 1 :])


def _on_lost_parts(surface: Surface, confidence: Floats) -> Booleans:
    """(n,) the vertices on loose parts whose place is unknown, by the confidence (n,); the largest part is known."""
    component, areas = np.maximum(surface.components, 0), surface.vertex_areas
    mean = np.bincount(component, areas * confidence) / np.maximum(np.bincount(component, areas), 1e-300)
    return np.asarray((mean < LOST)[component] & (component > 0))
