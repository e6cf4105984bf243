# SPDX-License-Identifier: GPL-3.0-or-later
"""Blend with existing values: modes, factor and mask work the same way for every kind."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array
from transfer_meshes import sheet, tube

from zoomout_core.transfer import Attribute, Blend, Domain, Kind
from zoomout_core.transfer.attribute import is_nothing, nothing
from zoomout_core.transfer.blend import blend
from zoomout_core.transfer.normals import outward_normals

TARGET = sheet(tube, 12, 6).surface
N = len(TARGET.vertices)
COUNT = {
    Domain.POINT: N,
    Domain.EDGE: len(TARGET.edges),
    Domain.FACE: len(TARGET.face_start) - 1,
    Domain.CORNER: len(TARGET.corner_vertex),
}
RANDOM = np.random.default_rng(0)
MASK = RANDOM.uniform(0, 1, N)


def attribute(kind: Kind, domain: Domain, values: np.ndarray) -> Attribute:
    return Attribute("data", domain, kind, values)


def numbers(domain: Domain, width: int) -> np.ndarray:
    return RANDOM.uniform(0.1, 1, (COUNT[domain], width)).astype(np.float32)


@pytest.mark.parametrize("kind", [Kind.VECTOR, Kind.COLOR])
@pytest.mark.parametrize("domain", list(COUNT))
def test_numbers_are_mixed_by_factor_and_mask(kind: Kind, domain: Domain) -> None:
    new, old = numbers(domain, 4), numbers(domain, 4)
    both = attribute(kind, domain, new), attribute(kind, domain, old)
    half = blend(*both, TARGET, Blend(factor=0.5)).values
    assert half.dtype == np.float32
    np.testing.assert_allclose(half, (new + old) / 2, atol=1e-6)
    whole_mask = blend(*both, TARGET, Blend(mask=np.ones(N))).values
    np.testing.assert_allclose(whole_mask, new, atol=1e-6)
    masked = blend(*both, TARGET, Blend(mask=MASK)).values
    start, size = TARGET.face_start[:-1], np.diff(TARGET.face_start)
    amount = {
        Domain.POINT: MASK,
        Domain.EDGE: MASK[TARGET.edges].mean(axis=1),
        Domain.CORNER: MASK[TARGET.corner_vertex],
        Domain.FACE: np.add.reduceat(MASK[TARGET.corner_vertex], start) / size,
    }[domain][:, None]
    np.testing.assert_allclose(masked, amount * new + (1 - amount) * old, atol=1e-6)


def test_missing_mode_replaces_only_empty_values() -> None:
    new, old = numbers(Domain.POINT, 3), numbers(Domain.POINT, 3)
    old[::3] = 0
    old[1, 0] = 0
    result = blend(
        attribute(Kind.COLOR, Domain.POINT, new), attribute(Kind.COLOR, Domain.POINT, old), TARGET, Blend("missing")
    ).values
    np.testing.assert_array_equal(result[::3], new[::3])
    rest = np.arange(N) % 3 > 0
    np.testing.assert_array_equal(result[rest], old[rest])


def test_shape_key_is_missing_if_it_moves_nothing() -> None:
    new, old = (RANDOM.uniform(0.1, 1, (N, 2, 3)) for _ in range(2))
    old[:, 1], old[::3, 0] = 0, 0
    both = attribute(Kind.OFFSET, Domain.POINT, new), attribute(Kind.OFFSET, Domain.POINT, old)
    result = blend(*both, TARGET, Blend("missing", 0.5)).values
    np.testing.assert_array_equal(result[:, 0], old[:, 0])
    np.testing.assert_allclose(result[:, 1], new[:, 1] / 2)


def test_missing_attribute_counts_as_zero() -> None:
    new = numbers(Domain.POINT, 3)
    result = blend(attribute(Kind.VECTOR, Domain.POINT, new), None, TARGET, Blend(mask=MASK)).values
    np.testing.assert_allclose(result, new * MASK[:, None], atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "new", "old"),
    [(Kind.LABEL, 7, -2), (Kind.BOOLEAN, True, False), (Kind.LABEL, "left", "right")],
)
def test_labels_are_replaced_where_the_mask_is_above_one_half(kind: Kind, new: object, old: object) -> None:
    both = (attribute(kind, Domain.POINT, np.full(N, value)) for value in (new, old))
    result = blend(*both, TARGET, Blend(mask=MASK)).values
    np.testing.assert_array_equal(result == new, MASK > 0.5)
    assert set(result.tolist()) == {new, old}


def test_uvs_are_chosen_for_whole_faces() -> None:
    new, old = numbers(Domain.CORNER, 2), -numbers(Domain.CORNER, 2)
    both = (attribute(Kind.UV, Domain.CORNER, values) for values in (new, old))
    result = blend(*both, TARGET, Blend(mask=MASK)).values
    chosen = (result == new).all(axis=1)
    np.testing.assert_array_equal(result[~chosen], old[~chosen])
    of_face = np.add.reduceat(chosen.astype(int), TARGET.face_start[:-1])
    assert set(of_face.tolist()) == {0, 4}


def test_normals_stay_unit_vectors_and_turn_with_the_mask() -> None:
    count = COUNT[Domain.CORNER]
    new, old = np.tile([1.0, 0, 0], (count, 1)), np.tile([0, 0, 1.0], (count, 1))
    both = [attribute(Kind.NORMAL, Domain.CORNER, values) for values in (new, old)]
    result = blend(*both, TARGET, Blend(mask=MASK)).values
    share = MASK[TARGET.corner_vertex]
    np.testing.assert_allclose(np.linalg.norm(result, axis=1), 1)
    np.testing.assert_allclose(result[:, 0] * (1 - share), result[:, 2] * share, atol=1e-12)
    opposite = attribute(Kind.NORMAL, Domain.CORNER, -old)
    np.testing.assert_array_equal(blend(opposite, both[1], TARGET, Blend(factor=0.5)).values, old)


@pytest.mark.parametrize("domain", [Domain.POINT, Domain.CORNER, Domain.FACE])
def test_missing_normals_are_those_of_the_surface(domain: Domain) -> None:
    new = attribute(Kind.NORMAL, domain, np.tile([1.0, 0, 0], (COUNT[domain], 1)))
    outside = blend(new, None, TARGET, Blend(mask=np.zeros(N))).values
    np.testing.assert_allclose(outside, outward_normals(TARGET, domain))
    np.testing.assert_array_equal(blend(new, None, TARGET, Blend("missing")).values, new.values)


def skin(labels: tuple[str, ...], seed: int) -> Attribute:
    """Weights of some groups, two per vertex, that sum to one."""
    random = np.random.default_rng(seed)
    weights = np.zeros((N, len(labels)))
    for row in weights:
        row[random.permutation(len(labels))[:2]] = random.dirichlet((3, 3))
    return Attribute("skin", Domain.POINT, Kind.WEIGHT, csr_array(weights), labels)


def test_blended_weights_keep_their_sum_and_group_order() -> None:
    new, old = skin(("a", "b", "c"), 1), skin(("c", "b", "a"), 2)
    result = blend(new, old, TARGET, Blend(factor=0.25, mask=MASK), {"a", "b", "c"})
    assert result.labels == new.labels
    amount = 0.25 * MASK[:, None]
    expected = amount * new.values.toarray() + (1 - amount) * old.values.toarray()[:, ::-1]
    np.testing.assert_allclose(result.values.toarray(), expected, atol=1e-12)
    np.testing.assert_allclose(result.values.sum(axis=1), 1, atol=1e-12)


def test_missing_weights_are_judged_jointly_only_for_shared_groups() -> None:
    new = skin(("a", "b", "mask"), 1)
    table = np.zeros((N, 3))
    table[: N // 2, 0] = 1  # weights of a bone that the source lacks
    table[::2, 1] = 0.3
    old = Attribute("skin", Domain.POINT, Kind.WEIGHT, csr_array(table), ("other", "mask", "unrelated"))
    result = blend(new, old, TARGET, Blend("missing"), {"a", "b", "other"}).values.toarray()
    expected = new.values.toarray()
    expected[: N // 2, :2] = 0
    expected[::2, 2] = 0.3
    np.testing.assert_allclose(result, expected, atol=1e-12)


def test_groups_that_the_target_lacks_are_scaled_by_the_mask() -> None:
    new = skin(("a", "b", "c"), 1)
    for present in (None, skin(("d", "e"), 2)):
        result = blend(new, present, TARGET, Blend(mask=MASK)).values
        np.testing.assert_allclose(result.toarray(), new.values.toarray() * MASK[:, None], atol=1e-12)


def test_only_a_full_blend_replaces_existing_values() -> None:
    assert Blend().replaces
    for how in (Blend("missing"), Blend(factor=0.9), Blend(mask=np.ones(N)), Blend("missing", 0.5)):
        assert not how.replaces


def test_empty_values_are_zero_false_or_empty_strings() -> None:
    names = np.array([["", ""], ["a", ""], ["", "b"]], dtype=object)
    assert nothing(names, 2).tolist() == [["", ""], ["", ""]]
    np.testing.assert_array_equal(is_nothing(names), [True, False, False])
    table = np.zeros((3, 2, 2), dtype=np.float32)
    table[1, 1, 0] = 1e-9
    assert nothing(table, 5).shape == (5, 2, 2)
    assert nothing(table, 5).dtype == np.float32
    np.testing.assert_array_equal(is_nothing(table), [True, False, True])
    np.testing.assert_array_equal(is_nothing(np.array([False, True])), [True, False])


def test_invalid_blend_options_are_refused() -> None:
    new = attribute(Kind.SCALAR, Domain.POINT, np.ones(N))
    with pytest.raises(ValueError, match="mode is 'add'"):
        Blend("add")  # type: ignore[arg-type]
    for factor in (1.5, -0.5):
        with pytest.raises(ValueError, match=f"factor is {factor}: "):
            Blend(factor=factor)
    for mask in (np.ones(N + 1), np.full(N, 2.0), np.full(N, np.nan)):
        with pytest.raises(ValueError, match="mask must have a number from 0 to 1"):
            blend(new, None, TARGET, Blend(mask=mask))
