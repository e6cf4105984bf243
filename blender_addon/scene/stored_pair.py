"""The match that is stored on a target, with its objects as they are now."""

from __future__ import annotations

from bpy.types import Context

import zoomout_core as zo
from zoomout_core.runtime.stepping import Steps

from ..mesh_data import ObjectPair
from ..storage.stored_match import StoredMatch, description, others, read
from .pair import find_mesh, fingerprint_source, read_pair_steps
from .selection import choose_source


def stored_pair_steps(context: Context, source_name: str, target_name: str) -> Steps[ObjectPair]:
    """`read_pair_steps` with the others that the target lies on by the match with the source stored on it.

    Raises:
        MeshError: one of them cannot be used, or the target cannot be written to.
    """
    stored = description(find_mesh(context, target_name).data)
    names = [other["name"] for other in others(stored)] if stored else []
    if stored and names and stored["source"] != source_name:
        renamed = fingerprint_source(context, source_name).digest == stored["source_fingerprint"]
        names = names if renamed else []
    return (yield from read_pair_steps(context, source_name, target_name, names))


def read_stored_match_steps(context: Context, target_name: str) -> Steps[tuple[ObjectPair, StoredMatch]]:
    """The match stored on a target, and its two objects as they are now.

    Raises:
        MeshError: there is none, or one of them was edited since.
    """
    target = find_mesh(context, target_name)
    stored = description(target.data)
    if stored is None:
        raise zo.MeshError(f"'{target_name}' was not matched yet: match it first.")
    renamed = stored["source"] not in context.scene.objects
    source_name = choose_source(context, target).name if renamed else stored["source"]
    pair = yield from stored_pair_steps(context, source_name, target_name)
    match = read(find_mesh(context, target_name).data, pair)
    if match is None:
        raise zo.MeshError(f"'{source_name}' is not what '{target_name}' was matched with: match again.")
    return pair, match
