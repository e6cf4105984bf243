# SPDX-License-Identifier: GPL-3.0-or-later
"""Skin weights stay sparse, with few per vertex, and sum to one."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy.sparse import csr_array, random_array
from transfer_meshes import Sheet, identity, permute, sheet, split_at_faces, true_map, tube

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.transfer import Attribute, Domain, Kind, transfer
from zoomout_core.transfer.rigging.weights import rename_groups, sum_to_one

GRID = (120, 80)


@pytest.fixture(scope="module")
def source() -> Sheet:
    return sheet(tube, *GRID)


@pytest.fixture(scope="module")
def target() -> Sheet:
    return sheet(tube, 97, 61, jitter=0.2, twist=0.05, sides=3, seed=1)


def chain(parameters: np.ndarray, bones: int) -> csr_array:
    """(n, bones) weights of a chain along b: two bones per vertex, linear between their joints."""
    place = parameters[:, 1] * (bones - 1)
    bone = np.minimum(np.floor(place), bones - 2).astype(int)
    part = place - bone
    rows = np.repeat(np.arange(len(place)), 2)
    columns = np.stack([bone, bone + 1], axis=1).ravel()
    weights = csr_array((np.stack([1 - part, part], axis=1).ravel(), (rows, columns)), shape=(len(place), bones))
    weights.eliminate_zeros()
    return weights


def random_weights(count: int, groups: int, each: int, seed: int = 0) -> csr_array:
    """(n, groups) random weights, `each` per vertex, that sum to one."""
    random = np.random.default_rng(seed)
    columns = np.argsort(random.random((count, groups)), axis=1)[:, :each]
    data = random.dirichlet(np.full(each, 3.0), count)
    return csr_array((data.ravel(), (np.repeat(np.arange(count), each), columns.ravel())), shape=(count, groups))


def transfer_weights(weights: csr_array, source: Sheet, target: Sheet, **options: object) -> csr_array:
    return transfer_with_notes(weights, source, target, **options)[0]


def transfer_with_notes(
    weights: csr_array, source: Sheet, target: Sheet, **options: object
) -> tuple[csr_array, tuple[str, ...]]:
    """The transferred weights and their notes."""
    names = tuple(f"bone {i}" for i in range(weights.shape[1]))
    attribute = Attribute("skin", Domain.POINT, Kind.WEIGHT, weights, names)
    surface_map = true_map(source, *GRID, target.parameters)
    result = transfer(attribute, surface_map, source.surface, target.surface, **options)
    assert result.labels == names
    assert result.values.dtype == weights.dtype
    return result.values, result.notes


def test_linear_weights_transfer_exactly(source: Sheet, target: Sheet) -> None:
    # Joints are on vertex rings of the source, so the formula is linear in each triangle.
    result = transfer_weights(chain(source.parameters, 21), source, target)
    truth = chain(target.parameters, 21).toarray()
    truth[truth < 1e-4] = 0
    truth /= truth.sum(axis=1, keepdims=True)
    assert np.abs(result.toarray() - truth).max() < 1e-9
    assert np.diff(result.indptr).max() == 2


@pytest.mark.parametrize("limit", [1, 3, 4, None])
def test_every_vertex_has_at_most_the_limit_and_sums_to_one(source: Sheet, target: Sheet, limit: int | None) -> None:
    weights = random_weights(len(source.parameters), 60, 4)
    result = transfer_weights(weights, source, target, limit=limit)
    kept = np.diff(result.indptr)
    assert kept.max() == (limit or 4)
    assert result.data.min() > 0
    assert np.abs(result.sum(axis=1) - 1).max() < 1e-12


def largest(full: np.ndarray, limit: int) -> np.ndarray:
    """Weights (n, groups), the largest of each row, scaled to sum to one."""
    full = np.where(full < 1e-4, 0, full)
    order = np.argsort(-full, axis=1, kind="stable")[:, :limit]
    kept = np.zeros_like(full)
    np.put_along_axis(kept, order, np.take_along_axis(full, order, axis=1), axis=1)
    return kept / kept.sum(axis=1, keepdims=True)


@pytest.mark.parametrize("limit", [4, 5, None])
def test_largest_weights_are_kept(source: Sheet, target: Sheet, limit: int | None) -> None:
    weights = random_weights(len(source.parameters), 60, 4)
    full = true_map(source, *GRID, target.parameters).interpolate(weights.toarray())
    result = transfer_weights(weights, source, target, limit=limit).toarray()
    assert np.abs(result - largest(full, limit or 4)).max() < 1e-12


def crowded(parameters: np.ndarray, bones: int = 60) -> csr_array:
    """(n, bones) smooth weights with many bones per vertex."""
    offset = parameters[:, None] - np.random.default_rng(0).random((bones, 2))
    offset[:, :, 0] -= np.round(offset[:, :, 0])
    weights = np.exp(-(offset**2).sum(axis=2) / 0.1**2)
    weights[weights < 1e-4] = 0
    return csr_array(weights / weights.sum(axis=1, keepdims=True))


def test_tight_limit_reduces_steps_between_neighbours(source: Sheet) -> None:
    target = sheet(tube, 200, 130, jitter=0.2, sides=3, seed=1)
    weights = crowded(source.parameters)
    edges, _ = unique_edges(target.surface.triangles)

    def steps(result: np.ndarray) -> np.ndarray:
        return np.abs(result[edges[:, 0]] - result[edges[:, 1]]).sum(axis=1)

    result = transfer_weights(weights, source, target, limit=4).toarray()
    hard = largest(transfer_weights(weights, source, target).toarray(), 4)
    assert ((result > 0) <= (hard > 0)).all()
    assert np.abs(result.sum(axis=1) - 1).max() < 1e-12
    assert np.quantile(steps(result), 0.99) < 0.85 * np.quantile(steps(hard), 0.99)


def test_tight_limit_does_not_tear_coincident_borders(source: Sheet) -> None:
    target = sheet(tube, 97, 61, jitter=0.2, sides=3, seed=1)
    apart, vertex = split_at_faces(target.surface)
    surface_map = true_map(source, *GRID, target.parameters)
    corners = SurfaceMap(surface_map.triangle[vertex], surface_map.barycentric[vertex], surface_map.source_triangles)
    attribute = Attribute("skin", Domain.POINT, Kind.WEIGHT, crowded(source.parameters))
    whole = transfer(attribute, surface_map, source.surface, target.surface, limit=3).values
    torn = transfer(attribute, corners, source.surface, apart, limit=3).values
    assert abs(torn - whole[vertex]).max() < 1e-9


def test_renamed_groups_keep_their_weights_and_equal_names_merge(source: Sheet) -> None:
    weights = random_weights(len(source.parameters), 4, 3)
    skin = Attribute("skin", Domain.POINT, Kind.WEIGHT, weights, ("a", "b", "c", "d"))
    swapped = rename_groups(skin, {"a": "b", "b": "a"})
    assert swapped.labels == ("b", "a", "c", "d")
    assert abs(swapped.values - weights).max() == 0
    joined = rename_groups(skin, {"a": "d", "c": "hip"})
    assert joined.labels == ("d", "b", "hip")
    assert np.abs(joined.values.toarray() - weights.toarray() @ np.eye(3)[[0, 1, 2, 0]]).max() < 1e-15


def test_masks_are_interpolated_without_normalization(source: Sheet, target: Sheet) -> None:
    # Eight bones and two masks: one is 1 everywhere, the other on 30% of the surface.
    bones = random_weights(len(source.parameters), 8, 4).toarray()
    masks = np.stack([np.ones(len(bones)), source.parameters[:, 1] > 0.7], axis=1)
    weights = csr_array(np.concatenate([bones, masks], axis=1))
    surface_map = true_map(source, *GRID, target.parameters)
    for normalised in (np.arange(8), np.arange(10) < 8):
        result = transfer_weights(weights, source, target, normalised=normalised, limit=2).toarray()
        expected = surface_map.interpolate(masks)
        expected[expected < 1e-4] = 0
        assert np.abs(result[:, 8:] - expected).max() < 1e-12
        assert np.abs(result[:, :8].sum(axis=1) - 1).max() < 1e-12
        assert (result[:, :8] > 0).sum(axis=1).max() == 2


def test_unlocked_groups_share_the_room_left_by_locked_ones(source: Sheet, target: Sheet) -> None:
    rest = np.random.default_rng(0).uniform(0, 1, len(target.parameters))
    rest[:10] = 0
    result, (note,) = transfer_with_notes(random_weights(len(source.parameters), 20, 4), source, target, room=rest)
    assert np.abs(result.sum(axis=1) - np.where(rest < 1e-4, 0, rest)).max() < 1e-12
    assert f"no weight for other groups on {(rest < 1e-4).sum()} of {len(rest):,} vertices" in note


def test_weights_of_locked_source_groups_are_redistributed(source: Sheet, target: Sheet) -> None:
    # Three of 20 groups are locked on the target, and leave half of each vertex's sum.
    weights = random_weights(len(source.parameters), 20, 4)
    result = transfer_weights(csr_array(weights[:, 3:]), source, target, sums=weights.sum(axis=1), room=0.5).sum(axis=1)
    assert np.abs(result[result > 0] - 0.5).max() < 1e-12
    assert (result > 0).mean() > 0.9


def test_partial_sums_are_kept_if_there_is_room(source: Sheet, target: Sheet) -> None:
    weights = csr_array(random_weights(len(source.parameters), 20, 4) * 0.4)
    room = np.where(target.parameters[:, 1] < 0.5, 0.1, 0.7)
    result, notes = transfer_with_notes(weights, source, target, room=room)
    np.testing.assert_allclose(result.sum(axis=1), np.minimum(room, 0.4), atol=1e-12)
    assert notes == ()


def test_sums_above_one_are_kept(source: Sheet, target: Sheet) -> None:
    masks = csr_array(random_weights(len(source.parameters), 20, 4) * 2.5)
    assert np.abs(transfer_weights(masks, source, target).sum(axis=1) - 2.5).max() < 1e-12


def test_skins_are_distinguished_from_masks_by_their_sums(source: Sheet) -> None:
    skin = random_weights(len(source.parameters), 20, 4).astype(np.float32)
    assert sum_to_one(skin)
    skin.data[:4] = 0
    assert not sum_to_one(skin)


def test_zero_and_partial_sums_are_kept(source: Sheet, target: Sheet) -> None:
    height = source.parameters[:, 1]
    weights = chain(source.parameters, 21).multiply(np.where(height < 0.25, 0, np.where(height < 0.5, 0.4, 1))[:, None])
    result = transfer_weights(csr_array(weights), source, target).sum(axis=1)
    row = 1 / 80
    assert (result[target.parameters[:, 1] < 0.25 - row] == 0).all()
    partial = (target.parameters[:, 1] > 0.25) & (target.parameters[:, 1] < 0.5 - row)
    assert result[partial] == pytest.approx(0.4, abs=1e-12)
    assert result[target.parameters[:, 1] > 0.5] == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("value", [0.0, 1e-6])
def test_empty_groups_stay_empty(source: Sheet, target: Sheet, value: float) -> None:
    weights = csr_array(np.full((len(source.parameters), 2), value))
    assert transfer_weights(weights, source, target).nnz == 0
    assert transfer_weights(weights, source, target, room=0.5).nnz == 0


def test_the_identity_returns_the_weights(source: Sheet) -> None:
    for dtype, rounding in ((np.float64, 1e-12), (np.float32, 1e-6)):
        weights = random_weights(len(source.parameters), 60, 4)
        weights.data[:] = np.round(weights.data.reshape(-1, 4) * 64).clip(1).ravel() / 64  # none is too small
        weights = csr_array(weights / weights.sum(axis=1)[:, None]).astype(dtype)
        attribute = Attribute("skin", Domain.POINT, Kind.WEIGHT, weights)
        result = transfer(attribute, identity(source.surface), source.surface, source.surface).values
        assert abs(result - weights).max() < rounding


def test_target_vertex_order_only_reorders_the_rows(source: Sheet, target: Sheet) -> None:
    weights = random_weights(len(source.parameters), 60, 4)
    other, old = permute(target)
    one, two = (transfer_weights(weights, source, mesh) for mesh in (target, other))
    assert abs(two - one[old]).max() < 1e-12


def test_memory_stays_sparse() -> None:
    source, target = sheet(tube, *GRID), sheet(tube, 400, 250)
    groups = 5000  # 4 GB if dense
    count = len(source.parameters)
    weights = csr_array(random_array((count, groups), density=4 / groups, format="csr", rng=np.random.default_rng(0)))
    surface_map = true_map(source, *GRID, target.parameters)
    attribute = Attribute("skin", Domain.POINT, Kind.WEIGHT, weights)
    tracemalloc.start()
    transfer(attribute, surface_map, source.surface, target.surface)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 300e6


def test_invalid_options_are_refused(source: Sheet, target: Sheet) -> None:
    weights = random_weights(len(source.parameters), 8, 4)
    with pytest.raises(MeshError, match="limit of 0"):
        transfer_weights(weights, source, target, limit=0)
    for wrong in ([8], [-1], np.ones(7, dtype=bool)):
        with pytest.raises(MeshError, match="8 groups"):
            transfer_weights(weights, source, target, normalised=wrong)
    for name in ("sums", "room"):
        with pytest.raises(MeshError, match=f"`{name}`.*one number for each"):
            transfer_weights(weights, source, target, **{name: [1.0, 1.0]})
