# SPDX-License-Identifier: GPL-3.0-or-later
"""One verdict on a finished map, from all that is known about it, with a sentence and what to do.

Green: use the map. Amber: look at the place that the sentence names. Red: the map is probably wrong as a whole.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from zoomout_core.mesh.errors import MeshError
from zoomout_core.messages import Message, message, probability, sentences
from zoomout_core.tuning import Tuning, tuned

GREEN, AMBER, RED = LEVELS = "green", "amber", "red"
# Beginning of a line with a verdict of each level.
PREFIXES = {GREEN: "Green:", AMBER: "Amber:", RED: "Red:"}

RIGHT = "The match is right as a whole ({certainty} certain)."
# Of six green maps of characters in other poses or builds, half of the doubtful vertices were off by more than 0.4 to
# 4 % of the height, and a tenth by more than 1 to 9 %.
RIGHT_BUT_FOR_DOUBTS = (
    "The match is right as a whole ({certainty} certain). On the doubtful {share:.0%} of the target, it may be off by "
    "several percent of the target's size."
)
WRONG = "The match is probably wrong: it is {certainty} certain."
UNCERTAIN = "The match may be wrong: it is {certainty} certain."
# The note of an uncertain match.
UNCERTAIN_MAP = (
    "This map is correct with a probability of only {certainty}: check whether sides are swapped, and if so, "
    "try another candidate or add landmarks."
)
UNPLACED = "The match is {certainty} certain, because {share:.0%} of the target has no certain place on the source."
SHATTERED = "The match is probably wrong: it tears apart {share:.0%} of the target."
TORN = "The match tears apart {share:.1%} of the target."
SILENT = (
    "{share:.1%} of the source's visible surface is on parts from which the target receives almost nothing reliable."
)
MIRRORED = "This match is a mirror image: it maps left to right."
DOUBTFUL = "{share:.0%} of the target is doubtful."
DOUBTFUL_VERTICES = "{share:.0%} of the target's vertices are doubtful."
ALONE = "{share:.0%} of the target has no partner on the source."
TRY_CANDIDATES = "Compare the other candidates, or add a few landmarks and match again."
LOOK_AT_SIDES = "Check whether sides are swapped; if so, choose another candidate or add landmarks."
LOOK_AT_TORN = "Look at the torn vertices, and add landmarks around them."
ONLY_IF_MIRRORED = "Use it only if the target is a mirror image of the source."
LOOK_AT_DOUBTFUL = "Look at the doubtful vertices, and add landmarks there, or transfer to the rest only."
LOOK_AT_PARTS = (
    "Look for parts of the source whose data the target lacks; add landmarks on them, or transfer them separately."
)
LOOK_AT_ALONE = "Look at the vertices without a partner, and check that the source lacks that part."


# Confidence below which a vertex is doubtful.
LOW_CONFIDENCE = 0.5
# Doubtful share of the target from which a green verdict mentions it, so that it does not round to 0%.
MENTIONED_DOUBTS = 0.005
# Certainties that differ by less are the same.
ROUNDING = 1e-9


@dataclass(frozen=True)
class VerdictTuning(Tuning, set_by="everywhere"):
    """Where a verdict changes its level."""

    certain: float = tuned(0.9, "probability", 0, 1)  # smallest certainty of a green map
    wrong: float = tuned(0.3, "probability", 0, 1)  # certainty below which a map is red
    torn: float = tuned(0.02, "1", 0, 1)  # largest part of the target's area at torn edges of a green map
    # Maximum certainty of a map of closed shapes that tears more than that. Of four such maps above 0.9, two are right
    # (gorillas, and dinosaurs of two species). Two of horses move 16 % of the vertices by more than 0.1. Thirteen right
    # maps of other animals and people tear 1.3 % at most.
    torn_certainty: float = tuned(0.8, "probability", 0, 1)
    # Largest part of the target's area that tears cut off from the rest of a certain map: it may be a limb on a wrong
    # limb. A horse cut in half has a foreleg, .095 of its area, on the other one. Tears of 32 right and certain maps of
    # cut shapes cut off .018 at most.
    torn_off: float = tuned(0.05, "1", 0, 1)
    shattered: float = tuned(0.2, "1", 0, 1)  # maps with a larger part are red
    silent: float = tuned(0.001, "1", 0, 1)  # part of the outside on parts that do not arrive, of an amber map
    doubtful: float = tuned(0.5, "1", 0, 1)  # largest part of the target's area of low confidence of a green map
    # The same part of its vertices, whose data is mostly filled in. Doubts at creases, where vertices are dense, have
    # little area: a wolf that was thinned with its hard edges split has .76 of its vertices, but .46 of its area.
    doubtful_vertices: float = tuned(0.5, "1", 0, 1)
    alone: float = tuned(0.1, "1", 0, 1)  # largest part of the target's area without a partner of a green map
    arrived: float = tuned(0.25, "1", 0, 1)  # of its visible share that a part of the source must have on the target
    # The same, if what arrives counts by its confidence. On characters of many parts, maps that are wrong there but
    # otherwise green have parts with .11 and .16. Right maps have .13 once, and otherwise at least .24.
    trusted: float = tuned(0.2, "1", 0, 1)
    visible: float = tuned(0.001, "1", 0, 1)  # smaller shares of the outside may be missing


VERDICT = VerdictTuning()


class Verdict(NamedTuple):
    """A verdict on a map.

    Attributes:
        level: "green", "amber" or "red".
        sentence: the reason, for the user.
        advice: what to do; empty when green.

    Example:
        >>> zo.Verdict("green", "The match is right as a whole (98% certain).", "").line
        'Green: The match is right as a whole (98% certain).'
    """

    level: str
    sentence: str
    advice: str

    @property
    def is_wrong(self) -> bool:
        """Whether the map is probably wrong as a whole."""
        return self.level == RED

    @property
    def line(self) -> Message:
        """The verdict in one line."""
        return sentences(PREFIXES[self.level], *filter(None, (self.sentence, self.advice)))


class Faults(NamedTuple):
    """Possible local faults of a map that is right as a whole.

    Attributes:
        torn: the part of the target's area at torn edges.
        silent: the part of the source's outside on parts from which the target receives almost nothing reliable.
        doubtful: the part of the target's area of low confidence. Faces and hands have most of the vertices of a body.
        alone: the part of the target's area without a partner.
        mirrored: the map reverses the orientation.
        unplaced: the part of the target's area without a known place, by which the certainty is lower.
        doubtful_vertices: the part of the target's vertices of low confidence.
    """

    torn: float = 0.0
    silent: float = 0.0
    doubtful: float = 0.0
    alone: float = 0.0
    mirrored: bool = False
    unplaced: float = 0.0
    doubtful_vertices: float = 0.0


NO_FAULTS = Faults()


def judge(certainty: float, faults: Faults = NO_FAULTS) -> Verdict:
    """The verdict on a map, from the probability that it is right as a whole, and its faults."""
    torn, silent, doubtful, alone, mirrored, unplaced, doubtful_vertices = faults
    # No other candidate is likely, and sides are not in doubt.
    only_unplaced = certainty < VERDICT.certain and certainty >= VERDICT.certain * (1 - unplaced)
    # No other candidate is likely, but the map is torn.
    only_torn = torn > VERDICT.torn and certainty >= VERDICT.torn_certainty * (1 - unplaced) - ROUNDING
    is_uncertain = certainty < VERDICT.certain and not only_torn
    many_vertices = doubtful_vertices > VERDICT.doubtful_vertices
    look_there = LOOK_AT_PARTS if silent >= VERDICT.silent else LOOK_AT_DOUBTFUL
    cases = (
        (certainty < VERDICT.wrong, RED, message(WRONG, certainty=probability(certainty)), TRY_CANDIDATES),
        (torn > VERDICT.shattered, RED, message(SHATTERED, share=torn), TRY_CANDIDATES),
        (only_unplaced, AMBER, message(UNPLACED, certainty=probability(certainty), share=unplaced), look_there),
        (is_uncertain, AMBER, message(UNCERTAIN, certainty=probability(certainty)), LOOK_AT_SIDES),
        (mirrored, AMBER, message(MIRRORED), ONLY_IF_MIRRORED),
        (silent >= VERDICT.silent, AMBER, message(SILENT, share=silent), LOOK_AT_PARTS),
        (torn > VERDICT.torn, AMBER, message(TORN, share=torn), LOOK_AT_TORN),
        (doubtful > VERDICT.doubtful, AMBER, message(DOUBTFUL, share=doubtful), LOOK_AT_DOUBTFUL),
        (many_vertices, AMBER, message(DOUBTFUL_VERTICES, share=doubtful_vertices), LOOK_AT_DOUBTFUL),
        (alone > VERDICT.alone, AMBER, message(ALONE, share=alone), LOOK_AT_ALONE),
    )
    for is_present, level, sentence, advice in cases:
        if is_present:
            return Verdict(level, sentence, message(advice))
    if doubtful >= MENTIONED_DOUBTS:
        return Verdict(GREEN, message(RIGHT_BUT_FOR_DOUBTS, certainty=probability(certainty), share=doubtful), "")
    return Verdict(GREEN, message(RIGHT, certainty=probability(certainty)), "")


class RefusedMatchError(MeshError):
    """A match that is probably wrong, along which nothing is written without the user's consent."""


def check_verdict(verdict: Verdict, force: bool, candidates: int = 1) -> None:
    """Refuse a match that is probably wrong, unless the user insists.

    Args:
        verdict: the verdict on it.
        force: whether the user insists.
        candidates: the number of maps that `--candidate` offers.

    Raises:
        RefusedMatchError: it is probably wrong, and may not be used anyway.
    """
    if verdict.is_wrong and not force:
        others = [message("Other candidates: --candidate 1 to {last}.", last=candidates - 1)] if candidates > 1 else []
        force_it = message("To write it anyway, give --force.")
        raise RefusedMatchError(sentences(verdict.sentence, verdict.advice, *others, force_it))


def worst(verdicts: Sequence[Verdict]) -> Verdict:
    """The first of the verdicts of the highest level, such as of several targets."""
    return max(verdicts, key=lambda verdict: LEVELS.index(verdict.level))


def select_notes(notes: Iterable[str], verdict: Verdict | None) -> list[str]:
    """The notes that do not repeat the certainty in a verdict that is shown, too."""
    return [note for note in notes if verdict is None or getattr(note, "template", None) != UNCERTAIN_MAP]
