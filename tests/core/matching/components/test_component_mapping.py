# SPDX-License-Identifier: GPL-3.0-or-later
"""Loose parts map to partners, to pieces or wholes in their place, or to nothing, and are counted as such."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from loose_parts import map_parts, pair_around_body, part_of, sheet

from zoomout_core.matching.components.component_mapping import (
    _confidence,
    _correct_towards,
    _lies_on,
    _onto,
    _onto_pieces,
    _pieces,
    _transform,
)
from zoomout_core.matching.components.parts import Side
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

LEFT, RIGHT, TOP = (0.35, 0.0, 0.0), (-0.35, 0.0, 0.0), (0.0, 0.0, 0.6)
EYES = [ball(0.04, LEFT), ball(0.04, RIGHT)]
ROD = ball(1.0, TOP, (0.3, 0.04, 0.04), 300)


def side_of(*parts: Surface) -> Side:
    """A side without a body."""
    mesh = Surface.joined(parts).working
    return Side(mesh, mesh.to_surface(mesh.vertices), np.ones(len(mesh.vertices)), np.zeros(0, dtype=np.int64))


def thirds(rod: Surface) -> list[Surface]:
    """A rod cut crosswise into three."""
    x = rod.vertices[rod.triangles][:, :, 0]
    return [
        Surface(rod.vertices, rod.triangles[((x > low) & (x < high)).all(axis=1)])
        for low, high in ((-1, -0.1), (-0.1, 0.1), (0.1, 1))
    ]


def counts(pair: Any) -> tuple[int, ...]:
    found = map_parts(pair)
    return found.paired, found.others, found.alone, found.left, found.too_many


# --- counts -------------------------------------------------------------------------------------------------------


def test_parts_with_partners_are_counted_as_paired() -> None:
    assert counts(pair_around_body(EYES, EYES)) == (2, 0, 0, 0, 0)


def test_parts_that_only_one_surface_has_are_alone_or_left() -> None:
    assert counts(pair_around_body(EYES, [*EYES, ROD])) == (2, 0, 1, 0, 0)
    assert counts(pair_around_body([*EYES, ROD], EYES)) == (2, 0, 0, 1, 0)
    assert counts(pair_around_body([], EYES)) == (0, 0, 2, 0, 0)
    assert counts(pair_around_body(EYES, [])) == (0, 0, 0, 2, 0)


def test_unpaired_part_does_not_shift_the_images_of_others() -> None:
    def vertices_of_parts(surface: Surface, numbers: slice) -> np.ndarray:
        component = surface.working.component
        return np.flatnonzero(np.isin(component, np.arange(component.max() + 1)[numbers]))

    pair = pair_around_body(EYES, [ROD, *EYES])
    found = map_parts(pair)
    np.testing.assert_array_equal(np.sort(found.image.vertices), vertices_of_parts(pair.target, slice(2, None)))
    assert len(found.left_vertices) == 0
    pair = pair_around_body([ROD, *EYES], EYES)
    np.testing.assert_array_equal(map_parts(pair).left_vertices, vertices_of_parts(pair.source, slice(1, 2)))


def test_pieces_and_their_whole_map_to_each_other() -> None:
    assert counts(pair_around_body([ROD], thirds(ROD))) == (0, 3, 0, 0, 0)
    paired, others, alone, left, _ = counts(pair_around_body(thirds(ROD), [ROD]))
    assert (paired + others, alone, left) == (1, 0, 0)


def test_crumb_beside_a_large_part_maps_to_it() -> None:
    # It is too far away to be a piece, but within the tolerance of the body's map.
    crumb = ball(0.012, (0.1, 0, 0.611))
    assert counts(pair_around_body([sheet(0.4, TOP), *EYES], [crumb, *EYES])) == (2, 1, 0, 0, 0)
    away = crumb.with_vertices(crumb.vertices + 0.1)
    assert counts(pair_around_body([sheet(0.4, TOP), *EYES], [away, *EYES])) == (2, 0, 1, 1, 0)


def test_crumb_maps_to_its_part_beside_a_part_larger_than_the_body() -> None:
    cloak = sheet(2.0, (0, 0, -2))
    pair = pair_around_body([cloak, sheet(0.4, TOP)], [cloak, ball(0.012, (0.1, 0, 0.611))], number=1)
    assert counts(pair) == (1, 1, 0, 0, 0)


def test_parts_of_different_regions_are_not_matched() -> None:
    pair = pair_around_body([*EYES, ROD], [*EYES, ROD], [(0, 1), (1, 0), (2, 2)])
    assert counts(pair) == (1, 0, 2, 2, 0)


def test_parts_beyond_the_limit_map_to_the_nearest_part() -> None:
    away = np.random.default_rng(0).uniform(-1, 1, (300, 1, 3)) + np.array([0, 0, 3])
    larger = Surface((away + 0.03 * np.eye(4, 3)).reshape(-1, 3), np.arange(1200).reshape(-1, 4)[:, [0, 1, 2]])
    smaller = [ball(0.008, (0.1 * i, 0, 0.5), count=20) for i in range(3)]
    assert counts(pair_around_body(smaller, [larger, *smaller])) == (0, 3, 300, 0, 3)


# --- images of parts ------------------------------------------------------------------------------------------------


def test_part_maps_to_one_that_is_near_relative_to_its_size() -> None:
    for size in (0.02, 0.2):
        part = part_of(ball(size))
        assert _lies_on(part, part_of(ball(size, (0.2 * size, 0, 0))))
        assert not _lies_on(part, part_of(ball(size, (0.8 * size, 0, 0))))


def test_piece_at_the_far_end_maps_to_its_whole() -> None:
    end = thirds(ROD)[2]
    assert _lies_on(part_of(end), part_of(ROD))
    assert not _lies_on(part_of(ROD), part_of(end))
    assert not _lies_on(part_of(end), part_of(thirds(ROD)[0]))


def test_other_pieces_of_the_same_whole_are_included() -> None:
    pieces = [part_of(piece) for piece in thirds(ROD)]
    far, free = part_of(ball(0.04, LEFT)), np.zeros(4, dtype=bool)
    assert _pieces(part_of(ROD), 1, [*pieces, far], {1}, free) == [1, 0, 2]
    assert _pieces(part_of(ROD), 1, [*pieces, far], {1, 2}, free) == [1, 0]
    assert _pieces(part_of(ROD), None, [*pieces, far], set(), np.arange(4) == 2) == [0, 1]
    assert _pieces(part_of(ROD), 0, [part_of(ROD), *pieces], {0}, free) == [0]


def test_piece_maps_to_the_nearest_of_several_wholes() -> None:
    wholes = [part_of(ROD, off) for off in (0.012, 0.0, -0.012)]
    piece, free = part_of(thirds(ROD)[1]), np.zeros(3, dtype=bool)
    assert _pieces(piece, None, wholes, set(), free) == [1]
    assert _pieces(piece, None, wholes, set(), np.arange(3) == 1) != [1]
    assert _pieces(piece, None, wholes[:1], set(), free[:1] | True) == []


def pocket() -> Surface:
    """Two layers, 0.02 apart, joined along one edge: a pocket that is open on three sides."""
    low, count = sheet(0.2), 81
    edge = np.flatnonzero(low.vertices[:, 0] > 0.0999)
    strip = np.column_stack([edge[:-1], edge[1:], count + edge[1:], count + edge[:-1]])
    high = low.triangles[:, ::-1] + count
    corners = np.vstack([low.triangles, high, strip[:, [0, 2, 1]], strip[:, [0, 3, 2]]])
    return Surface(np.vstack([low.vertices, low.vertices + np.array([0, 0, 0.02])]), corners)


@pytest.mark.parametrize("flip", [False, True])
def test_layers_stay_apart_with_either_winding(flip: bool) -> None:
    source = side_of(pocket())
    piece, part = source.parts(source.points)[0], part_of(pocket())
    # The shift makes the other layer nearer.
    points = part.points + np.array([0, 0, 0.012])
    normals = part.mesh.vertex_normals * (-1 if flip else 1)
    image, residual = _onto(part.vertices, part.size, points, normals, [piece], source, 1.0)
    on = np.einsum("nc,ncx->nx", image.barycentric, source.points[source.mesh.triangles[image.triangle]])
    inner = part.points[:, 0] < 0.08
    np.testing.assert_allclose(on[inner, 2], part.points[inner, 2], atol=1e-9)
    np.testing.assert_allclose(residual, np.linalg.norm(on - points, axis=1), atol=1e-12)


def test_only_small_parts_take_the_centre_and_size_of_partners() -> None:
    small, partner = part_of(ball(0.02)), part_of(ball(0.03, (0.02, 0, 0)))
    np.testing.assert_allclose(_correct_towards(small, partner), partner.points, atol=1e-9)
    large = part_of(ball(0.2))
    np.testing.assert_array_equal(_correct_towards(large, part_of(ball(0.25))), large.points)


def test_small_parts_keep_their_shape_where_large_ones_bend() -> None:
    parts = [ball(0.25, LEFT, count=200), ball(0.02, RIGHT)]
    side = side_of(*parts)

    def transform(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, ...]:
        return points * [1, 1, 0.5] + [0, 0, 1], normals, np.full(len(points), 0.7)

    motion: Any = SimpleNamespace(transform=transform, handedness=1.0)
    points, normals, trust = _transform(side, motion)
    small = side.mesh.component == 1
    np.testing.assert_allclose(points[~small], transform(side.points, side.points)[0][~small])
    centred = [p[small] - p[small].mean(axis=0) for p in (points, side.points)]
    ratio = np.linalg.norm(centred[0], axis=1) / np.linalg.norm(centred[1], axis=1)
    assert np.ptp(ratio) < 0.1
    assert 0.6 < ratio.mean() < 0.95
    np.testing.assert_allclose(points[small].mean(axis=0), RIGHT + np.array([0, 0, 1]), atol=1e-3)
    np.testing.assert_allclose(normals[small], side.mesh.vertex_normals[small], atol=1e-2)
    np.testing.assert_array_equal(trust, 0.7)


# --- confidence of parts ------------------------------------------------------------------------------------------


def test_confidence_falls_with_the_squared_distance() -> None:
    left = 0.8 / _confidence(0.8, np.array([0.0, 0.01, 0.02, 0.04])) - 1
    assert left[0] == 0 < left[1]
    np.testing.assert_allclose(left[2:] / left[1:-1], 4)
    assert _confidence(0.8, np.array([0.03, 0.06]))[0] > 0.4 > _confidence(0.8, np.array([0.03, 0.06]))[1]


def test_confidence_in_a_partner_falls_with_the_squared_misfit() -> None:
    source = side_of(ball(0.04))
    theirs = source.parts(source.points)
    part, normals = theirs[0], source.mesh.vertex_normals

    def trust(misfit: float) -> float:
        image = _onto_pieces(part, normals, [0], 0, np.array([misfit]), theirs, source)
        assert image is not None
        return float(image.confidence.mean())

    assert 0.8 < trust(0.0) < 1
    np.testing.assert_allclose((trust(0) / trust(0.4) - 1) / (trust(0) / trust(0.2) - 1), 4)
    assert 0.2 < trust(0.5) / trust(0) < 0.8


def test_paired_parts_have_more_confidence_than_pieces() -> None:
    whole = map_parts(pair_around_body([ROD], [ROD])).image.confidence
    pieces = map_parts(pair_around_body([ROD], thirds(ROD))).image.confidence
    assert whole.min() > 0.85
    assert 0.4 < pieces.min() < pieces.max() < 0.75


def test_only_large_parts_take_the_trust_of_the_body() -> None:
    pair = pair_around_body([*EYES, ROD], [*EYES, ROD])
    certain, uncertain = map_parts(pair).image, map_parts(pair, 0.25).image
    on_eye = np.abs(pair.target.working.to_surface(pair.target.working.vertices)[certain.vertices, 2]) < 0.1
    np.testing.assert_allclose(uncertain.confidence[on_eye], certain.confidence[on_eye])
    np.testing.assert_allclose(uncertain.confidence[~on_eye], 0.5 * certain.confidence[~on_eye])


def test_misfitting_part_without_a_partner_has_no_image() -> None:
    source = side_of(sheet(0.2))
    theirs = source.parts(source.points)
    up = np.tile([0, 0, 1.0], (len(theirs[0].vertices), 1))
    for off, fits in ((0.01, True), (0.05, False)):
        part = part_of(sheet(0.2), np.array([0, 0, off]))
        assert (_onto_pieces(part, up, [0], None, np.zeros(1), theirs, source) is not None) is fits
        assert _onto_pieces(part, up, [0], 0, np.zeros(1), theirs, source) is not None
    assert _onto_pieces(part, up, [], None, np.zeros(1), theirs, source) is None
