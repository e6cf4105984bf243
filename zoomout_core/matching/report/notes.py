# SPDX-License-Identifier: GPL-3.0-or-later
"""Notes for the user about a match."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.ranking.certainty import certainty_but_for_turns
from zoomout_core.matching.ranking.rotational_symmetry import likely_turns
from zoomout_core.matching.refinement.confidence import Partners
from zoomout_core.matching.report.verdict import UNCERTAIN_MAP, VERDICT
from zoomout_core.mesh.point_cloud import PointCloud
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import plural, probability, warning

NOT_RECOGNISED = (
    "No reliable match was found (a probability of {certainty}): add a few landmarks, or align the two meshes in "
    "the same pose and start from nearest points."
)
TURNED = (
    "The shape looks the same when rotated: at least {turns} maps fit as well as this one, which is correct with a "
    "probability of only {certainty}; try another candidate, or add landmarks that tell them apart."
)
FLIPPED = (
    "The map flips {share:.0%} of the target's surface, where the two shapes differ too much: its vertices are "
    "doubtful there."
)
OTHER_UNITS = "The two meshes differ greatly in size: if one is a part of the other, scale both to the same unit."
RESCALED = "The two meshes seem to use different units: the target was scaled by {times:.3g} for the match."
MISSED_LANDMARKS = (
    "The map contradicts {count} of the {total} landmarks: check that each pair is the same place on both shapes, with "
    "the source first."
)
TARGET_ALONE = "About {share:.0%} of the target has no partner on the source: its vertices are doubtful there."
SOURCE_ALONE = "About {share:.0%} of the source has no partner on the target: nothing was matched to it."

# Certainty (probability) below which the shapes count as not recognised.
RECOGNISED_CERTAINTY = 0.1
# Shares of a surface's area that are reported if larger: flipped by the map, or without a partner.
MAX_FLIPPED_SHARE = 0.05
MAX_UNMATCHED_SHARE = 0.03
# Distance between a map and a landmark, at unit area, above which the map contradicts the landmark: about a forearm of
# a human.
MAX_LANDMARK_ERROR = 0.2
# Rounding of coordinates, in edge lengths, above which it is reported. Maps at this value were off by a thousandth of
# the square root of the area, and by five thousandths at 0.9.
MAX_ROUNDING = 0.2


def notes_on_input(role: str, shape: Surface | PointCloud, surface: Surface) -> tuple[str, ...]:
    """Notes on the limits of one input shape, and of the surface that was reconstructed from it."""
    return (
        *notes_on_cloud(role, shape, surface),
        *_notes_on_rounding(role, surface),
        *_notes_on_broken_vertices(role, surface),
    )


def notes_on_cloud(role: str, shape: Surface | PointCloud, surface: Surface) -> tuple[str, ...]:
    """Notes on the limits of a point cloud."""
    if not isinstance(shape, PointCloud):
        return ()
    left_out = int((surface.working.vertex_of < 0).sum())
    notes = (
        (
            shape.normals is None and not surface.working.sides_are_known,
            f"The {role} is an open point cloud without normals, so its outside is unknown and this map may be "
            "mirrored: compare the other candidates.",
        ),
        (
            left_out > MAX_UNMATCHED_SHARE * len(shape.points),
            f"{left_out:,} of the {role}'s points are noise or differ in density, and were left out of the "
            "reconstructed surface.",
        ),
    )
    return tuple(warning(text) for true, text in notes if true)


def _notes_on_rounding(role: str, surface: Surface) -> tuple[str, ...]:
    """A note if coordinates are so far from the origin that their rounding is a notable part of an edge."""
    if surface.rounding_of_edges < MAX_ROUNDING:
        return ()
    return (
        warning(
            f"The {role} is so far from its origin that its coordinates are rounded by {{share:.0%}} of an edge "
            "length: move it to the origin in the program that created it.",
            share=surface.rounding_of_edges,
        ),
    )


def _notes_on_broken_vertices(role: str, surface: Surface) -> tuple[str, ...]:
    """A note on vertices that are not numbers; they have no faces, or the surface would have been refused."""
    count = int(np.isnan(surface.vertices).any(axis=1).sum())
    if not count:
        return ()
    return (
        plural(
            count,
            f"1 vertex of the {role} is not a number: it and its faces are left out.",
            f"{{count:,}} vertices of the {role} are not numbers: they and their faces are left out.",
        ),
    )


def notes_on_map(candidates: Sequence[Candidate], chosen: int, placed: float, flipped: float) -> tuple[str, ...]:
    """Notes on doubts about a map as a whole, the chosen one of all candidates.

    A part `placed` of the target's area has a partner, and the map flips a part `flipped` of it.
    """
    notes: tuple[str, ...] = (warning(FLIPPED, share=flipped),) if flipped > MAX_FLIPPED_SHARE else ()
    certainty = candidates[chosen].certainty * placed
    if certainty >= VERDICT.certain:
        return notes
    turns = likely_turns(candidates, chosen)
    if turns > 1 and certainty_but_for_turns(candidates) * placed >= RECOGNISED_CERTAINTY:
        return (warning(TURNED, turns=turns, certainty=probability(certainty)), *notes)
    doubt = UNCERTAIN_MAP if certainty >= RECOGNISED_CERTAINTY else NOT_RECOGNISED
    return (warning(doubt, certainty=probability(certainty)), *notes)


def notes_on_landmarks(errors: Floats) -> tuple[str, ...]:
    """A note if the map contradicts landmarks, from the distances (l,) at unit area by which it misses them."""
    count = int((errors > MAX_LANDMARK_ERROR).sum())
    return (warning(MISSED_LANDMARKS, count=count, total=len(errors)),) if count else ()


def notes_on_rest(pair: Pair, partners: Partners) -> tuple[str, ...]:
    """Notes on parts that only one of the two surfaces has."""
    rests = (TARGET_ALONE, pair.target, partners.target), (SOURCE_ALONE, pair.source, partners.source)
    shares = ((text, surface.share_of_area(~has_partner)) for text, surface, has_partner in rests)
    return tuple(warning(text, share=share) for text, share in shares if share > MAX_UNMATCHED_SHARE)
