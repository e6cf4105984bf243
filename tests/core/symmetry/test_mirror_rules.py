# SPDX-License-Identifier: GPL-3.0-or-later
"""Which side's value wins, for each domain, kind and direction, tested exactly on a flat shape."""

from __future__ import annotations

import numpy as np
import pytest
from butterfly import grid, mirrored_vertex, self_map
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.mesh.surface import Surface
from zoomout_core.symmetry.mirror import (
    asymmetry,
    flip_names,
    has_mean,
    mirror,
    own_share_of,
    symmetrise,
    with_partners,
)
from zoomout_core.symmetry.offsets import left_share, split_offsets
from zoomout_core.symmetry.self_map import SelfMap
from zoomout_core.transfer.attribute import mean_over_vertices

SURFACE = grid()
SYMMETRY = self_map(SURFACE)
X = SURFACE.vertices[:, 0]
LEFT, RIGHT, MIDDLE = X > 1e-9, X < -1e-9, np.abs(X) < 1e-9
OTHER = mirrored_vertex(SURFACE)


def point(values: np.ndarray, kind: zo.Kind = zo.Kind.SCALAR) -> zo.Attribute:
    return zo.Attribute("x", zo.Domain.POINT, kind, values)


@pytest.mark.parametrize(
    ("direction", "on_left", "on_right", "in_middle"),
    [("left_to_right", 1, 0, 0.5), ("right_to_left", 0, 1, 0.5), ("exchange", 0, 0, 0), ("average", 0.5, 0.5, 0.5)],
)
def test_direction_sets_the_share_of_own_values(
    direction: str, on_left: float, on_right: float, in_middle: float
) -> None:
    share = own_share_of(zo.Domain.POINT, SYMMETRY, direction)  # type: ignore[arg-type]
    np.testing.assert_array_equal(share, on_left * LEFT + on_right * RIGHT + in_middle * MIDDLE)
    own = np.random.default_rng(0).random(len(X))
    found = symmetrise(point(own), SYMMETRY, direction).values  # type: ignore[arg-type]
    np.testing.assert_allclose(found, share * own + (1 - share) * own[OTHER], atol=1e-12)


def test_mean_over_vertices_is_that_of_the_element_centre() -> None:
    surface = grid(columns=5, rows=2)  # the middle column of faces straddles the line
    distance = self_map(surface).distance
    middles = surface.vertices[surface.corner_vertex].reshape(-1, 4, 3).mean(axis=1)[:, 0]
    np.testing.assert_allclose(mean_over_vertices(distance, zo.Domain.FACE, surface), middles, atol=1e-12)
    np.testing.assert_allclose(
        mean_over_vertices(distance, zo.Domain.CORNER, surface), np.repeat(middles, 4), atol=1e-12
    )
    of_edges = surface.vertices[surface.edges][:, :, 0].mean(axis=1)
    np.testing.assert_allclose(mean_over_vertices(distance, zo.Domain.EDGE, surface), of_edges, atol=1e-12)


def test_edges_along_the_line_keep_their_own_values() -> None:
    ends = X[SURFACE.edges]
    along = (np.abs(ends) < 1e-9).all(axis=1)
    for direction, side in (("left_to_right", 1), ("right_to_left", -1)):
        share = own_share_of(zo.Domain.EDGE, SYMMETRY, direction)  # type: ignore[arg-type]
        np.testing.assert_array_equal(share == 1, along | (side * ends.mean(axis=1) > 1e-9))
    assert (own_share_of(zo.Domain.EDGE, SYMMETRY, "average") == 0.5).all()
    assert (own_share_of(zo.Domain.EDGE, SYMMETRY, "exchange") == 0).all()


def test_long_edges_beside_the_line_count_as_along_it() -> None:
    # The width decides whether edges beside the line are nearer to it than half their length.
    for width, kept in ((0.3, True), (6.0, False)):
        surface = grid(columns=5, rows=2, width=width)
        symmetry = self_map(surface)
        beside = (np.abs(surface.vertices[surface.edges][:, :, 0] + width / 10) < 1e-9).all(axis=1)
        share = own_share_of(zo.Domain.EDGE, symmetry, "left_to_right")
        assert beside.sum() == 2
        assert (share[beside] == kept).all()


def test_labels_come_from_one_side_and_are_not_averaged() -> None:
    label = np.where(LEFT, "left", np.where(RIGHT, "right", "middle"))
    found = symmetrise(point(label, zo.Kind.LABEL), SYMMETRY, "left_to_right").values
    np.testing.assert_array_equal(found, np.where(MIDDLE, "middle", "left"))
    found = symmetrise(point(label, zo.Kind.LABEL), SYMMETRY, "exchange").values
    np.testing.assert_array_equal(found, np.where(LEFT, "right", np.where(RIGHT, "left", "middle")))
    with pytest.raises(zo.MeshError, match="cannot be averaged"):
        symmetrise(point(label, zo.Kind.LABEL), SYMMETRY, "average")


def test_average_of_marks_and_selections_is_their_union() -> None:
    mark = np.where(LEFT & (np.arange(len(X)) % 3 == 0), 0.7, np.where(RIGHT & (np.arange(len(X)) % 5 == 0), 0.2, 0))
    found = symmetrise(point(mark, zo.Kind.MARK), SYMMETRY, "average").values
    np.testing.assert_allclose(found, np.maximum(mark, mark[OTHER]), atol=1e-9)
    chosen = point(mark > 0, zo.Kind.BOOLEAN)
    np.testing.assert_array_equal(symmetrise(chosen, SYMMETRY, "average").values, (mark > 0) | (mark > 0)[OTHER])
    kinds = {kind for kind in zo.Kind if has_mean(point(np.zeros(1), kind))}
    assert {zo.Kind.SCALAR, zo.Kind.COLOR, zo.Kind.WEIGHT, zo.Kind.BOOLEAN, zo.Kind.MARK} <= kinds
    assert not kinds & {zo.Kind.LABEL, zo.Kind.UV, zo.Kind.QUATERNION}


def test_symmetry_without_sides_refuses_one_sided_directions() -> None:
    turn = self_map(SURFACE, distance=0 * X)
    assert not turn.has_sides
    for direction in ("left_to_right", "right_to_left"):
        with pytest.raises(zo.MeshError, match="no left and right"):
            own_share_of(zo.Domain.POINT, turn, direction)  # type: ignore[arg-type]
    np.testing.assert_array_equal(own_share_of(zo.Domain.POINT, turn, "exchange"), 0)
    with pytest.raises(ValueError, match="direction"):
        own_share_of(zo.Domain.POINT, SYMMETRY, "up")  # type: ignore[arg-type]


def weights(table: np.ndarray, names: tuple[str, ...]) -> zo.Attribute:
    return zo.Attribute("skin", zo.Domain.POINT, zo.Kind.WEIGHT, csr_array(table), names)


NAMES = ("Hand.L", "Hand.R", "Spine")
LOPSIDED = np.column_stack([np.clip(X, 0, 1), np.clip(-X, 0, 1) / 2, 1 - np.clip(X, 0, 1) - np.clip(-X, 0, 1) / 2])


def test_mirrored_weights_swap_sides_and_names() -> None:
    flipped = LOPSIDED[OTHER][:, [1, 0, 2]]
    skin = weights(LOPSIDED, NAMES)
    np.testing.assert_allclose(mirror(skin, SYMMETRY).values.toarray(), flipped, atol=1e-9)
    np.testing.assert_array_equal(flip_names(skin).values.toarray(), LOPSIDED[:, [1, 0, 2]])
    for direction, own in (("left_to_right", LEFT), ("right_to_left", RIGHT), ("exchange", 0 * X > 1)):
        expected = np.where((own | MIDDLE)[:, None], LOPSIDED, flipped)
        found = symmetrise(skin, SYMMETRY, direction).values.toarray()  # type: ignore[arg-type]
        np.testing.assert_allclose(found[~MIDDLE], expected[~MIDDLE], atol=1e-9)
    mean = symmetrise(skin, SYMMETRY, "average").values.toarray()
    np.testing.assert_allclose(mean, (LOPSIDED + flipped) / 2, atol=1e-9)


def test_groups_per_vertex_do_not_grow_and_can_be_limited() -> None:
    table = np.zeros((len(X), 4))
    table[:, 0] = np.where(LEFT, 0.7, 0.6)
    table[:, 1] = np.where(LEFT, 0.3, 0)
    table[:, 2] = np.where(LEFT, 0, 0.4)
    skin = weights(table, ("a", "b", "c", "d"))
    mean = symmetrise(skin, SYMMETRY, "average").values
    assert np.diff(mean.indptr).max() == 2
    np.testing.assert_allclose(mean.sum(axis=1), 1, atol=1e-9)
    one = symmetrise(skin, SYMMETRY, "average", limit=1).values
    assert np.diff(one.indptr).max() == 1


def test_missing_partner_group_receives_mirrored_weights() -> None:
    skin = weights(LOPSIDED[:, [0, 2]], ("Hand.L", "Spine"))
    found = symmetrise(skin, SYMMETRY, "left_to_right")
    assert found.labels == ("Hand.L", "Spine", "Hand.R")
    left = LOPSIDED[:, [0, 2]]
    np.testing.assert_allclose(found.values.toarray()[LEFT], np.column_stack([left, 0 * X])[LEFT], atol=1e-9)
    mirrored_left = np.column_stack([0 * X, left[OTHER][:, 1], left[OTHER][:, 0]])
    np.testing.assert_allclose(found.values.toarray()[RIGHT], mirrored_left[RIGHT], atol=1e-9)


def test_empty_weights_stay_empty() -> None:
    skin = weights(np.zeros((len(X), 2)), ("a", "b"))
    for direction in ("average", "left_to_right"):
        assert symmetrise(skin, SYMMETRY, direction).values.nnz == 0  # type: ignore[arg-type]


def test_quaternions_differ_if_any_component_differs() -> None:
    same = np.tile([1.0, 0, 0, 0], (len(X), 1))
    assert not asymmetry(point(same, zo.Kind.QUATERNION), SYMMETRY).any()
    other = np.where(LEFT[:, None], same, [0, 0, 0, 1.0])
    np.testing.assert_array_equal(asymmetry(point(other, zo.Kind.QUATERNION), SYMMETRY), ~MIDDLE)


def test_missing_partners_are_added_once() -> None:
    skin = weights(LOPSIDED[:, [0, 2]], ("Hand.L", "Spine"))
    both = with_partners(skin)
    assert both.labels == ("Hand.L", "Spine", "Hand.R")
    assert both.values.shape == (len(X), 3)
    assert with_partners(both) is both
    assert with_partners(skin, others=("Hand.R",)).labels == both.labels


def test_asymmetry_is_the_distance_to_the_mirrored_value() -> None:
    values = np.random.default_rng(0).random((len(X), 3))
    expected = np.linalg.norm(values - values[OTHER], axis=1)
    np.testing.assert_allclose(asymmetry(point(values, zo.Kind.COLOR), SYMMETRY), expected, atol=1e-12)
    label = np.arange(len(X)) % 3
    np.testing.assert_array_equal(
        asymmetry(point(label, zo.Kind.LABEL), SYMMETRY), (label != label[OTHER]).astype(float)
    )
    apart = np.where(LEFT[:, None], [1.0, 0, 0], [0, 0, 1.0])
    both_sides = asymmetry(weights(apart, NAMES), SYMMETRY)
    np.testing.assert_allclose(both_sides[~MIDDLE], 1)  # all weight of a vertex is in other groups
    np.testing.assert_allclose(both_sides[MIDDLE], 0)


def test_unused_vertices_keep_their_values() -> None:
    surface = Surface(np.vstack([SURFACE.vertices, [[-3.0, 0, 0]]]), SURFACE.corner_vertex.reshape(-1, 4))
    there = zo.SurfaceMap(
        np.append(SYMMETRY.surface_map.triangle, 0),
        np.vstack([SYMMETRY.surface_map.barycentric, [[1.0, 0, 0]]]),
        surface.triangles,
    )
    symmetry = SelfMap(
        surface=surface,
        surface_map=there,
        confidence=np.ones(len(X) + 1),
        reverses_orientation=True,
        distance=surface.vertices[:, 0],
    )
    for direction in ("left_to_right", "exchange", "average"):
        assert own_share_of(zo.Domain.POINT, symmetry, direction)[-1] == 1  # type: ignore[arg-type]
        found = symmetrise(weights(np.vstack([LOPSIDED, [[0.1, 0, 0.2]]]), NAMES), symmetry, direction)  # type: ignore[arg-type]
        np.testing.assert_allclose(found.values.toarray()[-1], [0.1, 0, 0.2])


# --- sides of displacements ---------------------------------------------------------------------------------


def test_left_share_is_smooth_within_its_blend_and_hard_beyond() -> None:
    fine = self_map(grid(columns=240, rows=1))
    x, root = fine.surface.vertices[:, 0], np.sqrt(fine.surface.area)
    for blend in (0.02, 0.1):
        share = left_share(fine, blend)
        assert (share[x > blend * root] == 1).all()
        assert (share[x < -blend * root] == 0).all()
        inside = np.abs(x) < 0.999 * blend * root
        assert ((share > 0) & (share < 1))[inside].all()
        np.testing.assert_allclose(share + share[mirrored_vertex(fine.surface)], 1, atol=1e-12)
        ascending = share[np.argsort(x, kind="stable")]
        assert (np.diff(ascending) >= -1e-12).all()
        # The split has zero slope at both ends.
        near_end = np.abs(np.abs(x) - blend * root) < 0.1 * blend * root
        assert np.minimum(share, 1 - share)[near_end].max(initial=0) < 0.02
    hard = left_share(fine, 0.0)
    assert set(hard[np.abs(x) > 1e-6]) == {0.0, 1.0}
    default = left_share(fine)
    assert (np.abs(x)[(default > 0) & (default < 1)] < 0.1 * root).all()
    assert ((default > 0) & (default < 1))[np.abs(x) < 0.02 * root].all()


def test_left_and_right_parts_add_up_to_the_displacement() -> None:
    offsets = np.random.default_rng(0).normal(size=(len(X), 3))
    left, right = split_offsets(offsets, SYMMETRY)
    np.testing.assert_allclose(left + right, offsets)
    np.testing.assert_array_equal(left[X < -0.2], 0)
    np.testing.assert_array_equal(right[X > 0.2], 0)
    with pytest.raises(zo.MeshError, match="no left and right"):
        split_offsets(offsets, self_map(SURFACE, distance=0 * X))


def test_sides_have_a_middle_band_of_given_width() -> None:
    np.testing.assert_array_equal(SYMMETRY.sides(), np.sign(np.where(MIDDLE, 0, X)))
    np.testing.assert_array_equal(SYMMETRY.sides(0.5), np.where(np.abs(X) <= 0.5, 0, np.sign(X)))
    assert SYMMETRY.has_sides
    crossing = SYMMETRY.line
    np.testing.assert_allclose(crossing.points[:, 0], 0, atol=1e-9)
