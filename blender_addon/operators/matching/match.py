# SPDX-License-Identifier: GPL-3.0-or-later
"""Match the active and other selected meshes with a source, and store the results on them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from bpy.types import Context

from zoomout_core.matching import report
from zoomout_core.messages import message

from ... import services
from ...properties.match import MatchOptions, RedoOptions
from ...properties.settings import SourceName, take_settings
from ...scene.selection import sources_of_targets
from ...storage import stored_match
from ..base.modal_operator import ModalOperator


class ZOOMOUT_OT_match(SourceName, MatchOptions, RedoOptions, ModalOperator):
    bl_idname = "zoomout.match"
    bl_label = "Match"
    bl_description = (
        "Match each vertex of the active mesh, and of the other selected ones, to the source, across poses and "
        "topologies. The source is the mesh chosen in the sidebar; if none is chosen, the one selected besides the "
        "active mesh"
    )
    bl_options = {"REGISTER", "UNDO"}

    def draw(self, context: Context) -> None:
        """Draw a hint instead of options, because a match takes too long for interactive changes."""
        self.layout.label(text="Change the options in the sidebar, then match again")

    async def work(self, context: Context) -> str:
        take_settings(self, context.scene.zoomout)
        active = context.active_object.name
        source_of, options = sources_of_targets(context, self.source), self.match_options() | self.redo_options()
        outcome = await services.targets.each_target(
            list(source_of),
            lambda target: services.matching.match.prepare_match(
                context, source_of[target], target, show_preview=target == active, **options
            ),
            partial(services.matching.match.agree_matches, options.get("detail", "balanced"), options.get("k_final", 0))
            if self.initial == "AUTO"
            else None,
        )
        self.report_failed(outcome)
        return _summary([source_of[target] for target in outcome.done], outcome)


def _summary(sources: Sequence[str], outcome: services.targets.Outcome[stored_match.Match]) -> str:
    """The result in one sentence."""
    names = list(outcome.done)
    confidences = [match.confidence for match in outcome.done.values()]
    doubtful, vertices = (sum(map(count, confidences)) for count in (stored_match.low_confidence, len))
    what = f"'{names[0]}'" if len(names) == 1 else message("{count} meshes", count=len(names))
    others = message(" and others") if len(set(sources)) > 1 else ""
    text = message(
        "Matched {meshes} with '{source}'{others}; {doubtful:,} of {vertices:,} vertices are doubtful",
        meshes=what,
        source=sources[0],
        others=others,
        doubtful=doubtful,
        vertices=vertices,
    )
    shares = stored_match.without_partner(outcome.done[names[0]]) if len(names) == 1 else None
    if shares is None or max(shares) < report.notes.MAX_UNMATCHED_SHARE:
        return text
    return message(
        "{done}; {of_target:.0%} of the target and {of_source:.0%} of the source have no partner",
        done=text,
        of_target=shares[0],
        of_source=shares[1],
    )
