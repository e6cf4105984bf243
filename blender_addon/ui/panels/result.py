"""Subpanel of the match: its result, previews in the viewport, and other candidates."""

from __future__ import annotations

from bpy.types import Context, Panel, UILayout

from ...operators.candidates import ZOOMOUT_OT_swap_match_sides, ZOOMOUT_OT_use_candidate
from ...services.preflight import Finding, outdated, stale
from ...storage import stored_candidates, stored_match
from ...storage.stored_candidates import CandidateList
from ...viewport import preview
from ..thumbnails import icon_of_candidate, icon_of_source
from .match import ZOOMOUT_PT_match
from .sidebar import PICTURE, SidebarPanel, preview_buttons, sentences, show_findings

# Share of vertices of low confidence from which on a match has no check mark.
DOUBTFUL = 0.25
# Part of either surface's area without a partner from which on it is told.
TOLD = 0.005
# Number of thumbnails in a row.
COLUMNS = 3


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
        reason = stale(context, target)
        if reason:
            box = layout.box()
            box.alert = True
            sentences(context, box, [reason], "ERROR")
        else:
            doubtful = stored["low_confidence"] / stored["vertices"]
            others = (source["name"] for source in stored_match.others(stored))
            names = ", ".join(f"'{name}'" for name in (stored["source"], *others))
            text = f"Matched with {names}, {doubtful:.0%} in doubt"
            sentences(context, layout, [text], "CHECKMARK" if doubtful < DOUBTFUL else "ERROR")
            of_target, of_source = stored.get("without_partner") or (0, 0)
            if max(of_target, of_source) >= TOLD:
                text = f"Without a partner: {of_target:.0%} of the target, {of_source:.0%} of the source"
                sentences(context, layout, [text], "DOT")
            show_findings(context, layout, [Finding(each, False) for each in outdated(context, target)])
        preview_buttons(context, layout, preview.OF_MATCH, enabled=not reason)
        usable = layout.column()
        usable.enabled = not reason
        listing = stored_candidates.read(target.data)
        if listing is not None:
            _draw_candidates(usable, listing)
        sentences(context, layout, stored["notes"], "DOT")


def _draw_candidates(layout: UILayout, listing: CandidateList) -> None:
    row = layout.row(align=True)
    row.operator(ZOOMOUT_OT_swap_match_sides.bl_idname, text="Swap Sides", icon="MOD_MIRROR")
    row.operator(ZOOMOUT_OT_use_candidate.bl_idname, text="Next", icon="FORWARD")
    grid = layout.grid_flow(row_major=True, columns=COLUMNS, even_columns=True, align=True)
    column = grid.column(align=True)
    column.template_icon(icon_of_source(listing), scale=PICTURE)
    column.label(text="Source")
    for place, candidate in enumerate(listing.candidates):
        column = grid.column(align=True)
        column.template_icon(icon_of_candidate(listing, place), scale=PICTURE)
        text = "Mirrored" if candidate.mirrored else f"{candidate.certainty:.0%}"
        chosen = place == listing.chosen
        button = column.operator(ZOOMOUT_OT_use_candidate.bl_idname, text=text, depress=chosen)
        button.candidate = place + 1
