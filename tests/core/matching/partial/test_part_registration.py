"""A part bent onto a whole: where it belongs it fits with little strain, elsewhere it does not."""

from __future__ import annotations

import numpy as np
import pytest
from pieces import PartAndWhole

from zoomout_core.matching.partial.part_registration import RegisteredPart, registered_steps
from zoomout_core.runtime.stepping import drain


@pytest.fixture(scope="module")
def fitted(lower: PartAndWhole) -> RegisteredPart:
    return drain(registered_steps(lower.true_samples(), lower.part, lower.whole))


def test_a_part_lies_where_it_belongs(lower: PartAndWhole, fitted: RegisteredPart) -> None:
    errors = lower.errors(fitted.closest.vertex)
    assert np.median(errors) < 0.04
    assert np.median(fitted.residual) < 0.01
    assert np.median(fitted.agreement) > 0.97
    assert fitted.is_near.mean() > 0.9
    np.testing.assert_allclose(np.linalg.norm(fitted.normals, axis=1), 1, atol=1e-9)
    determinant = np.linalg.det(fitted.rotations)
    np.testing.assert_allclose(determinant, 1, atol=1e-6)


def test_a_wrong_place_costs_strain_and_normals(lower: PartAndWhole, fitted: RegisteredPart) -> None:
    points = lower.whole.shape.mesh.vertices[lower.whole.shape.search.samples]
    elsewhere = points[lower.true_samples()] * [-1, 1, -1]  # legs go to the arms
    match = np.argmin(np.linalg.norm(points - elsewhere[:, None], axis=2), axis=1)
    wrong = drain(registered_steps(match, lower.part, lower.whole))
    areas = lower.part.shape.basis.areas
    right, astray = fitted.scores(areas), wrong.scores(areas)
    assert astray["strain"] > 1.5 * right["strain"]
    assert astray["normals"] > 2 * right["normals"]


def test_scores_do_not_depend_on_the_unit_of_areas(fitted: RegisteredPart) -> None:
    areas = np.linspace(1, 2, len(fitted.residual))
    assert fitted.scores(areas) == pytest.approx(fitted.scores(7 * areas))


def test_the_whole_does_not_draw_the_part(lower: PartAndWhole, fitted: RegisteredPart) -> None:
    """Half of the whole has no partner; were it to draw the part, this would be stretched over it."""
    extent = np.ptp(fitted.positions, axis=0)
    true = lower.whole.shape.mesh.vertices[lower.whole.shape.search.samples[lower.true_samples()]]
    np.testing.assert_allclose(extent, np.ptp(true, axis=0), rtol=0.2)
