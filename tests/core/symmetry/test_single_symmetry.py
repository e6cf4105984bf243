# SPDX-License-Identifier: GPL-3.0-or-later
"""A stone's only symmetry is found in a third of a second, with its sides, and among several bodies."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from butterfly import EVEN, MIRROR, self_map
from reports import fractions_of, reports_of

import zoomout_core as zo
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import outward_hull
from zoomout_core.symmetry import detect
from zoomout_core.symmetry.self_map import main_shape

SMALL = {"k_final": 40, "samples": 100}
CLEAR = np.abs(EVEN[:, 0]) > 0.1


def stone(places: np.ndarray) -> Surface:
    """A stone with left-right symmetry only; its vertices correspond to places on the sphere."""
    triangles = outward_hull(places)
    _, y, z = places.T
    return Surface(places * (1 + 0.25 * z + 0.2 * y * z + 0.15 * y)[:, None] * [1, 0.75, 0.55], triangles)


def about_z(angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])


def rotated_stone(angle: float) -> Surface:
    """The stone, rotated about z."""
    straight = stone(EVEN)
    return straight.with_vertices(straight.vertices @ about_z(angle).T)


@pytest.fixture(scope="module")
def found() -> tuple[zo.Symmetry, ...]:
    return zo.detect_symmetry(stone(EVEN), **SMALL)


def test_exact_mirror_is_the_only_symmetry(found: tuple[zo.Symmetry, ...]) -> None:
    (mirror,) = found
    places = mirror.surface.vertices
    np.testing.assert_allclose(mirror.surface_map.interpolate(places), places * MIRROR, atol=1e-4)
    assert (mirror.reverses_orientation, mirror.order, mirror.notes) == (True, 2, ())
    assert mirror.certainty > 0.95
    assert mirror.return_error < 1e-4
    assert mirror.confidence.min() > 0.9


def test_sides_are_the_signs_of_x(found: tuple[zo.Symmetry, ...]) -> None:
    x = EVEN[:, 0]
    np.testing.assert_array_equal(found[0].sides(1e-6), np.where(np.abs(x) < 1e-9, 0, np.sign(x)))


@pytest.mark.parametrize("angle", [-1.0, 1.0])
def test_left_is_along_x_at_any_rotation(angle: float) -> None:
    (mirror,) = zo.detect_symmetry(rotated_stone(angle), **SMALL)
    assert mirror.notes == ()
    np.testing.assert_array_equal(mirror.sides()[CLEAR], np.sign(EVEN[CLEAR, 0]))


def test_left_axis_may_have_any_length() -> None:
    (mirror,) = zo.detect_symmetry(rotated_stone(2.0), left=-3 * about_z(2.0)[:, 0], **SMALL)
    np.testing.assert_array_equal(mirror.sides()[CLEAR], -np.sign(EVEN[CLEAR, 0]))


def test_left_axis_within_the_mirror_plane_is_reported() -> None:
    (mirror,) = zo.detect_symmetry(rotated_stone(1.0), left=about_z(1.0)[:, 1], **SMALL)
    assert "hardly separates left from right" in mirror.notes[0]
    assert mirror.has_sides


def test_mirror_on_an_asymmetric_mesh_is_an_involution() -> None:
    places = EVEN + 0.02 * np.random.default_rng(0).normal(size=EVEN.shape)
    mesh = stone(places / np.linalg.norm(places, axis=1, keepdims=True))
    mirror = zo.detect_symmetry(mesh, **SMALL)[0]
    off = np.linalg.norm(mirror.surface_map.interpolate(mesh.vertices) - mesh.vertices * MIRROR, axis=1)
    assert (mirror.order, mirror.reverses_orientation) == (2, True)
    assert off.mean() < 0.02
    # 0.007 before it is made an involution
    assert mirror.return_error < 0.004


def test_shape_is_analysed_once_and_reports_progress() -> None:
    mesh = stone(EVEN)
    found, reports = reports_of(lambda: main_shape(mesh))
    fractions = [report.fraction for report in reports]
    assert zo.detect_symmetry(mesh)[0].shape is found
    assert self_map(mesh).shape is found
    assert fractions == sorted(fractions)
    assert fractions[0] == 0
    assert 0.97 < fractions[-1] <= 1
    assert sum(0 < fraction < 0.041 for fraction in fractions) > 2
    assert sum(0.041 < fraction < 1 for fraction in fractions) > 2


def test_progress_never_falls_and_covers_all_stages() -> None:
    fractions = fractions_of(lambda: detect.detect_symmetry(stone(EVEN), **SMALL))
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0, 1)
    assert sum(0.4 < fraction < 0.56 for fraction in fractions) > 10
    assert sum(0.69 < fraction < 1 for fraction in fractions) > 3


# --- choice of the body and of its symmetries ----------------------------------------------------------------


def certainties_found(
    monkeypatch: pytest.MonkeyPatch, bodies: list[tuple[float, list[float]]], **options: int
) -> tuple[list[float], int]:
    """Certainties of the returned symmetries of bodies with given coverages and candidates, and the number analysed."""
    analysed = []

    def candidates(shape: list[float]) -> list[SimpleNamespace]:
        analysed.append(shape)
        return [SimpleNamespace(certainty=one, scores={"total": -one}, functional_map=np.eye(2)) for one in shape]

    def symmetry(pair: object, candidate: SimpleNamespace, left: object) -> SimpleNamespace:
        surface = stone(EVEN[::4])
        confidence = np.ones(len(surface.vertices))
        return SimpleNamespace(certainty=candidate.certainty, surface=surface, confidence=confidence)

    listed = [SimpleNamespace(source=certainties, coverage=coverage) for coverage, certainties in bodies]
    monkeypatch.setattr(detect, "bodies_of", lambda *_: listed)
    monkeypatch.setattr(detect, "body_shape", lambda body, *_: body)
    monkeypatch.setattr(detect, "find_candidates", candidates)
    monkeypatch.setattr(detect, "_symmetry", symmetry)
    result = zo.detect_symmetry(stone(EVEN[::4]), **options)
    return [one.certainty for one in result], len(analysed)


def test_certain_body_suffices_otherwise_the_better_one_wins(monkeypatch: pytest.MonkeyPatch) -> None:
    assert certainties_found(monkeypatch, [(1.0, [0.99]), (1.0, [0.999])]) == ([0.99], 1)
    assert certainties_found(monkeypatch, [(1.0, [0.3]), (1.0, [0.9])]) == ([0.9], 2)
    assert certainties_found(monkeypatch, [(1.0, [0.5]), (1.0, [0.2])]) == ([0.5], 2)
    assert certainties_found(monkeypatch, [(1.0, []), (1.0, [0.2])]) == ([0.2], 2)
    assert certainties_found(monkeypatch, [(1.0, []), (1.0, [])]) == ([], 2)


def test_first_symmetry_is_always_returned_others_if_likely(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert certainties_found(monkeypatch, [(1.0, [0.01, 0.009])])[0] == [0.01]
    assert certainties_found(monkeypatch, [(1.0, [0.9, 0.5, 0.06, 0.04])])[0] == [0.9, 0.5, 0.06]
    many = list(np.linspace(0.9, 0.5, 20))
    assert certainties_found(monkeypatch, [(1.0, many)])[0] == many[:8]
    assert certainties_found(monkeypatch, [(1.0, many)], max_count=3)[0] == many[:3]
