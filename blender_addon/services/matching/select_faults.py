# SPDX-License-Identifier: GPL-3.0-or-later
"""Select elements of the meshes where a match is doubtful, flipped, or without a partner."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.arrays import Booleans
from zoomout_core.evaluation import flipped_triangles
from zoomout_core.matching.report.verdict import LOW_CONFIDENCE
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.messages import enumeration, message
from zoomout_core.runtime.progress import stage
from zoomout_core.transfer import Attribute, Domain, Kind

from ... import mesh_data
from ...jobs import compute, run
from ...mesh_data import ObjectPair
from ...scene.faults import DOUBTFUL, FLIPPED, TORN, WITHOUT_PARTNER, stretched_vertices
from ...scene.pair import check_not_edited, find_mesh
from ...scene.stored_pair import read_stored_match
from ...storage.stored_match import StoredMatch


def select_faults(context: Context, target: Object, what: str) -> str:
    """Select only those elements of a target's mesh where its match is or may be wrong.

    Args:
        context: Blender's; the target and its source are in its scene.
        target: a matched object, in Object Mode.
        what: DOUBTFUL: vertices of low confidence. FLIPPED: faces whose image on the source is flipped, unlike most.
            TORN: vertices at edges whose image is far too long. WITHOUT_PARTNER: vertices without a partner on the
            source, and, if the source's own mesh was matched, its vertices without a partner on the target.

    Returns:
        A sentence for the user, with the number of elements and their share of the area.

    Raises:
        MeshError: there is no match, an object was edited since, or partners are not known; nothing was selected.
    """
    return run(select_faults_async(context, target.name, what))


async def select_faults_async(context: Context, target_name: str, what: str) -> str:
    """`select_faults` as a coroutine, which keeps no Blender data across an `await`."""
    pair, match = await read_stored_match(context, target_name)
    with stage("Selecting", 0.1, 1.0):
        select = await compute(partial(FAULTS[what], pair, match))
    check_not_edited(context, pair)
    return select(context)


def select_stretched(context: Context, target: Object) -> str:
    """Select only the vertices that stretch far more than the source when the bones of its rig rotate.

    Args:
        context: Blender's; the target is in its scene.
        target: an object that *Bind to Rig* has bound, in Object Mode.

    Returns:
        A sentence for the user, with the number of vertices and their share of the area.

    Raises:
        MeshError: the target was not bound, or its vertices were edited since; nothing was selected.
    """
    obj = find_mesh(context, target.name)
    stretched = read_stretched(obj)
    share = mesh_data.read_surface_at_rest(obj).share_of_area(stretched)
    return message("Stretched: {selected}", selected=_select_vertices(obj, stretched, share))


def read_stretched(target: Object) -> Booleans:
    """(n,) the vertices that stretch when the bones of the target's rig rotate.

    Raises:
        MeshError: the target was not bound, or its vertices were edited since.
    """
    stretched = stretched_vertices(target)
    if stretched is None:
        raise zo.MeshError("'{target}' was not bound yet, or was edited since: bind it to a rig.", target=target.name)
    return stretched


# Numbers of elements of an object: none, one, several.
VERTICES = (
    "no vertices of '{name}', {share:.1%} of its area",
    "{count} vertex of '{name}', {share:.1%} of its area",
    "{count:,} vertices of '{name}', {share:.1%} of its area",
)
FACES = (
    "no faces of '{name}', {share:.1%} of its area",
    "{count} face of '{name}', {share:.1%} of its area",
    "{count:,} faces of '{name}', {share:.1%} of its area",
)

# Selects the elements, and returns a sentence about them.
Select = Callable[[Context], str]


def _doubtful(pair: ObjectPair, match: StoredMatch) -> Select:
    chosen = match.confidence < LOW_CONFIDENCE
    share = pair.target.share_of_area(chosen)
    return lambda context: message(
        "Doubtful: {selected}", selected=_select_vertices(find_mesh(context, pair.target_name), chosen, share)
    )


def _select_flipped(pair: ObjectPair, match: StoredMatch) -> Select:
    target = pair.target
    area = triangle_areas(target.vertices, target.triangles)
    over = flipped_triangles(match.surface_map, pair.source, target)
    if area[over].sum() > area.sum() / 2:  # a mirror image
        over = ~over
    if match.has_partner is not None:  # vertices without a partner map to the same place as their surroundings
        over &= match.has_partner[target.triangles].all(axis=1)
    chosen = np.zeros(len(target.face_start) - 1, dtype=bool)
    chosen[target.triangle_face[over]] = True
    share = area[chosen[target.triangle_face]].sum() / area.sum()

    def select(context: Context) -> str:
        obj = find_mesh(context, pair.target_name)
        mesh_data.select_only(obj.data, Attribute("selection", Domain.FACE, Kind.BOOLEAN, chosen))
        return message("Flipped: {selected}", selected=_count_in_words(chosen, FACES, obj, share))

    return select


def _torn(pair: ObjectPair, match: StoredMatch) -> Select:
    if match.torn is None:
        raise zo.MeshError(
            "The match of '{target}' has no information about torn places: match again.", target=pair.target_name
        )
    chosen, share = match.torn, pair.target.share_of_area(match.torn)
    return lambda context: message(
        "Torn: {selected}", selected=_select_vertices(find_mesh(context, pair.target_name), chosen, share)
    )


def _without_partner(pair: ObjectPair, match: StoredMatch) -> Select:
    if match.has_partner is None:
        raise zo.MeshError(
            "The match of '{target}' has no information about partners: match again.", target=pair.target_name
        )
    chosen = ~match.has_partner
    share = pair.target.share_of_area(chosen)

    def select(context: Context) -> str:
        found = [_select_vertices(find_mesh(context, pair.target_name), chosen, share)]
        if match.source_has_partner is not None:
            found += _select_on_sources(context, pair, ~match.source_has_partner)
        return message("Without a partner: {selected}", selected=enumeration(found, "; "))

    return select


FAULTS: dict[str, Callable[[ObjectPair, StoredMatch], Select]] = {
    DOUBTFUL: _doubtful,
    FLIPPED: _select_flipped,
    TORN: _torn,
    WITHOUT_PARTNER: _without_partner,
}


def _select_on_sources(context: Context, pair: ObjectPair, chosen: Booleans) -> list[str]:
    """Select some of the sources' joined vertices, on sources whose own mesh has them."""
    ends = np.cumsum([len(surface.vertices) for surface in pair.sources])[:-1]
    found = []
    for name, surface, own in zip(pair.source_names, pair.sources, np.split(chosen, ends), strict=True):
        obj = find_mesh(context, name)
        if obj.data.library is None and len(obj.data.vertices) == len(own):
            found.append(_select_vertices(obj, own, surface.share_of_area(own)))
    return found


def _select_vertices(obj: Object, chosen: Booleans, share: float) -> str:
    mesh_data.select_only(obj.data, Attribute("selection", Domain.POINT, Kind.BOOLEAN, chosen))
    return _count_in_words(chosen, VERTICES, obj, share)


def _count_in_words(chosen: Booleans, templates: tuple[str, str, str], obj: Object, share: float) -> str:
    count = int(np.count_nonzero(chosen))
    return message(templates[min(count, 2)], count=count, name=obj.name, share=share)
