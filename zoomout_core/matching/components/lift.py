# SPDX-License-Identifier: GPL-3.0-or-later
"""Extend the map between two shapes' meshes to the whole surfaces, loose parts included."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.components.component_mapping import ComponentMap, map_components
from zoomout_core.matching.components.parts import MAX_PAIRED_PARTS
from zoomout_core.matching.components.shells import ShellMap, map_shells
from zoomout_core.matching.pair import Pair, target_in_space
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.proxy import Proxy
from zoomout_core.matching.refinement.confidence import Partners
from zoomout_core.matching.registration.nonrigid_icp import Fit, lift_fit, replace_images
from zoomout_core.mesh.input_checks import measurable
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import at_any, triangle_areas
from zoomout_core.messages import message, plural

PAIRED_SHELLS = "{paired} of {count} parts matched to their partners by position, size and shape{others}."
# Sentences about the numbers of loose parts in a `ComponentMap`: of two surfaces, and of one that is matched to itself.
TOO_MANY = "{parts} beyond the {most} largest, too many to pair: mapped to the nearest surface."
OF_TWO = {
    "paired": "{parts} paired with parts of the source by position, size and shape.",
    "others": "{parts} of the target mapped to other parts of the source at the same position.",
    "fused": "{parts} of the source found fused with the target's body.",
    "too_many": TOO_MANY,
    "alone": "{parts} of the target without a partner: mapped to the nearest point of the body, with zero confidence.",
    "left": "{parts} of the source without a partner: no part of the target was matched to them.",
}
OF_ONE = {
    "paired": "{parts} mapped to their partners, or to themselves, by position, size and shape.",
    "others": "{parts} mapped to other parts at the same position.",
    "too_many": TOO_MANY,
    "alone": "{parts} without a partner: mapped to the nearest point of the body, with zero confidence.",
}


# Tolerance, at unit area, in the search for the body's point nearest to a vertex without an image. On fine meshes,
# loose flecks are about equally far from many triangles.
BESIDE_TOLERANCE = 0.01


class LiftedMap(NamedTuple):
    """The map between two surfaces."""

    surface_map: SurfaceMap  # from the target to the source
    confidence: Floats  # (n_t,) in it
    partners: Partners  # of the surfaces; vertices without a face count as having one
    placed: float  # the part of the target's area, in [0, 1], for which there is something on the source
    notes: tuple[str, ...]  # sentences for the user about parts


def lift(pair: Pair, fit: Fit, confidence: Floats, partners: Partners) -> LiftedMap:
    """Extend the map between the proxies, with confidence (n_proxy,), to the full surfaces, component by component."""
    if pair.target_shape.proxy.full.is_hull:
        return _from_shells(pair, map_shells(pair, fit, confidence, partners))
    source, target = pair.source_shape.proxy, pair.target_shape.proxy
    between_parts = lift_fit(fit, source, target, target_in_space(pair))
    loose = map_components(pair, between_parts, confidence)
    whole, confidence, on_body, placed = _join(pair, between_parts, target.place.interpolate(confidence), loose)
    areas = triangle_areas(pair.target.vertices, pair.target.triangles)
    share = float(areas[at_any(on_body | placed, pair.target.triangles)].sum() / areas.sum())
    alone = (pair.target.working.vertex_of >= 0) & ~on_body & ~placed
    left = np.isin(pair.source.working.vertex_of, loose.left_vertices)
    both = Partners(_on_surface(target, partners.target, ~alone), _on_surface(source, partners.source, ~left))
    whole = _with_the_rest(pair, whole, on_body, on_body | placed)
    return LiftedMap(whole, confidence, both, share, _notes(pair, loose))


def _join(
    pair: Pair, body: SurfaceMap, confidence: Floats, loose: ComponentMap
) -> tuple[SurfaceMap, Floats, Booleans, Booleans]:
    """Join the map between two bodies' full meshes, with its confidence (n,), and the map of the loose parts.

    Returns:
        The map between the surfaces, (n_t,) its confidence, and (n_t,) the vertices on the body and on mapped parts;
        others have no image yet.
    """
    source, vertex_of = pair.source_shape.proxy.full, pair.target_shape.proxy.full.vertex_of
    on_body, n = vertex_of >= 0, len(pair.target.vertices)
    triangle, barycentric, joined = np.zeros(n, dtype=np.int64), np.tile([1.0, 0, 0], (n, 1)), np.zeros(n)
    triangle[on_body] = source.triangle_of[body.triangle[vertex_of[on_body]]]
    barycentric[on_body] = body.barycentric[vertex_of[on_body]]
    joined[on_body] = confidence[vertex_of[on_body]]
    number = np.full(len(pair.target.working.vertices), -1)
    number[loose.image.vertices] = np.arange(len(loose.image.vertices))
    number = np.where(pair.target.working.vertex_of >= 0, number[pair.target.working.vertex_of], -1)
    placed = number >= 0
    image = number[placed]
    triangle[placed] = pair.source.working.triangle_of[loose.image.triangle[image]]
    barycentric[placed], joined[placed] = loose.image.barycentric[image], loose.image.confidence[image]
    return SurfaceMap(triangle, barycentric, pair.source.triangles), joined, on_body, placed


def _on_surface(proxy: Proxy, has_partner: Booleans, beside: Booleans) -> Booleans:
    """(n,) which vertices of a surface have a partner.

    On its main part, this is known of the proxy's vertices, by `has_partner` (m,), and elsewhere by `beside` (n,).
    """
    on_part = proxy.place.interpolate(has_partner.astype(np.float64)) >= 0.5
    vertex_of = proxy.full.vertex_of
    return np.where(vertex_of >= 0, on_part[vertex_of], beside)


def _from_shells(pair: Pair, shells: ShellMap) -> LiftedMap:
    """The map of shells in the surfaces' own numbers; vertices without a face take the image of the nearest one."""
    of = pair.target.working.vertex_of
    used = np.flatnonzero(of >= 0)
    rest = np.flatnonzero((of < 0) & measurable(pair.target.vertices))
    near = np.zeros(len(of), dtype=np.int64)
    near[used] = of[used]
    if len(rest):
        near[rest] = of[used[cKDTree(pair.target.vertices[used]).query(pair.target.vertices[rest])[1]]]
    confidence = np.where(of >= 0, shells.confidence[near], 0)
    triangle = pair.source.working.triangle_of[shells.surface_map.triangle[near]]
    whole = SurfaceMap(triangle, shells.surface_map.barycentric[near], pair.source.triangles)
    of_source, known = pair.source.working.vertex_of, shells.partners
    partners = Partners((of < 0) | known.target[of], (of_source < 0) | known.source[of_source])
    return LiftedMap(whole, confidence, partners, 1 - shells.alone, _notes_on_shells(pair, shells))


def _notes_on_shells(pair: Pair, shells: ShellMap) -> tuple[str, ...]:
    """Sentences for the user about the map of the shells."""
    count = int(pair.target.working.component.max()) + 1
    notes = []
    if shells.in_place:
        notes.append("The two meshes overlap in place, so each vertex was mapped to the nearest point.")
    if shells.paired:
        others = message("; the others were mapped to the nearest surface") if shells.paired < count else ""
        notes.append(message(PAIRED_SHELLS, paired=shells.paired, count=count, others=others))
    return tuple(notes)


def _with_the_rest(pair: Pair, known: SurfaceMap, on_body: Booleans, placed: Booleans) -> SurfaceMap:
    """Extend the map from the body to vertices without an image: each takes that of the nearest point on the body."""
    source, target = pair.source, pair.target
    rest = ~placed & measurable(target.vertices)
    if not rest.any():
        return known
    main = np.flatnonzero(on_body[target.triangles[:, 0]])
    tolerance = BESIDE_TOLERANCE * target.working.scale
    place, weights = closest_points(target.vertices[rest], target.vertices, target.triangles[main], tolerance)
    return replace_images(known, rest, known.at(source, target, main[place], weights))


def _notes(pair: Pair, loose: ComponentMap) -> tuple[str, ...]:
    """Sentences for the user about the parts of the two surfaces."""
    notes, is_one = [], pair.source is pair.target
    if is_one and _is_smaller(pair.source, pair.source_shape):
        notes.append("The symmetry was detected on the main part, which is not the largest part.")
    for role, surface, shape in (
        ("source", pair.source, pair.source_shape),
        ("target", pair.target, pair.target_shape),
    ):
        if not is_one and _is_smaller(surface, shape):
            notes.append(
                f"The main part of the {role} is not its largest part, but the one most similar to the main part of "
                "the other mesh."
            )
    for number, text in (OF_ONE if is_one else OF_TWO).items():
        if count := getattr(loose, number):
            parts = plural(count, "1 loose part", "{count} loose parts")
            notes.append(message(text, parts=parts, most=MAX_PAIRED_PARTS))
    return tuple(notes)


def _is_smaller(surface: Surface, shape: ShapeAnalysis) -> bool:
    """Whether a surface's main part is not its largest."""
    return bool(surface.components[np.argmax(shape.proxy.full.vertex_of >= 0)] > 0)
