"""Match the active mesh with a source, and keep the result on it."""

from __future__ import annotations

from typing import Any

from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.progress import Steps, drain

from .. import match_preview, stored_match
from ..evidence import matching_steps
from ..pair import check_unedited, choose_source, read_pair
from ..properties.match import MatchOptions
from ..properties.settings import SourceName, take_settings
from .stepped import SteppedOperator


class ZOOMOUT_OT_match(SourceName, MatchOptions, SteppedOperator):
    bl_idname = "zoomout.match"
    bl_label = "Match"
    bl_description = (
        "Find where on the source each vertex of the active mesh belongs, whatever their poses and topologies. "
        "The source is the mesh chosen in the sidebar; if none is chosen, the one selected besides the active mesh"
    )
    bl_options = {"REGISTER", "UNDO"}

    def steps(self, context: Context) -> Steps[str]:
        take_settings(self, context.scene.zoomout)
        names = choose_source(context, context.active_object, self.source).name, context.active_object.name
        result = yield from match_steps(context, *names, **self.match_options())
        doubtful = stored_match.low_confidence(result.confidence)
        return (
            f"Matched '{names[1]}' with '{names[0]}'; "
            f"{doubtful} of {len(result.confidence)} vertices are of low confidence"
        )


def match_objects(
    context: Context, source: Object, target: Object, **options: Any
) -> zo.MatchResult | zo.ProximityMatch:
    """Match two mesh objects, and keep the result on the target's mesh.

    Args:
        context: Blender's; both objects are in its scene.
        source: has the data; read as its modifiers leave it.
        target: receives the data.
        options: `names`, `same_up` and `from_last` of `evidence.matching_steps`, and those of `zoomout_core.match`;
            or initial="nearest", and those of `zoomout_core.match_by_proximity`.

    Raises:
        MeshError: an object cannot be used; nothing was written.
    """
    return drain(match_steps(context, source.name, target.name, **options))


def match_steps(
    context: Context, source_name: str, target_name: str, **options: Any
) -> Steps[zo.MatchResult | zo.ProximityMatch]:
    """`match_objects` as a generator, which holds no Blender data while it is suspended."""
    pair = read_pair(context, source_name, target_name)
    result = yield from matching_steps(context, pair, **options)
    coats = yield from match_preview.following_steps(context, pair, result)
    _, target = check_unedited(context, pair)
    stored_match.write(target.data, result, pair, options)
    match_preview.follow(coats)
    return result
