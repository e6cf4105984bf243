# SPDX-License-Identifier: GPL-3.0-or-later
"""Cut a target along the seams of its source, and update its match for the resulting mesh."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.messages import message, plural
from zoomout_core.runtime.progress import stage
from zoomout_core.transfer import map_target
from zoomout_core.transfer.uv.seam_cut import SeamCut, seam_cut

from ...jobs import compute, run
from ...mesh_data import ObjectPair, divide, read_joined_active_uv_map, write_divided
from ...mesh_data.arrays import hash_of
from ...scene.pair import check_not_edited, evaluated_sources, find_mesh, fingerprint_target, writing
from ...scene.stored_pair import stored_pair
from ...storage import stored_candidates, stored_match
from . import previews
from .candidates import store_match

# Fraction of the progress at which the division of faces begins.
DIVIDING = 0.9


def cut_seams(context: Context, source: Object, target: Object) -> str:
    """Cut a mesh along the seams of the active UV map of the source that it was matched with.

    Args:
        context: Blender's; both objects are in its scene.
        source: the object with the UV map; it is read after its modifiers.
        target: the object to cut; its match is updated.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: there is no match, no UV map, or one of a single point; nothing was changed.
    """
    return run(cut_seams_async(context, source.name, target.name))


async def cut_seams_async(context: Context, source_name: str, target_name: str) -> str:
    """`cut_seams` as a coroutine, which keeps no Blender data across an `await`."""
    pair = await stored_pair(context, source_name, target_name)
    stored = stored_match.read(find_mesh(context, target_name).data, pair)
    if stored is None:
        raise zo.MeshError(
            "'{target}' was not matched with '{source}' yet: match them first.", target=target_name, source=source_name
        )
    with evaluated_sources(context, pair) as sources:
        uv = read_joined_active_uv_map(sources)
    mapped = map_target(stored, pair.source, pair.target)
    with stage("Following the seams", 0, DIVIDING):
        cut = await compute(partial(seam_cut, uv, mapped))
    _, target = check_not_edited(context, pair)
    with stage("Dividing faces", DIVIDING, 1):
        divided = await divide(target.data, cut)
    try:
        with writing(context, pair) as (_, target):
            before = len(target.data.polygons)
            write_divided(target.data, divided)
            _store_match(context, pair, stored, cut)
    finally:
        divided.free()
    previews.follow_match(context, target)
    vertices, faces = (len(target.data.vertices) - len(pair.target.vertices)), len(target.data.polygons) - before
    whole = ""
    if cut.left:
        whole = plural(
            cut.left,
            "; 1 face crossed by several seams was not cut",
            "; {count:,} faces crossed by several seams were not cut",
        )
    return message(
        "Cut '{target}' along the seams of '{uv_map}', adding {vertices:,} vertices and {faces:,} faces{left}",
        target=target_name,
        uv_map=uv.name,
        vertices=vertices,
        faces=faces,
        left=whole,
    )


def _store_match(context: Context, before: ObjectPair, stored: stored_match.StoredMatch, cut: SeamCut) -> None:
    """Store the match on the cut mesh, with its list of candidates."""
    mesh = find_mesh(context, before.target_name).data
    listing = stored_candidates.read(mesh)
    # The pair's target surface is outdated, but storing a `StoredMatch` needs only the fingerprints.
    pair = replace(before, target_fingerprint=fingerprint_target(context, before.target_name))
    torn = None if stored.torn is None else cut.interpolate(stored.torn[:, None].astype(float)).any(axis=1)
    match = replace(stored, torn=torn, **cut.changes(stored.confidence, stored.has_partner))
    store_match(mesh, match, pair, stored.settings)
    if listing is not None:
        # Its vertices keep their numbers, but cached results, found by its key, belong to the mesh before the cut.
        key = hash_of(f"{listing.key} {pair.target_fingerprint.digest}")
        stored_candidates.write(mesh, replace(listing, key=key))
