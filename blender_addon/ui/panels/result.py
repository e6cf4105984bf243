# SPDX-License-Identifier: GPL-3.0-or-later
"""Subpanel of the match: its result, previews in the viewport, and other candidates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from bpy.types import Context, Panel, UILayout

from zoomout_core.matching.ranking import candidate_differences
from zoomout_core.matching.report.verdict import VERDICT, select_notes
from zoomout_core.messages import is_warning, message

from ... import services
from ...operators.matching.candidates import ZOOMOUT_OT_swap_match_sides, ZOOMOUT_OT_use_candidate
from ...operators.matching.select_faults import (
    ZOOMOUT_OT_select_doubtful,
    ZOOMOUT_OT_select_flipped,
    ZOOMOUT_OT_select_torn,
    ZOOMOUT_OT_select_without_partner,
)
from ...storage import stored_candidates, stored_match
from ...storage.stored_candidates import CandidateList
from ...translations import translated
from ...viewport import preview
from ..thumbnails import icon_of_candidate, icon_of_source
from .match import ZOOMOUT_PT_match
from .sidebar import (
    SidebarPanel,
    draw_notes,
    explain_hidden_preview,
    preview_buttons,
    sentences,
    show_findings,
)

# From this fraction of either surface's area on, a missing partner is mentioned.
TOLD = 0.005
# Names of the panels of candidates and notes: Blender remembers by these whether a panel is open.
CERTAIN, UNCERTAIN, NOTES = "zoomout_candidates_certain", "zoomout_candidates_uncertain", "zoomout_notes"
# Size of a thumbnail in icons: as high as a button and a label, so that four candidates leave Transfer on a screen of
# 880 pixels; and its share of the panel's width.
PICTURE, PICTURED = 2.0, 0.25
# Differences of a candidate from the most likely one.
DIFFERENCES = {
    candidate_differences.BEST: "Most Likely",
    candidate_differences.MIRROR: "Mirror Image",
    candidate_differences.SIDES: "Sides Swapped",
    candidate_differences.FRONT: "Front and Back",
    candidate_differences.AROUND: "Turned Around",
    candidate_differences.UPSIDE_DOWN: "Upside Down",
    candidate_differences.ARMS: "Arms Swapped",
    candidate_differences.LEGS: "Legs Swapped",
    candidate_differences.LIMBS: "Limbs Swapped",
    candidate_differences.TOP: "Top Differs",
    candidate_differences.BOTTOM: "Bottom Differs",
}
# Words for the probability of a candidate, from a probability on.
WORDS = ((VERDICT.certain, "Certain"), (0.5, "Likely"), (0.1, "Possible"), (0.0, "Unlikely"))
# Labels of the buttons that select elements.
SELECTED = {
    ZOOMOUT_OT_select_doubtful: "Doubtful",
    ZOOMOUT_OT_select_flipped: "Flipped",
    ZOOMOUT_OT_select_torn: "Torn",
    ZOOMOUT_OT_select_without_partner: "No Partner",
}
# The preview of a cut is beside its button, see `ZOOMOUT_PT_topology`.
PREVIEWS = {name: kind for name, kind in preview.OF_MATCH.items() if name != preview.CUT}


class ZOOMOUT_PT_result(SidebarPanel, Panel):
    bl_label = "Result"
    bl_parent_id = ZOOMOUT_PT_match.__name__
    bl_order = 0

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether there is a match."""
        target = context.active_object
        return target is not None and target.type == "MESH" and stored_match.description(target.data) is not None

    def draw(self, context: Context) -> None:
        layout, target = self.layout, context.active_object
        stored = stored_match.description(target.data)
        if stored is None:
            return
        reason, listing = services.preflight.stale(context, target), stored_candidates.read(target.data)
        if reason:
            box = layout.box()
            box.alert = True
            sentences(context, box, [reason], "ERROR")
        preview_buttons(context, layout, PREVIEWS, enabled=not reason)
        usable = layout.column()
        usable.enabled = not reason
        # In two rows: side by side the labels would be cut off.
        grid = usable.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
        for operator, text in SELECTED.items():
            grid.operator(operator.bl_idname, text=text, icon="RESTRICT_SELECT_OFF")
        if listing is not None:
            _draw_candidates(layout, listing, enabled=not reason)
        # Content that changes with the candidate is below the buttons, so that these do not move.
        explain_hidden_preview(context, layout, PREVIEWS)
        if not reason:
            show_findings(
                context,
                layout,
                [services.preflight.Finding(each, False) for each in services.preflight.find_outdated(context, target)],
            )
        notes = stored["notes"]
        if not reason:
            notes = [*_describe_sources(context, stored), *_describe_areas_without_partner(stored), *notes]
        _draw_notes(context, layout, select_notes(notes, None if reason else stored_match.verdict_of(stored)))


def _describe_sources(context: Context, stored: dict[str, Any]) -> list[str]:
    """A sentence that names the source of the match, unless the panel shows that source in its row."""
    source, others = services.preflight.likely_source(context), stored_match.others(stored)
    if source is not None and source.name == stored["source"] and not others:
        return []
    names = ", ".join(f"'{name}'" for name in (stored["source"], *(other["name"] for other in others)))
    return [message("Matched with {sources}", sources=names)]


def _describe_areas_without_partner(stored: dict[str, Any]) -> list[str]:
    of_target, of_source = stored.get("without_partner") or (0, 0)
    if max(of_target, of_source) < TOLD:
        return []
    return [
        message(
            "Without a partner: {of_target:.0%} of the target, {of_source:.0%} of the source",
            of_target=of_target,
            of_source=of_source,
        )
    ]


def _draw_notes(context: Context, layout: UILayout, notes: Sequence[str]) -> None:
    """Draw notes on the match in a panel that is closed by default, as the verdict above sums them up."""
    if not notes:
        return
    header, body = layout.panel(NOTES, default_closed=True)
    header.label(text="Notes", icon="ERROR" if any(map(is_warning, notes)) else "NONE")
    if body is not None:
        draw_notes(context, body, notes)


def _draw_candidates(layout: UILayout, listing: CandidateList, enabled: bool) -> None:
    row = layout.row(align=True)
    row.enabled = enabled
    row.operator(ZOOMOUT_OT_swap_match_sides.bl_idname, text="Swap Sides", icon="MOD_MIRROR")
    row.operator(ZOOMOUT_OT_use_candidate.bl_idname, text="Next", icon="FORWARD")
    # A panel that is closed by default keeps its name only while the match is certain: it opens when it is not.
    certain = listing.chosen == 0 and listing.candidates[0].certainty >= VERDICT.certain
    header, body = layout.panel(CERTAIN if certain else UNCERTAIN, default_closed=certain)
    header.label(text="Candidates")
    if body is None:
        return
    rows = body.column()  # not aligned: the gaps show which label belongs to which button
    rows.enabled = enabled
    source = _beside_picture(rows, icon_of_source(listing))
    source.scale_y = PICTURE  # as high as the thumbnail, so that its middle has the text
    source.label(text="Source")
    for place, (candidate, name) in enumerate(zip(listing.candidates, _names(listing), strict=True)):
        column = _beside_picture(rows, icon_of_candidate(listing, place))
        chosen = place == listing.chosen
        button = column.operator(ZOOMOUT_OT_use_candidate.bl_idname, text=name, translate=False, depress=chosen)
        button.candidate = place + 1
        if candidate.mirrored:
            column.scale_y = PICTURE  # certainty does not compare mirror images, so there is no second line
        else:
            column.label(text=_likelihood(listing, place))


def _beside_picture(layout: UILayout, icon: int) -> UILayout:
    """A column to the right of a thumbnail."""
    split = layout.split(factor=PICTURED, align=True)
    split.template_icon(icon, scale=PICTURE)
    return split.column(align=True)


def _likelihood(listing: CandidateList, place: int) -> str:
    """A word for how likely a candidate is; the others share the probability that the first one leaves."""
    first, certainty = listing.candidates[0].certainty, listing.candidates[place].certainty
    probability = certainty if place == 0 else min(certainty, 1 - first)
    return next(word for least, word in WORDS if probability >= least)


def _names(listing: CandidateList) -> list[str]:
    """A name for each candidate; later ones of the same difference are numbered from 2."""
    names, count = [], Counter[str]()
    for candidate in listing.candidates:
        name = translated(DIFFERENCES.get(candidate.difference, ""))
        count[name] += 1
        names.append(name if count[name] == 1 else f"{name} {count[name]}")
    return names
