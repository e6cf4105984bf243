# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights of clothes that follow the weights of a body, on balls."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer import WeightedBody, follow_weights, moving_with_skin
from zoomout_core.transfer.dressing import body_weights
from zoomout_core.tuning import retune

BODY = ball(1, count=2500, seed=3)
SHIRT = ball(1.03, count=800, seed=5)


def bend(points: np.ndarray, height: float) -> csr_array:
    """(n, 4) weights of two bones with a joint at a height; two more bones move nothing."""
    upper = np.clip(0.5 + (points[:, 2] - height), 0, 1)
    return csr_array(np.column_stack([1 - upper, upper, np.zeros((len(points), 2))]))


def follow(worn: zo.Surface, weights: csr_array, points: np.ndarray | None = None) -> np.ndarray:
    """(n, 4) weights of an object on a body whose joint is higher than on the body that wore it."""
    before, after = (WeightedBody(BODY, bend(BODY.vertices, height)) for height in (0.0, 0.3))
    places = worn.vertices if points is None else points
    return follow_weights(before, after, [worn], [places], [weights])[0].toarray()


def test_cloth_bends_where_the_other_body_does() -> None:
    given = bend(SHIRT.vertices, 0.0)
    wanted, found = bend(SHIRT.vertices, 0.3).toarray(), follow(SHIRT, given)
    assert np.abs(given - wanted).max() > 0.29
    assert np.abs(found - wanted).max() < 0.06
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-9)


def test_cloth_bound_unlike_the_skin_keeps_its_weights() -> None:
    given = np.zeros((len(SHIRT.vertices), 4))
    given[:, 2] = 0.5
    np.testing.assert_allclose(follow(SHIRT, csr_array(given)), given, atol=1e-9)


def test_cloth_close_to_the_skin_gets_its_weights() -> None:
    """Loose cloth keeps the difference, and so does cloth that moves unlike the skin."""
    body, loose = WeightedBody(BODY, bend(BODY.vertices, 0.0)), SHIRT.with_vertices(1.2 * SHIRT.vertices)
    given, stiff = bend(SHIRT.vertices, 0.15), csr_array(np.tile([0, 0, 0.5, 0.5], (len(SHIRT.vertices), 1)))
    worn = [SHIRT, loose, SHIRT]
    close, far, unlike = (
        found.toarray()
        for found in follow_weights(body, body, worn, [each.vertices for each in worn], [given, given, stiff])
    )
    np.testing.assert_allclose(far, given.toarray(), atol=1e-4)
    np.testing.assert_allclose(unlike, stiff.toarray(), atol=1e-4)
    assert np.abs(close - bend(SHIRT.vertices, 0.0)).mean() < 0.1 * np.abs(given - bend(SHIRT.vertices, 0.0)).mean()


def test_masked_vertices_keep_their_weights() -> None:
    given, mask = bend(SHIRT.vertices, 0.0), (SHIRT.vertices[:, 0] > 0.5) * 1.0
    before, after = (WeightedBody(BODY, bend(BODY.vertices, height)) for height in (0.0, 0.3))
    free, kept = (
        follow_weights(before, after, [SHIRT], [SHIRT.vertices], [given], keep)[0].toarray() for keep in (None, [mask])
    )
    changed = np.abs(free - given.toarray()).max(axis=1) > 0.01
    assert changed[mask > 0].any()
    np.testing.assert_allclose(kept[mask > 0], given.toarray()[mask > 0], atol=1e-9)
    np.testing.assert_allclose(kept[mask == 0], free[mask == 0], atol=1e-9)


def test_weight_changes_are_smooth_where_places_are_torn() -> None:
    """The place of one vertex is off, so that the skin below it has other weights."""
    given, places = bend(SHIRT.vertices, 0.0), SHIRT.vertices.copy()
    wrong = int(np.argmin(np.abs(places[:, 2])))
    places[wrong] = [0, 0, 1.03]
    wanted = bend(SHIRT.vertices, 0.3).toarray()[wrong]
    off = np.abs(follow(SHIRT, given, places)[wrong] - wanted).max()
    with retune(body_weights.BODY_WEIGHTS, smooth=1e-6):
        rough = np.abs(follow(SHIRT, given, places)[wrong] - wanted).max()
    assert off < 0.6 * rough


def test_number_of_bones_per_vertex_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(body_weights, "BONES", 1)
    rigid = csr_array((bend(BODY.vertices, 0.0).toarray() > 0.5).astype(float))
    given = csr_array((bend(SHIRT.vertices, 0.0).toarray() > 0.5).astype(float))
    other = WeightedBody(BODY, csr_array((bend(BODY.vertices, 0.3).toarray() > 0.5).astype(float)))
    (found,) = follow_weights(WeightedBody(BODY, rigid), other, [SHIRT], [SHIRT.vertices], [given])
    assert np.diff(found.indptr).max() == 1


def test_cloth_moves_with_the_skin_as_far_as_it_shares_its_bones() -> None:
    body, given = WeightedBody(BODY, bend(BODY.vertices, 0.0)), bend(SHIRT.vertices, 0.0)
    stiff = np.zeros_like(given.toarray())
    stiff[:, 0] = 1
    other = np.roll(stiff, 3, axis=1)
    same, hanging, apart, none = moving_with_skin(body, [SHIRT] * 4, [given, csr_array(stiff), csr_array(other), None])
    assert none is None
    np.testing.assert_allclose(same, 1)
    np.testing.assert_allclose(apart, 0, atol=1e-12)
    # Half of the weights in common is enough.
    np.testing.assert_allclose(hanging, np.minimum(2 * given.toarray()[:, 0], 1), atol=0.1)


def test_cloth_between_touching_limbs_does_not_follow_the_other_one() -> None:
    def legs(shape: zo.Surface, apart: float) -> zo.Surface:
        return zo.Surface.joined(
            [shape.with_vertices(shape.vertices + np.array([side * apart, 0, 0])) for side in (-1, 1)]
        )

    def of_sides(surface: zo.Surface) -> csr_array:
        is_left = surface.vertices[:, 0] < 0
        return csr_array(np.column_stack([is_left, ~is_left]).astype(float))

    body, other, worn = legs(BODY, 1.5), legs(BODY, 1.02), legs(SHIRT, 1.5)
    before, after = (WeightedBody(each, of_sides(each)) for each in (body, other))
    given, fitted = of_sides(worn), legs(SHIRT, 1.02).vertices
    (mixed,) = follow_weights(before, after, [worn], [fitted], [given])
    assert np.abs(mixed - given).max() > 0.2
    (found,) = follow_weights(before, after, [worn], [fitted], [given], shape=other.vertices)
    np.testing.assert_allclose(found.toarray(), given.toarray(), atol=1e-6)


@pytest.mark.parametrize(
    ("below", "same", "clipped"),
    [
        ([0.9, 0.1], [0.1, 0.9], [0.8, 0.2]),  # at most four times the weight of the same skin
        ([0.3, 0.7], [0.2, 0.8], [0.3, 0.7]),  # a little more is due to sliding
        ([1.0, 0.0], [0.0, 1.0], [0.0, 1.0]),  # the skin of another limb only
    ],
)
def test_weights_of_a_touching_limb_are_bounded(below: list[float], same: list[float], clipped: list[float]) -> None:
    np.testing.assert_allclose(body_weights._clip(csr_array([below]), csr_array([same])).toarray(), [clipped])
