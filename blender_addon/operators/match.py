"""Match the active mesh, and others that are selected, with a source, and keep the results on them."""

from __future__ import annotations

from typing import Any

from bpy.types import Context, Object

from zoomout_core.runtime.stepping import Steps, drain

from ..properties.match import MatchOptions
from ..properties.settings import SourceName, take_settings
from ..services.constraints import matching_steps, settings_to_keep
from ..services.pair import check_unedited, choose_source, read_pair_steps
from ..services.targets import Outcome, Write, each_target_steps, target_names
from ..storage import stored_match
from ..viewport import preview
from .stepped import SteppedOperator


class ZOOMOUT_OT_match(SourceName, MatchOptions, SteppedOperator):
    bl_idname = "zoomout.match"
    bl_label = "Match"
    bl_description = (
        "Find where on the source each vertex of the active mesh, and of the other selected ones, belongs, whatever "
        "their poses and topologies. The source is the mesh chosen in the sidebar; if none is chosen, the one "
        "selected besides the active mesh"
    )
    bl_options = {"REGISTER", "UNDO"}

    def steps(self, context: Context) -> Steps[str]:
        take_settings(self, context.scene.zoomout)
        source = choose_source(context, context.active_object, self.source)
        targets = target_names(context, source)
        options, source_name = self.match_options(), source.name
        outcome = yield from each_target_steps(
            targets, lambda target: worked_out_match_steps(context, source_name, target, **options)
        )
        self.report_failed(outcome)
        return _summary(source_name, outcome)


def _summary(source_name: str, outcome: Outcome[stored_match.Match]) -> str:
    """What was matched, in one sentence."""
    names = list(outcome.done)
    confidences = [match.confidence for match in outcome.done.values()]
    doubtful, vertices = (sum(map(count, confidences)) for count in (stored_match.low_confidence, len))
    what = f"'{names[0]}'" if len(names) == 1 else f"{len(names)} meshes"
    return f"Matched {what} with '{source_name}'; {doubtful} of {vertices} vertices are of low confidence"


def match_objects(context: Context, source: Object, target: Object, **options: Any) -> stored_match.Match:
    """Match two mesh objects, and keep the result on the target's mesh.

    Args:
        context: Blender's; both objects are in its scene.
        source: has the data; read as its modifiers leave it.
        target: receives the data.
        options: those of `constraints.matching_steps`, and of `zoomout_core.match`; or initial="nearest", and those of
            `zoomout_core.match_by_proximity`.

    Raises:
        MeshError: an object cannot be used; nothing was written.
    """
    return drain(match_steps(context, source.name, target.name, **options))


def match_steps(context: Context, source_name: str, target_name: str, **options: Any) -> Steps[stored_match.Match]:
    """`match_objects` as a generator, which holds no Blender data while it is suspended."""
    write = yield from worked_out_match_steps(context, source_name, target_name, **options)
    return write()


def worked_out_match_steps(
    context: Context, source_name: str, target_name: str, **options: Any
) -> Steps[Write[stored_match.Match]]:
    """The same without the end: it returns what keeps the match on the target."""
    pair = yield from read_pair_steps(context, source_name, target_name)
    settings = settings_to_keep(context, pair, options)
    result = yield from matching_steps(context, pair, **options)
    following = yield from preview.following_steps(context, pair, result)

    def write() -> stored_match.Match:
        _, target = check_unedited(context, pair)
        stored_match.write(target.data, result, pair, settings)
        if following is not None:
            preview.show(following)
        return result

    return write
