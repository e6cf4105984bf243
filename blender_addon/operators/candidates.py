"""Use another one of the maps that a match found: the one with the sides swapped, the next, or any of the list.

Property annotations are read by Blender as they are, so this module does without postponed evaluation.
"""

from dataclasses import replace

from bpy.props import IntProperty
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.runtime.stepping import Steps, drain, within

from ..services.constraints import matching_steps
from ..services.pair import ObjectPair, check_unedited, find_mesh
from ..storage import candidates, stored_match
from ..storage.candidates import Listing
from ..storage.stored_match import read_kept_steps
from ..viewport import preview
from .stepped import SteppedOperator

# Part of the progress that matching anew takes, where results are no longer held in memory.
MATCHING = 0.7


class CandidateOperator(SteppedOperator):
    """The base of operators that put another candidate in the place of the match that is kept."""

    def place(self, listing: Listing) -> int:
        """Which candidate of a list to use.

        Raises:
            MeshError: there is none such.
        """
        raise NotImplementedError

    def steps(self, context: Context) -> Steps[str]:
        target = context.active_object
        place = self.place(_listing(target))
        result = yield from use_candidate_steps(context, target.name, place)
        doubtful = stored_match.low_confidence(result.confidence)
        return (
            f"'{target.name}' uses candidate {place + 1}; "
            f"{doubtful} of {len(result.confidence)} vertices are of low confidence"
        )


class ZOOMOUT_OT_use_candidate(CandidateOperator):
    bl_idname = "zoomout.use_candidate"
    bl_label = "Use Candidate"
    bl_description = (
        "Put this one of the maps that were found in the place of the match. The number is how likely it is right; "
        "mirrored ones are for a target that is a mirror image"
    )
    bl_options = {"REGISTER", "UNDO"}

    candidate: IntProperty(
        name="Candidate",
        description="Number in the list, from 1; at 0 the one after the one that is used",
        default=0,
        min=0,
        options={"SKIP_SAVE"},
    )

    def place(self, listing: Listing) -> int:
        if self.candidate > len(listing.candidates):
            raise zo.MeshError(f"There is no candidate {self.candidate}: {len(listing.candidates)} are listed.")
        return self.candidate - 1 if self.candidate else (listing.chosen + 1) % len(listing.candidates)


class ZOOMOUT_OT_swap_match_sides(CandidateOperator):
    bl_idname = "zoomout.swap_match_sides"
    bl_label = "Swap Sides of Match"
    bl_description = "Use the map that has left and right the other way round"
    bl_options = {"REGISTER", "UNDO"}

    def place(self, listing: Listing) -> int:
        swapped = listing.swapped()
        if swapped is None:
            raise zo.MeshError("None of the candidates swaps the sides: set a landmark on one side, then match again.")
        return swapped


def use_candidate(context: Context, target: Object, place: int) -> zo.MatchResult:
    """Put another candidate in the place of the match that is kept on a target.

    Args:
        context: Blender's; the target and its source are in its scene.
        target: was matched.
        place: of the candidate in the list, see `candidates.read`.

    Raises:
        MeshError: there is no match, or one of them was edited since; nothing was written.
    """
    return drain(use_candidate_steps(context, target.name, place))


def use_candidate_steps(context: Context, target_name: str, place: int) -> Steps[zo.MatchResult]:
    """`use_candidate` as a generator, which holds no Blender data while it is suspended."""
    target = find_mesh(context, target_name)
    listing = _listing(target)
    note = f"Candidate {place + 1} of {len(listing.candidates)} was chosen."
    with preview.foreseen(target, listing, place):
        pair, kept = yield from read_kept_steps(context, target_name)
        result = yield from _result_steps(context, pair, listing, place, kept)
        result = replace(result, notes=(note, *result.notes))
        following = yield from preview.following_steps(context, pair, result)
        _, target = check_unedited(context, pair)
    stored_match.write(target.data, result, pair, kept.settings)
    if following is not None:
        preview.show(following)
    return result


def _result_steps(
    context: Context, pair: ObjectPair, listing: Listing, place: int, kept: stored_match.StoredMatch
) -> Steps[zo.MatchResult]:
    """The result of a candidate; where it is not held in memory, the two are matched anew, as they were before."""
    if candidates.is_held(listing):
        return (yield from candidates.result_steps(listing, place))
    settings = kept.settings | {"initial": "auto", "from_last": False}
    settings.pop(stored_match.LANDMARKS, None)
    anew = yield from within(matching_steps(context, pair, **settings), 0, MATCHING)
    assert isinstance(anew, zo.MatchResult)  # an automatic start
    found = candidates.listing_of(anew, pair)
    candidates.hold(found.key, anew)
    alike = candidates.most_alike(place, listing, found)
    return (yield from within(candidates.result_steps(found, alike), MATCHING, 1))


def _listing(target: Object) -> Listing:
    listing = candidates.read(target.data)
    if listing is None:
        raise zo.MeshError(f"There are no candidates for '{target.name}': match it first.")
    return listing
