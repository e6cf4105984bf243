# SPDX-License-Identifier: GPL-3.0-or-later
"""Map loose parts: move them with the body, then project them to partners, other parts, or all parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.embedded_surface import Neighbourhoods, project_to_embedding
from zoomout_core.geometry.procrustes import Moments, products
from zoomout_core.maps.nearest import nearest
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.components.boundary_loops import loops_on_loops
from zoomout_core.matching.components.fused_parts import FusedPart, find_fused
from zoomout_core.matching.components.parts import BODY_MAP_ERROR, MAX_PAIRED_PARTS, Part, Side, pair_parts
from zoomout_core.matching.components.similarity_field import SimilarityField, affine_maps, transform_points
from zoomout_core.matching.components.turned_parts import register_turned_parts
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.report.verdict import VERDICT

# Smaller parts (size at unit area) move by one similarity: any bending would only be an error of the body's map.
MIN_DEFORMABLE_SIZE = 0.06
# Parts occupy the same place if they are at most this far apart, in sizes of the part.
SAME_PLACE_DISTANCE = 0.25
# Weight of normals against positions, in sizes of the part, or in `BODY_MAP_ERROR` where that is smaller.
NORMAL_WEIGHT = 0.35
# Confidence in an exact fit to the part's partner, and in one to any other part.
PARTNER_CONFIDENCE = 0.9
OTHER_PART_CONFIDENCE = 0.5
# Misfit that halves the confidence in a partner.
HALF_CONFIDENCE_MISFIT = 0.5
NO_VERTICES = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Image:
    """Images of some vertices of the target on loose parts of the source."""

    vertices: Integers  # (n,) of the target's working mesh
    triangle: Integers  # (n,) of the source's working mesh
    barycentric: Floats  # (n, 3) in it
    confidence: Floats  # (n,) in [0, 1]

    @classmethod
    def concatenate(cls, images: Sequence[Image]) -> Image:
        none = cls(NO_VERTICES, NO_VERTICES, np.zeros((0, 3)), np.zeros(0))
        return cls(
            *(np.concatenate([getattr(image, field.name) for image in (none, *images)]) for field in fields(cls))
        )


@dataclass(frozen=True, eq=False)
class ComponentMap:
    """The map of the loose parts."""

    image: Image = field(default_factory=lambda: Image.concatenate([]))  # images of the parts that have one
    paired: int = 0  # number of the target's parts that have a partner
    others: int = 0  # number of those that map to other parts
    alone: int = 0  # number of those without an image
    fused: int = 0  # number of the source's parts that the target shows fused with its body
    left: int = 0  # number of the source's parts without an image on them
    left_vertices: Integers = field(default_factory=lambda: NO_VERTICES)  # their vertices in the source's working mesh
    too_many: int = 0  # number of parts beyond the largest ones, which were not paired one by one


def map_components(pair: Pair, body: SurfaceMap, confidence: Floats) -> ComponentMap:
    """Pair the loose parts of two surfaces, and map them, moved by the body's map of confidence (n,)."""
    source = Side.of(pair.source, pair.source_shape.proxy.full)
    target = Side.of(pair.target, pair.target_shape.proxy.full)
    theirs = source.parts(source.points)
    if not theirs:
        return ComponentMap(alone=len(target.parts(target.points)))
    motion = _motion(pair, source, target, body, confidence)
    found, met = _map_parts(pair, source, target, theirs, motion) if target.loose.any() else (ComponentMap(), set())
    images = body.interpolate(source.points[source.body_vertices])
    lost = {i: part for i, part in enumerate(theirs) if i not in met and _is_visible(part, pair, source)}
    fused = find_fused(pair, images, motion, source, target, lost)
    left = [part.vertices for i, part in enumerate(theirs) if i not in met and i not in fused]
    return replace(
        found,
        image=Image.concatenate([found.image, *(_onto_fused(each, theirs[i], source) for i, each in fused.items())]),
        fused=len(fused),
        left=len(left),
        left_vertices=np.concatenate([NO_VERTICES, *left]),
    )


def _is_visible(part: Part, pair: Pair, source: Side) -> bool:
    """Whether a part is visible on the source's outside, and may be visible on another surface."""
    visible = np.flatnonzero(pair.shares >= VERDICT.visible)
    return pair.source is not pair.target and source.mesh.component[part.vertices[0]] in visible


def _onto_fused(fused: FusedPart, part: Part, source: Side) -> Image:
    """The image on a part of the vertices of the target that show it."""
    max_confidence = PARTNER_CONFIDENCE / (1 + (fused.residual / HALF_CONFIDENCE_MISFIT) ** 2)
    return _onto(fused.vertices, part.size, fused.points, fused.normals, [part], source, max_confidence)[0]


def _map_parts(
    pair: Pair, source: Side, target: Side, theirs: Sequence[Part], motion: SimilarityField
) -> tuple[ComponentMap, set[int]]:
    """Map the target's loose parts; returns also the numbers of the source's parts that have images on them."""
    points, normals, around = _transform(target, motion)
    points, normals = register_turned_parts(pair, motion, source, target, theirs, points, normals)
    ours = target.parts(points)
    partners, misfit = pair_parts(
        ours[:MAX_PAIRED_PARTS],
        theirs[:MAX_PAIRED_PARTS],
        target.members([of_target for _, of_target in pair.regions])[:MAX_PAIRED_PARTS],
        source.members([of_source for of_source, _ in pair.regions])[:MAX_PAIRED_PARTS],
    )
    found, rest, met, others = [], ours[MAX_PAIRED_PARTS:], set(partners.values()), 0
    for i, part in enumerate(ours[:MAX_PAIRED_PARTS]):
        partner, strange = partners.get(i), np.isinf(misfit[i])
        pieces = _pieces(part, partner, theirs[:MAX_PAIRED_PARTS], set(partners.values()), strange)
        image = _onto_pieces(part, normals[part.vertices], pieces, partner, misfit[i], theirs, source)
        if image is None:
            rest += [] if strange.any() else [part]
            continue
        found.append(image if part.size < MIN_DEFORMABLE_SIZE else _beside_body(image, around))
        others += partner is None
        met.update(pieces)
    among_all = _onto_all(rest, source)
    number = np.cumsum(np.arange(source.mesh.component.max() + 1) != source.body) - 1
    for image in among_all:
        met.update(number[source.mesh.component[source.mesh.triangles[image.triangle, 0]]].tolist())
        found.append(_beside_body(image, around))
    others += len(among_all)
    alone = len(ours) - len(partners) - others
    unpaired = max(len(ours), len(theirs)) - MAX_PAIRED_PARTS
    image = Image.concatenate(found)
    return ComponentMap(image, len(partners), others, alone, too_many=max(unpaired, 0)), met


def _motion(pair: Pair, source: Side, target: Side, body: SurfaceMap, confidence: Floats) -> SimilarityField:
    """The motion of the target's body to the source's, in the frames of the two sides."""
    nodes = pair.target_shape.proxy.full_vertex
    images = body.interpolate(source.points[source.body_vertices])[nodes]
    return SimilarityField(target.points[target.body_vertices][nodes], images, confidence, pair.target_shape.basis)


def _transform(target: Side, motion: SimilarityField) -> tuple[Floats, Floats, Floats]:
    """(n, 3) points, (n, 3) normals and (n,) confidence of the target's mesh, its loose parts moved with the body."""
    loose = np.flatnonzero(target.loose)
    before, turned_from = target.points[loose], target.mesh.vertex_normals[loose]
    after, turned_to, confidence = motion.transform(before, turned_from)
    _, label = np.unique(target.mesh.component[loose], return_inverse=True)
    areas = target.areas[loose]
    share = csr_array((areas / np.bincount(label, areas)[label], (label, np.arange(len(loose)))))
    moments = Moments.of_products(share @ products(before, after))
    small = np.flatnonzero((np.sqrt(moments.spread) < MIN_DEFORMABLE_SIZE)[label])
    affine = affine_maps(moments, motion.handedness)[label[small]]
    after[small], turned_to[small] = transform_points(affine, before[small], turned_from[small])
    everywhere = np.zeros((len(target.points), 7))
    everywhere[loose] = np.column_stack([after, turned_to, confidence])
    return everywhere[:, :3], everywhere[:, 3:6], everywhere[:, 6]


def _pieces(
    part: Part, partner: int | None, theirs: Sequence[Part], partners: set[int], strange: Booleans
) -> list[int]:
    """Numbers of the source's parts that a part of the target maps to.

    These are its partner and, if that is only a piece of it, the other pieces; otherwise the part that it is a
    piece of. Parts that regions exclude are never among them.
    """
    pieces = [] if partner is None else [partner]
    for j, other in enumerate(theirs):
        inside = j not in partners and not strange[j] and _lies_on(other, part)
        if inside and not any(_lies_on(other, theirs[piece]) for piece in pieces):
            pieces.append(j)
    if not pieces:
        wholes = [j for j, other in enumerate(theirs) if not strange[j] and _lies_on(part, other)]
        pieces = sorted(wholes, key=lambda j: part.distance_to(theirs[j]))[:1]
    return pieces


def _lies_on(part: Part, whole: Part) -> bool:
    """Whether a part coincides with another one, or with a piece of it."""
    far = SAME_PLACE_DISTANCE * part.size
    offset = part.centre - whole.centre
    return bool(offset @ offset <= (whole.reach + far) ** 2) and part.distance_to(whole) <= far


def _onto_pieces(
    part: Part,  # of the target
    normals: Floats,  # (n, 3) of its vertices, on the source
    pieces: list[int],  # of the source, that it touches
    partner: int | None,  # its partner among them, if it has one
    misfit: Floats,  # (q,) with each of the source's parts
    theirs: Sequence[Part],  # the source's parts
    source: Side,  # with these parts
) -> Image | None:
    """The image of a part on some of the source's parts, by number, or None if it does not fit them."""
    if not pieces:
        return None
    onto = [theirs[j] for j in pieces]
    if pieces == [partner]:
        max_confidence = PARTNER_CONFIDENCE / (1 + (float(misfit[pieces[0]]) / HALF_CONFIDENCE_MISFIT) ** 2)
        return _onto(part.vertices, part.size, _correct_towards(part, onto[0]), normals, onto, source, max_confidence)[
            0
        ]
    image, residual = _onto(part.vertices, part.size, part.points, normals, onto, source, OTHER_PART_CONFIDENCE)
    return image if partner is not None or _fits(part, residual) else None


def _correct_towards(part: Part, partner: Part) -> Floats:
    """(n, 3) a part's points, corrected by its partner for errors of the body's map.

    A small part takes the centre and size of its partner; a large one moves its boundary loops to those of its partner.
    """
    if part.size < MIN_DEFORMABLE_SIZE:
        return (part.points - part.centre) * (partner.size / max(part.size, 1e-12)) + partner.centre
    return loops_on_loops(part, partner)


def _onto(
    vertices: Integers,
    size: float,
    points: Floats,
    normals: Floats,
    pieces: Sequence[Part],
    source: Side,
    max_confidence: float,
) -> tuple[Image, Floats]:
    """The closest points of some pieces of the source, in place and normal, and (n,) the distances to them.

    The part's vertices (n,) have the places `points` (n, 3) and the normals `normals` (n, 3) on the source. An exact
    fit has confidence `max_confidence`.
    """
    first = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    positions = np.concatenate([piece.points for piece in pieces])
    corners = np.concatenate([piece.corners + start for piece, start in zip(pieces, first[:-1], strict=True)])
    facing = source.mesh.vertex_normals[np.concatenate([piece.vertices for piece in pieces])]
    # An open sheet has no outside: the side of each piece that agrees with the part is the one that is meant.
    piece_of = np.repeat(np.arange(len(pieces)), np.diff(first))
    near = nearest(points, positions)
    agreement = np.bincount(piece_of[near], np.einsum("ij,ij->i", normals, facing[near]), minlength=len(pieces))
    facing = facing * np.where(agreement < 0, -1, 1)[piece_of, None]
    weight = NORMAL_WEIGHT * min(size, BODY_MAP_ERROR)
    embedded, queries = np.hstack([positions, weight * facing]), np.hstack([points, weight * normals])
    triangle, barycentric = project_to_embedding(
        queries, embedded, Neighbourhoods(corners, len(embedded)), nearest(queries, embedded)
    )
    residual = np.linalg.norm(np.einsum("nc,ncx->nx", barycentric, positions[corners[triangle]]) - points, axis=1)
    of_source = np.concatenate([piece.triangles for piece in pieces])[triangle]
    return Image(vertices, of_source, barycentric, _confidence(max_confidence, residual)), residual


def _onto_all(parts: Sequence[Part], source: Side) -> list[Image]:
    """The closest points of all loose parts of the source together that are there."""
    if not parts:
        return []
    triangles = np.flatnonzero(source.loose[source.mesh.triangles[:, 0]])
    corners = source.mesh.triangles[triangles]
    points = np.concatenate([part.points for part in parts])
    triangle, barycentric = closest_points(points, source.points, corners)
    residual = np.linalg.norm(np.einsum("nc,ncx->nx", barycentric, source.points[corners[triangle]]) - points, axis=1)
    ends = np.cumsum([len(part.vertices) for part in parts])
    split = (np.split(array, ends[:-1]) for array in (triangles[triangle], barycentric, residual))
    return [
        Image(part.vertices, onto, at, _confidence(OTHER_PART_CONFIDENCE, off))
        for part, onto, at, off in zip(parts, *split, strict=True)
        if _fits(part, off)
    ]


def _fits(part: Part, residual: Floats) -> bool:
    """Whether a part coincides with its image, which is at distances (n,)."""
    return float(np.sqrt(part.weights @ residual**2)) <= SAME_PLACE_DISTANCE * (part.size + BODY_MAP_ERROR)


def _confidence(max_confidence: float, residual: Floats) -> Floats:
    """(n,) factor of the confidence in an image at distances (n,)."""
    return np.asarray(max_confidence / (1 + (residual / BODY_MAP_ERROR) ** 2))


def _beside_body(image: Image, around: Floats) -> Image:
    """An image whose confidence depends equally on its own fit and on the body around it, (n,) for all vertices."""
    return replace(image, confidence=np.sqrt(image.confidence * around[image.vertices]))
