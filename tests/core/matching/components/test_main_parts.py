# SPDX-License-Identifier: GPL-3.0-or-later
"""Choice of the body: by size, by spectrum if it is more informative, with a preference for closed parts."""

from __future__ import annotations

import numpy as np
import pytest
from loose_parts import sheet
from reports import fractions_of

from zoomout_core.matching.components import main_parts as module
from zoomout_core.matching.components.main_parts import _comparable, _spectrum, main_parts
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

EGG, PLUM = ball(1.0, radii=(2, 1, 1), count=200), ball(0.9, (5, 0, 0), radii=(1.5, 1.2, 1), count=200)


def bodies(source: Surface, target: Surface) -> tuple[float, float]:
    """Square roots of the bodies' areas."""
    one, other = main_parts(source, target, 0)
    return one.scale, other.scale


def size(surface: Surface) -> float:
    return float(np.sqrt(surface.area))


def test_largest_part_is_the_body_if_the_rest_is_small() -> None:
    both = Surface.joined([EGG, ball(0.5, (5, 0, 0))])
    assert bodies(both, EGG) == pytest.approx((size(EGG), size(EGG)))
    assert bodies(both, both) == pytest.approx((size(EGG), size(EGG)))


def test_spectrum_chooses_between_parts_of_similar_size() -> None:
    both = Surface.joined([EGG, PLUM])
    assert size(EGG) > size(PLUM)
    for alone in (EGG, PLUM):
        other = alone.with_vertices(3 * alone.vertices[:, [1, 2, 0]])
        assert bodies(both, other) == pytest.approx((size(alone), 3 * size(alone)))
        assert bodies(other, both) == pytest.approx((3 * size(alone), size(alone)))


def test_largest_parts_are_the_bodies_if_spectra_agree() -> None:
    twins = Surface.joined([EGG, ball(0.9, (5, 0, 0), radii=(2, 1, 1), count=180)])
    assert bodies(twins, twins) == pytest.approx((size(EGG), size(EGG)))


def test_largest_part_wins_over_a_smaller_one_of_the_same_mesh() -> None:
    larger = ball(1.1, (6, 0, 0), radii=(2, 1, 1), count=190, seed=4)
    assert bodies(EGG, Surface.joined([EGG, larger])) == pytest.approx((size(EGG), size(larger)))


def test_pair_that_is_largest_on_both_sides_wins_a_tie() -> None:
    plum = PLUM.with_vertices(PLUM.vertices * (1.2 * size(EGG) / size(PLUM)) + np.array([9, 0, 0]))
    larger = EGG.with_vertices(1.3 * EGG.vertices)
    one, other = Surface.joined([larger, PLUM]), Surface.joined([EGG, plum])
    assert bodies(one, other) == pytest.approx((1.3 * size(EGG), size(EGG)))
    assert bodies(other, one) == pytest.approx((size(EGG), 1.3 * size(EGG)))


def test_closed_parts_win_a_tie() -> None:
    cloth = Surface.joined([EGG, sheet(6.5, (0, 0, 3))])
    assert size(cloth) ** 2 > 2 * size(EGG) ** 2
    assert bodies(cloth, cloth) == pytest.approx((size(EGG), size(EGG)))


def test_only_parts_of_comparable_area_may_be_the_body() -> None:
    for factor, count in ((0.5, 1), (0.72, 2)):
        small = EGG.with_vertices(factor * EGG.vertices + np.array([9, 0, 0]))
        assert len(_comparable(Surface.joined([EGG, small]), "source")) == count


def test_spectrum_is_the_log_of_eigenvalues_at_unit_area() -> None:
    for radius in (1.0, 20.0):
        found = _spectrum(ball(radius, count=400).working.part(0)[0], 9, 0)
        # Eigenvalues of a sphere: l (l + 1) / r^2, each 2 l + 1 times.
        np.testing.assert_allclose(found[:3], np.log(8 * np.pi), atol=0.02)
        np.testing.assert_allclose(found[3:8], np.log(24 * np.pi), atol=0.06)
        assert len(found) == 8


def test_too_coarse_surface_is_refused_by_name() -> None:
    coarse = ball(1.0, count=11)
    for source, target, name in ((coarse, EGG, "source"), (EGG, coarse, "target"), (coarse, coarse, "mesh")):
        said = f"largest part of the {name} has only 11 vertices.*subdivide it to at least 12"
        with pytest.raises(MeshError, match=said):
            main_parts(source, target, 0)


def test_error_counts_the_vertices_of_the_largest_part() -> None:
    both = Surface.joined([ball(0.9, (5, 0, 0), count=10), ball(1.0, count=11)])
    with pytest.raises(MeshError, match="has only 11 vertices"):
        main_parts(both, EGG, 0)


def test_parts_without_rivals_are_chosen_without_spectra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_spectrum", lambda *_: pytest.fail("a spectrum was computed"))
    assert bodies(EGG, PLUM) == pytest.approx((size(EGG), size(PLUM)))


def test_parts_with_the_minimum_of_vertices_are_compared() -> None:
    both = Surface.joined([ball(1.0, count=12), ball(0.9, (5, 0, 0), count=12)])
    one, other = main_parts(both, both, 0)
    assert len(one.vertices) == len(other.vertices) == 12


def test_one_eigenvalue_can_distinguish_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    both = Surface.joined([EGG, PLUM])
    monkeypatch.setattr(module, "COMPARED_EIGENVALUES", 1)
    assert bodies(both, PLUM) == pytest.approx((size(PLUM), size(PLUM)))


def test_progress_never_falls_and_ends_at_one() -> None:
    both = Surface.joined([EGG, PLUM])
    fractions = fractions_of(lambda: main_parts(both, EGG, 0))
    assert fractions == sorted(fractions)
    assert 0 <= fractions[0] < 0.2 < fractions[-1] == 1
    assert len({round(fraction, 6) for fraction in fractions}) > 3
