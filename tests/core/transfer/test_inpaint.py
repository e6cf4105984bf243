# SPDX-License-Identifier: GPL-3.0-or-later
"""Fill in unreliable values smoothly from their surroundings, without changing others."""

from __future__ import annotations

import tracemalloc
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.sparse import csr_array, random_array
from scipy.spatial.transform import Rotation
from transfer_meshes import Sheet, identity, sheet, split_at_faces, torus, tube

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer import Attribute, Domain, Kind, inpaint, transfer
from zoomout_core.transfer.inpaint import filling


@dataclass
class Known:
    """A map that is right where its confidence is one."""

    surface_map: SurfaceMap
    confidence: np.ndarray
    has_partner: None = None


@pytest.fixture(scope="module")
def mesh() -> Sheet:
    return sheet(torus, 90, 60, jitter=0.2, sides=3)


def hole(mesh: Sheet, radius: float = 0.12) -> np.ndarray:
    """(n,) mask of the vertices around the centre of the parameters."""
    return np.linalg.norm(mesh.parameters - 0.5, axis=1) < radius


def waves(parameters: np.ndarray) -> np.ndarray:
    """(n, 2) smooth functions on a torus, in [0, 1]."""
    a, b = 2 * np.pi * parameters.T
    return np.stack([0.5 + 0.4 * np.sin(a), 0.5 + 0.3 * np.cos(a) * np.sin(b)], axis=1)


def spoil(values: np.ndarray, holes: np.ndarray) -> np.ndarray:
    values = values.copy()
    values[holes] = 77.0
    return values


def test_smooth_functions_are_continued_into_holes(mesh: Sheet) -> None:
    holes, truth = hole(mesh), waves(mesh.parameters)
    filled = filling(mesh.surface, ~holes).fill(spoil(truth, holes))
    np.testing.assert_array_equal(filled[~holes], truth[~holes])
    rim = truth[~holes & hole(mesh, 0.15)]
    flat = np.abs(truth[holes] - rim.mean(axis=0)).mean()
    assert np.abs(filled[holes] - truth[holes]).mean() < 0.1 * flat


def test_holes_too_large_for_biharmonic_filling_are_filled(mesh: Sheet, monkeypatch: pytest.MonkeyPatch) -> None:
    holes, truth = hole(mesh, 0.06), waves(mesh.parameters)
    smooth = filling(mesh.surface, ~holes).fill(spoil(truth, holes))
    monkeypatch.setattr(inpaint, "MAX_BIHARMONIC", 10)
    plain = filling(mesh.surface, ~holes).fill(spoil(truth, holes))
    error = [np.abs(filled[holes] - truth[holes]).max() for filled in (smooth, plain)]
    assert error[0] < error[1] < 0.1


def test_values_far_from_a_hole_do_not_matter(mesh: Sheet, monkeypatch: pytest.MonkeyPatch) -> None:
    holes, truth = hole(mesh), waves(mesh.parameters)
    near = filling(mesh.surface, ~holes).fill(spoil(truth, holes))
    monkeypatch.setattr(inpaint, "ASSEMBLED_RINGS", 1000)
    np.testing.assert_allclose(near, filling(mesh.surface, ~holes).fill(spoil(truth, holes)), atol=1e-9)


def test_filling_keeps_constants_and_the_range_of_trusted_values(mesh: Sheet) -> None:
    holes = hole(mesh)
    steps = np.stack([np.ones(len(holes)), mesh.parameters[:, 0] > 0.5, mesh.parameters[:, 1] > 0.5], axis=1)
    filled = filling(mesh.surface, ~holes).fill(spoil(steps.astype(float), holes))
    assert np.abs(filled[:, 0] - 1).max() < 1e-9
    assert filled.min() >= 0
    assert filled.max() <= 1


def test_filling_does_not_depend_on_units_placement_or_order(mesh: Sheet) -> None:
    holes, values = hole(mesh), waves(mesh.parameters)
    once = filling(mesh.surface, ~holes).fill(spoil(values, holes))
    order = np.random.default_rng(0).permutation(len(values))
    number = np.argsort(order)
    moved = 1000 * Rotation.from_rotvec([1, 2, 3]).apply(mesh.surface.vertices) + 5
    other = Surface(moved[order], number[mesh.surface.triangles])
    again = filling(other, ~holes[order]).fill(spoil(values, holes)[order])
    np.testing.assert_allclose(again, once[order], atol=1e-6)


def test_weights_are_filled_in_like_numbers_and_stay_sparse(mesh: Sheet) -> None:
    holes = hole(mesh)
    values = np.concatenate([waves(mesh.parameters), 1 - waves(mesh.parameters)], axis=1) / 2
    far = np.zeros((len(holes), 40))
    far[mesh.parameters[:, 0] < 0.1] = 1
    whole = filling(mesh.surface, ~holes)
    filled = whole.fill_weights(csr_array(np.concatenate([spoil(values, holes), far], axis=1)))
    np.testing.assert_allclose(filled[:, :4].toarray(), whole.fill(spoil(values, holes)), atol=1e-4)
    # Groups absent around the hole stay absent in it.
    assert filled[holes][:, 4:].nnz == 0


def test_coincident_borders_are_filled_in_as_one(mesh: Sheet) -> None:
    holes, values = hole(mesh), waves(mesh.parameters)
    apart, vertex = split_at_faces(mesh.surface)
    once = filling(mesh.surface, ~holes).fill(spoil(values, holes))
    again = filling(apart, ~holes[vertex]).fill(spoil(values, holes)[vertex])
    np.testing.assert_allclose(again, once[vertex], atol=1e-6)


def send_astray(mesh: Sheet, holes: np.ndarray) -> np.ndarray:
    """(n,) each vertex itself, but one distant vertex for those of the holes."""
    elsewhere = np.argmin(np.linalg.norm(mesh.parameters - 0.25, axis=1))
    return np.where(holes, elsewhere, np.arange(len(holes)))


def two_sheets(size: float, polygons: bool = False) -> tuple[Surface, np.ndarray]:
    """A torus beside another of a given size, and (n,) which vertices belong to the second."""
    one, two = sheet(torus, 40, 30, sides=6 if polygons else 3), sheet(torus, 30, 20)
    vertices = np.concatenate([one.surface.vertices, size * two.surface.vertices + [4, 0, 0]])
    faces = [*_faces(one.surface), *(face + len(one.parameters) for face in _faces(two.surface))]
    return Surface(vertices, faces), np.arange(len(vertices)) >= len(one.parameters)


def _faces(surface: Surface) -> list[np.ndarray]:
    return np.split(surface.corner_vertex, surface.face_start[1:-1])


@pytest.mark.parametrize("polygons", [False, True])
def test_untrusted_parts_follow_the_nearest_part_only_if_small(polygons: bool) -> None:
    for size, small in ((0.05, True), (0.9, False)):
        surface, second = two_sheets(size, polygons)
        doubtful = second | (np.arange(len(second)) == 3)
        bones = np.round(surface.vertices[:, 0] - surface.vertices[:, 0].min()).astype(int)
        weights = csr_array((np.ones(len(bones)), (np.arange(len(bones)), bones)))
        whole = filling(surface, ~doubtful)
        filled = whole.fill_weights(weights)
        assert whole.filled.tolist() == [3]
        assert whole.notes()[0] == "1 vertex without a usable match took its neighbors' values."
        assert whole.left == (0 if small else second.sum())
        if small:
            nearest = np.argmax(np.where(second, -np.inf, surface.vertices[:, 0]))
            assert abs(filled[second] - weights[np.full(second.sum(), nearest)]).max() == 0
            assert "follow the nearest part" in whole.notes(following=True)[1]
        else:
            assert abs(filled[second] - weights[second]).max() == 0
        np.testing.assert_array_equal(whole.fill(surface.vertices)[second], surface.vertices[second])
        assert f"{second.sum():,} vertices without a usable match were left as mapped" in whole.notes()[1]


def test_values_are_left_as_mapped_if_nothing_is_trusted(mesh: Sheet) -> None:
    values = waves(mesh.parameters)
    none = filling(mesh.surface, np.zeros(len(values), dtype=bool))
    np.testing.assert_array_equal(none.fill(values), values)
    assert abs(none.fill_weights(csr_array(values)) - csr_array(values)).max() == 0
    assert none.notes() == (
        f"{len(values):,} vertices without a usable match were left as mapped, because no vertex of their part "
        "has one.",
    )


def test_bad_meshes_are_filled_in(mesh: Sheet) -> None:
    # A fin on an edge, a sliver, a duplicate face, and two unused vertices, one of them NaN.
    a, b, c = mesh.surface.triangles[len(mesh.surface.triangles) // 2]
    n = len(mesh.parameters)
    middle = (mesh.surface.vertices[a] + mesh.surface.vertices[b]) / 2
    extra = [middle + np.array([0, 0, 0.3]), middle, [9, 9, 9], [np.nan] * 3]
    faces = [*mesh.surface.triangles.tolist(), [a, b, n], [a, b, n + 1], [a, b, c]]
    surface = Surface(np.concatenate([mesh.surface.vertices, extra]), faces)
    holes = np.concatenate([hole(mesh), np.ones(4, dtype=bool)])
    truth = np.concatenate([waves(mesh.parameters), np.tile(waves(mesh.parameters[[a]]), (4, 1))])
    whole = filling(surface, ~holes)
    filled = whole.fill(spoil(truth, holes))
    assert np.abs(filled[:-2] - truth[:-2]).max() < 0.1
    assert (filled[-2:] == 77).all()
    assert whole.left == 2


@pytest.mark.parametrize("kind", [Kind.SCALAR, Kind.VECTOR, Kind.COLOR])
@pytest.mark.parametrize("domain", [Domain.POINT, Domain.CORNER])
def test_numbers_and_colours_of_low_confidence_are_filled_in(mesh: Sheet, kind: Kind, domain: Domain) -> None:
    surface, holes = mesh.surface, hole(mesh)
    result = Known(SurfaceMap.from_vertices(send_astray(mesh, holes), surface), np.where(holes, 0.1, 0.9))
    smooth = np.concatenate([waves(mesh.parameters)] * 2, axis=1)
    values = smooth[:, 0] if kind is Kind.SCALAR else smooth
    at = np.arange(len(holes)) if domain is Domain.POINT else surface.corner_vertex
    attribute = Attribute("paint", domain, kind, values[at].astype(np.float32))
    mapped = transfer(attribute, result, surface, surface)
    filled = transfer(attribute, result, surface, surface, fill_below=0.2)
    assert filled.values.dtype == np.float32
    assert filled.values.shape == values[at].shape
    assert np.abs(mapped.values - values[at]).max() > 0.3
    assert np.abs(filled.values - values[at]).max() < 0.05
    assert mapped.notes == ()
    assert filled.notes == (f"{holes.sum():,} vertices without a usable match took their neighbors' values.",)
    # No confidence is below the threshold, so nothing changes or is reported.
    untouched = transfer(attribute, result, surface, surface, fill_below=0.05)
    np.testing.assert_array_equal(untouched.values, mapped.values)
    assert untouched.notes == ()


def test_labels_are_not_filled_in(mesh: Sheet) -> None:
    result = Known(identity(mesh.surface), np.where(hole(mesh), 0.1, 0.9))
    attribute = Attribute("zone", Domain.POINT, Kind.LABEL, np.arange(len(mesh.parameters)))
    filled = transfer(attribute, result, mesh.surface, mesh.surface, fill_below=0.5)
    np.testing.assert_array_equal(filled.values, attribute.values)
    assert filled.notes == ()


def test_filled_weights_still_sum_to_one_within_the_limit(mesh: Sheet) -> None:
    holes = hole(mesh, 0.2)
    values = np.repeat(waves(mesh.parameters), 3, axis=1) * np.arange(1, 7)
    weights = csr_array(values / values.sum(axis=1, keepdims=True))
    result = Known(SurfaceMap.from_vertices(send_astray(mesh, holes), mesh.surface), np.where(holes, 0, 1.0))
    attribute = Attribute("skin", Domain.POINT, Kind.WEIGHT, weights)
    mapped, filled = (
        transfer(attribute, result, mesh.surface, mesh.surface, fill_below=below) for below in (None, 0.5)
    )
    assert np.abs(filled.values.sum(axis=1) - 1).max() < 1e-12
    assert filled.values.data.min() > 0
    error = [np.abs((one.values - weights).toarray()).sum(axis=1).max() for one in (mapped, filled)]
    assert error[1] < 0.1 * error[0]
    assert filled.notes == (f"{holes.sum():,} vertices without a usable match took their neighbors' values.",)
    limited = transfer(attribute, result, mesh.surface, mesh.surface, fill_below=0.5, limit=3).values
    assert np.diff(limited.indptr).max() == 3
    assert np.abs(limited.sum(axis=1) - 1).max() < 1e-12


def test_memory_stays_sparse_with_many_groups() -> None:
    mesh = sheet(tube, 250, 200)
    count, groups = len(mesh.parameters), 5000  # 2 GB if dense
    weights = csr_array(random_array((count, groups), density=4 / groups, format="csr", rng=np.random.default_rng(0)))
    holes = hole(mesh, 0.1)
    attribute = Attribute("skin", Domain.POINT, Kind.WEIGHT, weights)
    result = Known(identity(mesh.surface), np.where(holes, 0.0, 1.0))
    tracemalloc.start()
    transfer(attribute, result, mesh.surface, mesh.surface, fill_below=0.5)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 300e6


@pytest.mark.parametrize("wrong", [-0.1, 1.5, float("nan")])
def test_thresholds_outside_zero_to_one_are_refused(mesh: Sheet, wrong: float) -> None:
    attribute = Attribute("height", Domain.POINT, Kind.SCALAR, mesh.parameters[:, 0])
    with pytest.raises(ValueError, match=r"fill_below is .*from 0 to 1"):
        transfer(attribute, identity(mesh.surface), mesh.surface, mesh.surface, fill_below=wrong)
