# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers at points, corners and faces are mixed linearly, but not across edges where the source's values jump."""

from __future__ import annotations

import numpy as np
import pytest
from transfer_meshes import Sheet, identity, permute, sheet, split_at_faces, torus, true_map

from zoomout_core.transfer import Attribute, Domain, Kind, transfer

GRID = (60, 40)
NUMBERS = {Kind.SCALAR: (), Kind.VECTOR: (2,), Kind.COLOR: (4,)}


@pytest.fixture(scope="module")
def source() -> Sheet:
    return sheet(torus, *GRID)


@pytest.fixture(scope="module")
def target() -> Sheet:
    return sheet(torus, 49, 31, jitter=0.2, twist=0.05, sides=3, seed=1)


@pytest.fixture(scope="module")
def aligned() -> Sheet:
    """The source with each face divided into nine."""
    return sheet(torus, 3 * GRID[0], 3 * GRID[1])


def counts(mesh: Sheet) -> dict[Domain, int]:
    surface = mesh.surface
    return {
        Domain.POINT: len(surface.vertices),
        Domain.FACE: len(surface.face_start) - 1,
        Domain.CORNER: len(surface.corner_vertex),
    }


@pytest.mark.parametrize("kind", NUMBERS)
@pytest.mark.parametrize("domain", [Domain.POINT, Domain.CORNER])
def test_linear_functions_of_position_transfer_exactly(
    source: Sheet, target: Sheet, kind: Kind, domain: Domain
) -> None:
    surface_map = true_map(source, *GRID, target.parameters)
    formula = np.random.default_rng(0).normal(size=(3, *NUMBERS[kind]))
    at_source, at_target = source.surface.vertices, surface_map.interpolate(source.surface.vertices)
    if domain is Domain.CORNER:
        at_source, at_target = (
            points[mesh.surface.corner_vertex] for points, mesh in ((at_source, source), (at_target, target))
        )
    result = transfer(Attribute("x", domain, kind, at_source @ formula), surface_map, source.surface, target.surface)
    np.testing.assert_allclose(result.values, at_target @ formula, rtol=0, atol=1e-12)
    assert (result.name, result.domain, result.kind) == ("x", domain, kind)


def test_corner_values_stay_continuous_except_at_jumps(source: Sheet, target: Sheet) -> None:
    # Values jump along half a ring, and are continuous around its ends and everywhere else.
    a, b = source.corners.T
    jump = (source.middles[source.surface.corner_face, 0] > 0.5) & (b > 0.2) & (b < 0.6) & (a < 0.75)
    values = np.sin(2 * np.pi * b) + 5 * jump
    surface_map = true_map(source, *GRID, target.parameters)
    result = transfer(Attribute("x", Domain.CORNER, Kind.SCALAR, values), surface_map, source.surface, target.surface)
    vertex = target.surface.corner_vertex
    low, high = np.full(len(target.parameters), np.inf), np.full(len(target.parameters), -np.inf)
    np.minimum.at(low, vertex, result.values)
    np.maximum.at(high, vertex, result.values)
    torn = high - low > 1e-12
    along, height = target.parameters.T
    edge = 2 / 61
    at_jump = (np.minimum(abs(along - 0.5), abs(along - 0.75)) < edge) & (height > 0.2 - edge) & (height < 0.6 + edge)
    assert not torn[~at_jump].any()
    assert torn[at_jump].any()


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("domain", [Domain.CORNER, Domain.FACE])
def test_face_colours_stay_on_their_side_of_edges(source: Sheet, aligned: Sheet, domain: Domain) -> None:
    colours = np.random.default_rng(0).random((counts(source)[Domain.FACE], 3))
    column, row = np.floor(aligned.middles * GRID).astype(int).T
    truth = colours[column % GRID[0] * GRID[1] + row % GRID[1]]
    if domain is Domain.CORNER:
        colours, truth = colours[source.surface.corner_face], truth[aligned.surface.corner_face]
    surface_map = true_map(source, *GRID, aligned.parameters)
    result = transfer(Attribute("x", domain, Kind.COLOR, colours), surface_map, source.surface, aligned.surface)
    np.testing.assert_allclose(result.values, truth, rtol=0, atol=1e-12)


def test_a_face_gets_the_mean_of_the_faces_that_it_covers(aligned: Sheet, source: Sheet) -> None:
    values = np.random.default_rng(0).random(counts(aligned)[Domain.FACE])
    surface_map = true_map(aligned, 3 * GRID[0], 3 * GRID[1], source.parameters)
    result = transfer(Attribute("x", Domain.FACE, Kind.SCALAR, values), surface_map, aligned.surface, source.surface)
    nine = values.reshape(GRID[0], 3, GRID[1], 3)
    low, high, mean = (f(nine, axis=(1, 3)).ravel() for f in (np.min, np.max, np.mean))
    assert ((result.values >= low) & (result.values <= high)).all()
    assert np.corrcoef(result.values, mean)[0, 1] > 0.8
    constant = Attribute("x", Domain.FACE, Kind.SCALAR, np.full(len(values), 0.3))
    np.testing.assert_allclose(
        transfer(constant, surface_map, aligned.surface, source.surface).values, 0.3, rtol=0, atol=1e-12
    )


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("sides", [3, 4, 6])
@pytest.mark.parametrize("domain", [Domain.POINT, Domain.CORNER, Domain.FACE])
def test_the_identity_returns_the_values(sides: int, domain: Domain) -> None:
    mesh = sheet(torus, *GRID, sides=sides)
    values = np.random.default_rng(0).normal(size=(counts(mesh)[domain], 3))
    result = transfer(Attribute("x", domain, Kind.VECTOR, values), identity(mesh.surface), mesh.surface, mesh.surface)
    np.testing.assert_allclose(result.values, values, rtol=0, atol=1e-12)
    if domain is not Domain.POINT:
        alone, _ = split_at_faces(mesh.surface)
        result = transfer(Attribute("x", domain, Kind.VECTOR, values), identity(alone), alone, alone)
        np.testing.assert_allclose(result.values, values, rtol=0, atol=1e-12)


def test_target_vertex_order_only_reorders_the_result(source: Sheet, target: Sheet) -> None:
    other, old = permute(target)
    for domain, count in counts(source).items():
        attribute = Attribute("x", domain, Kind.SCALAR, np.random.default_rng(0).random(count))
        one, two = (
            transfer(attribute, true_map(source, *GRID, mesh.parameters), source.surface, mesh.surface).values
            for mesh in (target, other)
        )
        np.testing.assert_allclose(two, one[old] if domain is Domain.POINT else one, rtol=0, atol=1e-12)


def test_floats_keep_their_precision_and_integers_become_floats(source: Sheet, target: Sheet) -> None:
    surface_map = true_map(source, *GRID, target.parameters)
    for given, expected in ((np.float32, np.float32), (np.float64, np.float64), (np.int16, np.float64)):
        for domain, count in counts(source).items():
            attribute = Attribute("x", domain, Kind.SCALAR, np.arange(count).astype(given))
            assert transfer(attribute, surface_map, source.surface, target.surface).values.dtype == expected
