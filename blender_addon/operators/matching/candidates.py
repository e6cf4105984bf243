# SPDX-License-Identifier: GPL-3.0-or-later
"""Use another candidate of a match: the one with swapped sides, the next, or any in the list.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import IntProperty
from bpy.types import Context

import zoomout_core as zo
from zoomout_core.messages import message

from ... import services
from ...storage import stored_match
from ...storage.stored_candidates import CandidateList
from ..base.modal_operator import ModalOperator


class CandidateOperator(ModalOperator):
    """The base of operators that put another candidate in place of the stored match."""

    def place(self, listing: CandidateList) -> int:
        """The index of the candidate to use.

        Raises:
            MeshError: there is no such candidate.
        """
        raise NotImplementedError

    async def work(self, context: Context) -> str:
        target = context.active_object
        place = self.place(services.matching.use_candidate.stored_list(target))
        result = await services.matching.use_candidate.use_candidate_async(context, target.name, place)
        doubtful = stored_match.low_confidence(result.confidence)
        return message(
            "'{target}' uses candidate {number}; {doubtful:,} of {vertices:,} vertices are doubtful",
            target=target.name,
            number=place + 1,
            doubtful=doubtful,
            vertices=len(result.confidence),
        )


class ZOOMOUT_OT_use_candidate(CandidateOperator):
    bl_idname = "zoomout.use_candidate"
    bl_label = "Use Candidate"
    bl_description = (
        "Replace the match with this candidate. The number is the probability that it is correct; mirrored "
        "candidates are for targets that are mirror images of the source"
    )
    bl_options = {"REGISTER", "UNDO"}

    candidate: IntProperty(
        name="Candidate",
        description="Number in the list, starting at 1; 0 uses the candidate after the current one",
        default=0,
        min=0,
        options={"SKIP_SAVE"},
    )

    def place(self, listing: CandidateList) -> int:
        if self.candidate > len(listing.candidates):
            raise zo.MeshError(
                "There is no candidate {number}: the list has {count}.",
                number=self.candidate,
                count=len(listing.candidates),
            )
        return self.candidate - 1 if self.candidate else (listing.chosen + 1) % len(listing.candidates)


class ZOOMOUT_OT_swap_match_sides(CandidateOperator):
    bl_idname = "zoomout.swap_match_sides"
    bl_label = "Swap Sides of Match"
    bl_description = "Use the candidate with left and right swapped"
    bl_options = {"REGISTER", "UNDO"}

    def place(self, listing: CandidateList) -> int:
        swapped = services.matching.candidates.side_swapped_candidate(listing)
        if swapped is None:
            raise zo.MeshError(
                "None of the candidates swaps the sides: place a landmark on one side, then match again."
            )
        return swapped
