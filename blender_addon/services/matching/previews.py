# SPDX-License-Identifier: GPL-3.0-or-later
"""The colours of previews of a match, a symmetry or an asymmetry, kept up to date with the stored data."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import partial

import numpy as np
from bpy.types import Context, Mesh, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats, Integers
from zoomout_core.colors import confidence_colors, partner_colors, place_colors
from zoomout_core.runtime.progress import Outlines, Progress, progress, stage
from zoomout_core.transfer import Attribute, map_target, transfer_along
from zoomout_core.transfer.uv.seam_cut import seam_cut

from ...colors import (
    asymmetry_colors,
    blend_colors,
    pair_colors,
    side_colors,
    stretched_colors,
)
from ...jobs import compute, pause, run, watching
from ...mesh_data import (
    MATCH_ATTRIBUTES,
    ObjectPair,
    content_hash,
    read_joined_active_uv_map,
    read_layer,
    read_positions,
)
from ...mesh_data.arrays import hash_of
from ...scene.pair import evaluated_sources, find_mesh
from ...scene.stored_pair import read_stored_match
from ...storage import stored_report, stored_symmetry
from ...storage.stored_candidates import CandidateList
from ...storage.stored_match import Match
from ...viewport import overlay, preview
from ...viewport.overlay import Divided, Overlay
from ...viewport.preview import (
    ASYMMETRY,
    CHECKER,
    CONFIDENCE,
    CUT,
    OF_BINDING,
    OF_MATCH,
    OF_SYMMETRY,
    PAIRS,
    PLACES,
    SIDES,
    STRETCHED,
    Preview,
)
from .select_faults import read_stretched


async def of_match(context: Context, pair: ObjectPair, match: Match, kind: str) -> Preview:
    """The preview of a match on the target, and for some kinds on the source.

    Raises:
        MeshError: the source has no UV map for a checker, or one of a single point.
    """
    with stage("Coloring"):
        await pause()
        on_source: Floats | None = None
        divided: Divided | None = None
        if kind == CONFIDENCE:
            on_target = confidence_colors(match.confidence, match.has_partner)
            of_source = None if isinstance(match, zo.ProximityMatch) else match.source_has_partner
            if of_source is not None and not of_source.all():
                on_source = partner_colors(of_source)
        elif kind == PLACES:
            on_source = place_colors(pair.source.vertices, pair.source.vertices)
            on_target = match.surface_map.interpolate(on_source)
        else:
            with evaluated_sources(context, pair) as sources:
                uv = read_joined_active_uv_map(sources)
            with stage("Applying the checker", 0.1, 1):
                transferred, divided = await compute(partial(_along_cut if kind == CUT else _along, uv, match, pair))
            on_source, on_target = uv.values, transferred.values
    target = find_mesh(context, pair.target_name)
    overlays = [Overlay(target.session_uid, on_target, pair.target_fingerprint.content, divided)]
    if on_source is not None:
        overlays.extend(_overlays_of_sources(context, pair, on_source))
    stored_hash = hash_of("", match.surface_map.triangle.astype(np.int32))
    return Preview(kind, target.session_uid, OF_MATCH[kind].legend, tuple(overlays), stored_hash)


def _along(uv: Attribute, match: Match, pair: ObjectPair) -> tuple[Attribute, None]:
    return transfer_along(uv, map_target(match, pair.source, pair.target)), None


def _along_cut(uv: Attribute, match: Match, pair: ObjectPair) -> tuple[Attribute, Divided]:
    """UVs of the target's corners after a cut along their seams, and the cut target."""
    mapped = map_target(match, pair.source, pair.target)
    cut = seam_cut(uv, mapped)
    target = cut.apply(pair.target)
    after = replace(mapped, target=target, **cut.changes(mapped.confidence, mapped.has_partner))
    return transfer_along(uv, after), Divided(cut, target.corner_vertex, target.triangle_corners)


@contextmanager
def approximate_candidate(obj: Object, listing: CandidateList, place: int) -> Iterator[None]:
    """Show an approximate map of a candidate while it is computed, if the preview shows places.

    After an error or a cancel, the previous preview is restored.

    Args:
        obj: the target.
        listing: the candidates of its match.
        place: index of the candidate.
    """
    before = preview.preview_of(obj)
    if before is None or before.kind != PLACES:
        yield
        return
    colors = blend_colors(read_positions(obj.data), listing.vertices, listing.candidates[place].colors / 255)
    preview.show(before.with_colors(colors))
    try:
        yield
    except BaseException:
        preview.show(before)
        raise


def first_look(context: Context, pair: ObjectPair, show_preview: bool) -> AbstractContextManager[None]:
    """Show the places of a match while it is computed, roughly, as soon as its candidates are known.

    The preview is preliminary: `preview.end_preliminary` restores the previous one.

    Args:
        context: Blender's.
        pair: the two objects.
        show_preview: whether to show it if there is no preview; one of places is replaced in any case.
    """
    before = preview.preview_of(find_mesh(context, pair.target_name))
    if preview.current() is None:
        return _showing_outlines(context, pair, passing=True) if show_preview else nullcontext()
    if before is not None and before.kind == PLACES:
        return _showing_outlines(context, pair, before.passing)
    return nullcontext()


@contextmanager
def _showing_outlines(context: Context, pair: ObjectPair, passing: bool) -> Iterator[None]:
    target = find_mesh(context, pair.target_name)
    uncolored = Overlay(target.session_uid, np.empty((0, 3)), pair.target_fingerprint.content)
    of_sources = _overlays_of_sources(context, pair, place_colors(pair.source.vertices, pair.source.vertices))
    stored_hash = _stored_hash(target.data, PLACES)
    bare = Preview(PLACES, target.session_uid, preview.PRELIMINARY, (uncolored, *of_sources), stored_hash, passing)
    outlines: Outlines = ()
    colors: list[Floats] = []  # of the latest outline, until they are shown

    def listen(latest: Progress) -> None:
        """Compute the colours in the thread of the match."""
        nonlocal outlines
        if latest.outlines is not outlines:
            outlines = latest.outlines
            colors[:] = [_outline_colors(pair, *outlines[0])]

    def show() -> None:
        if colors:
            preview.show_preliminary(bare.with_colors(colors.pop()))

    with progress(listen), watching(show):
        yield


def _outline_colors(pair: ObjectPair, vertices: Integers, images: Integers) -> Floats:
    """(n, 3) colours of a target's vertices from a candidate's images (s,) of some of them (s,)."""
    own = vertices < len(pair.target.vertices)  # without the half that a Mirror modifier adds
    colors = place_colors(pair.source.vertices[images[own]], pair.source.vertices)
    return blend_colors(pair.target.vertices, vertices[own], colors)


def _overlays_of_sources(context: Context, pair: ObjectPair, values: Floats) -> list[Overlay]:
    """An overlay for each source of a match, from colours (n, 3) of vertices or UVs (c, 2) of corners of all."""
    elements = "vertices" if values.shape[1] == 3 else "corner_vertex"
    ends = np.cumsum([len(getattr(source, elements)) for source in pair.sources])[:-1]
    return [
        Overlay(find_mesh(context, source.name).session_uid, own, source.content)
        for source, own in zip(pair.source_fingerprints, np.split(values, ends), strict=True)
    ]


async def updated_preview(
    context: Context, pair: ObjectPair, match: Match, otherwise: str | None = None
) -> Preview | None:
    """The current preview of a target, updated for a new match.

    Args:
        context: Blender's.
        pair: the target with its source.
        match: the new match.
        otherwise: kind of a passing preview if there is none; None for no preview.
    """
    before = preview.preview_of(find_mesh(context, pair.target_name))
    if before is not None and before.kind in OF_MATCH:
        return replace(await of_match(context, pair, match, before.kind), passing=before.passing)
    if otherwise is None or preview.current() is not None:
        return None
    return replace(await of_match(context, pair, match, otherwise), passing=True)


def follow_match(context: Context, obj: Object) -> None:
    """Update the preview of an object's match, after its mesh and its match were subdivided."""
    before = preview.preview_of(obj)
    if before is not None and before.kind in OF_MATCH:
        preview.show(run(_recompute(context, obj, CHECKER if before.kind == CUT else before.kind)))


async def of_symmetry(context: Context, name: str, kind: str) -> Preview:
    """The preview of the symmetry stored on an object's mesh.

    Raises:
        MeshError: there is no symmetry, it is outdated, or it has no sides for a preview of sides.
    """
    obj = find_mesh(context, name)
    symmetry, order, bare = stored_symmetry.read(obj), stored_symmetry.order(obj.data), _of_mesh(obj, kind)
    width = context.scene.zoomout.symmetry.middle_width * np.sqrt(symmetry.surface.area)
    if kind == SIDES and not symmetry.has_sides:
        raise zo.MeshError("This symmetry has no left and right side: choose a reflection.")

    def colors() -> Floats:
        return side_colors(symmetry.sides(width)) if kind == SIDES else pair_colors(symmetry, order)

    with stage("Coloring"):
        await pause()
        return bare.with_colors(await compute(colors))


def of_binding(obj: Object) -> Preview:
    """The preview of the vertices that the check of a binding found to stretch.

    Raises:
        MeshError: the object was not bound, or its vertices were edited since.
    """
    stretched = read_stretched(obj)
    made = _of_mesh(obj, STRETCHED).with_colors(stretched_colors(stretched))
    return made if stretched.any() else replace(made, legend=preview.NOTHING_STRETCHES)


def of_asymmetry(obj: Object, values: Floats, max_value: float, legend: str) -> Preview:
    """The preview of the asymmetry of an object's mesh, from values (n,); red means `max_value` and above."""
    return replace(_of_mesh(obj, ASYMMETRY), legend=legend).with_colors(asymmetry_colors(values, max_value))


def follow_symmetry(context: Context, obj: Object, show_preview: bool = False) -> None:
    """Update the preview of an object's symmetry, after another one was stored or chosen.

    Args:
        context: Blender's.
        obj: the object.
        show_preview: whether to show a passing preview of pairs if there is no other preview.
    """
    before = preview.preview_of(obj)
    if show_preview and preview.current() is None:
        preview.show(replace(run(of_symmetry(context, obj.name, PAIRS)), passing=True))
    if before is None or before.kind not in OF_SYMMETRY:
        return
    if before.kind == ASYMMETRY:
        preview.outdate(before)
        return
    sided = stored_symmetry.has_sides(obj.data)
    try:
        after = run(of_symmetry(context, obj.name, before.kind if sided else PAIRS))
        preview.show(replace(after, passing=before.passing))
    except zo.MeshError:  # the mesh was reshaped since
        preview.clear()


def follow_undo(context: Context, before: Preview) -> None:
    """Update the preview `before` to the stored data, after undo or redo."""
    obj = overlay.find(before.object_uid)
    if obj is None:  # it was removed, and may come back
        return
    if before.kind == ASYMMETRY:
        preview.outdate(before)
    elif _stored_hash(obj.data, before.kind) != before.stored_hash:
        try:
            preview.show(run(_recompute(context, obj, before.kind)))
        except zo.MeshError:  # nothing is stored any more
            preview.clear()


async def _recompute(context: Context, obj: Object, kind: str) -> Preview:
    if kind in OF_SYMMETRY:
        return await of_symmetry(context, obj.name, kind)
    if kind in OF_BINDING:
        return of_binding(obj)
    pair, match = await read_stored_match(context, obj.name)
    return await of_match(context, pair, match, kind)


def _of_mesh(obj: Object, kind: str) -> Preview:
    """A preview of an object's present own mesh, still without colours."""
    uncolored = Overlay(obj.session_uid, np.empty((0, 3)), content_hash(obj.data))
    legend = (OF_SYMMETRY | OF_BINDING)[kind].legend
    return Preview(kind, obj.session_uid, legend, (uncolored,), _stored_hash(obj.data, kind))


def _stored_hash(mesh: Mesh, kind: str) -> str:
    """A hash of the match, the symmetry or the report stored on a mesh."""
    if kind in OF_BINDING:
        return hash_of(str(mesh.get(stored_report.PROPERTY)))
    names = MATCH_ATTRIBUTES[:1] if kind in OF_MATCH else stored_symmetry.chosen_attributes(mesh)
    return hash_of("", *(read_layer(mesh, name).attribute.values for name in names if name in mesh.attributes))
