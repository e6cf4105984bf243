# SPDX-License-Identifier: GPL-3.0-or-later
"""The map of whole surfaces: image and confidence of each vertex, and notes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from loose_parts import BODY, RADIUS, identity, pair_around_body, shape_of, sheet

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.components import lift as module
from zoomout_core.matching.components.lift import LiftedMap, _from_shells, _is_smaller, lift
from zoomout_core.matching.components.shells import ShellMap
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.refinement.confidence import Partners
from zoomout_core.matching.registration.nonrigid_icp import Fit
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

EYES = [ball(0.04, (0.35, 0, 0)), ball(0.04, (-0.35, 0, 0))]
HAT = ball(0.1, (0, 0, 0.8))


def lift_around_body(pair: Pair) -> LiftedMap:
    shape = pair.target_shape
    n = len(shape.mesh.vertices)
    # Partners: the first half of the body's vertices on the target, the second half on the source.
    partners = Partners(np.arange(n) < n // 2, np.arange(n) >= n // 2)
    return lift(pair, Fit.of_map(identity(shape)), np.linspace(0.2, 0.7, n), partners)


def images(found: LiftedMap, pair: Pair) -> np.ndarray:
    return np.asarray(found.surface_map.interpolate(pair.source.vertices))


def test_body_and_parts_map_to_themselves() -> None:
    pair = pair_around_body(EYES, EYES)
    found = lift_around_body(pair)
    np.testing.assert_allclose(images(found, pair), pair.target.vertices, atol=1e-6)
    assert found.placed == pytest.approx(1)
    on_body = len(BODY.vertices)
    np.testing.assert_allclose(found.confidence[:on_body], np.linspace(0.2, 0.7, on_body))
    assert found.confidence[on_body:].min() > 0.7
    first = np.arange(on_body) < on_body // 2
    np.testing.assert_array_equal(found.partners.target, [*first, *np.ones(len(found.confidence) - on_body, bool)])
    np.testing.assert_array_equal(found.partners.source, [*~first, *np.ones(len(found.confidence) - on_body, bool)])


def test_parts_may_come_before_the_body() -> None:
    surfaces = [Surface.joined([*EYES, BODY]) for _ in range(2)]
    shapes = [shape_of(surface) for surface in surfaces]
    pair = Pair(surfaces[0], surfaces[1], shapes[0], shapes[1], 20, 10)
    found = lift_around_body(pair)
    np.testing.assert_allclose(images(found, pair), pair.target.vertices, atol=1e-6)
    assert found.confidence.min() > 0.15


def test_unpaired_part_maps_to_the_body_with_zero_confidence() -> None:
    pair = pair_around_body(EYES, [*EYES, HAT])
    found = lift_around_body(pair)
    hat = np.arange(len(pair.target.vertices)) >= len(pair.source.vertices)
    np.testing.assert_array_equal(found.confidence[hat], 0)
    np.testing.assert_allclose(np.linalg.norm(images(found, pair)[hat], axis=1), RADIUS, rtol=0.03)
    assert images(found, pair)[hat, 2].min() > 0.9 * RADIUS
    assert found.placed == pytest.approx(1 - HAT.area / pair.target.area, rel=1e-6)
    assert not found.partners.target[hat].any()
    assert found.partners.target[len(BODY.vertices) : -hat.sum()].all()


@pytest.mark.parametrize("loose", [[], EYES])
def test_source_part_without_images_has_no_partner(loose: list[Surface]) -> None:
    pair = pair_around_body([*loose, HAT], loose)
    found = lift_around_body(pair)
    beside = found.partners.source[len(BODY.vertices) :]
    np.testing.assert_array_equal(beside, np.arange(len(beside)) < len(beside) - len(HAT.vertices))


def test_unused_points_map_nearby_and_nan_points_are_accepted() -> None:
    pair = pair_around_body(EYES, EYES)
    loose = np.array([[0, 0, 0.5], [np.nan, 0, 0]])
    target = Surface(np.vstack([loose, pair.target.vertices]), pair.target.triangles + 2)
    found = lift_around_body(replace(pair, target=target, target_shape=shape_of(target)))
    np.testing.assert_allclose(images(found, pair)[0], [0, 0, RADIUS], atol=0.03)
    np.testing.assert_array_equal(found.confidence[:2], 0)
    assert found.partners.target[:2].all()
    np.testing.assert_allclose(found.surface_map.barycentric.sum(axis=1), 1)
    np.testing.assert_allclose(images(found, pair)[2:], pair.target.vertices, atol=1e-6)


# --- notes --------------------------------------------------------------------------------------------------------


def test_notes_report_paired_and_unpaired_parts() -> None:
    def notes(source: list[Surface], target: list[Surface]) -> tuple[str, ...]:
        return lift_around_body(pair_around_body(source, target)).notes

    assert notes([], []) == ()
    assert notes(EYES, EYES) == ("2 loose parts paired with parts of the source by position, size and shape.",)
    assert notes(EYES[:1], [EYES[0], HAT])[1:] == (
        "1 loose part of the target without a partner: mapped to the nearest point of the body, with zero confidence.",
    )
    assert notes([HAT], []) == (
        "1 loose part of the source without a partner: no part of the target was matched to them.",
    )


def test_notes_of_a_self_map_mention_one_surface() -> None:
    pair = pair_around_body(EYES, EYES)
    own = replace(pair, target=pair.source, target_shape=pair.source_shape)
    (note,) = lift_around_body(own).notes
    assert note == "2 loose parts mapped to their partners, or to themselves, by position, size and shape."


def test_notes_report_a_body_that_is_not_the_largest_part() -> None:
    cloak = sheet(2.0, (0, 0, -2))
    surface = Surface.joined([BODY, cloak])
    for number, smaller in ((0, False), (1, True)):
        assert _is_smaller(surface, shape_of(surface, number)) is smaller
    pair = pair_around_body([cloak], [cloak], number=1)
    first = (
        "The main part of the {} is not its largest part, but the one most similar to the main part of the other mesh."
    )
    assert lift_around_body(pair).notes[:2] == (first.format("source"), first.format("target"))
    own = replace(pair, target=pair.source, target_shape=pair.source_shape)
    assert (
        lift_around_body(own).notes[0] == "The symmetry was detected on the main part, which is not the largest part."
    )


# --- shells -------------------------------------------------------------------------------------------------------


def shell_map(pair: Any, **of: Any) -> ShellMap:
    """A map of shells onto themselves."""
    mesh = pair.target.working
    corner = np.zeros(len(mesh.vertices), dtype=np.int64)
    corner[mesh.triangles.ravel()] = np.arange(mesh.triangles.size)
    surface_map = SurfaceMap(corner // 3, np.eye(3)[corner % 3], mesh.triangles)
    partners = Partners(mesh.component == 0, mesh.component == 1)
    found = ShellMap(surface_map, np.linspace(0.1, 1, len(mesh.vertices)), partners, 0, 0.0, False)
    return replace(found, **of)


def shells(loose: int = 1) -> Any:
    """Two balls, and unused points beside them."""
    both = Surface.joined(EYES)
    points = np.vstack([both.vertices, np.tile([0.35, 0, 0.05], (loose, 1)), [[np.nan] * 3]])
    surface = Surface(np.roll(points, loose + 1, axis=0), both.triangles + loose + 1)
    return SimpleNamespace(source=surface, target=surface)


def test_unused_points_take_the_image_of_the_nearest_shell() -> None:
    pair = shells()
    found = _from_shells(pair, shell_map(pair))
    on = found.surface_map.interpolate(np.nan_to_num(pair.source.vertices))
    np.testing.assert_allclose(on[2:], pair.target.vertices[2:], atol=1e-9)
    assert np.linalg.norm(on[0] - pair.target.vertices[0]) < 0.02
    np.testing.assert_array_equal(found.confidence[:2], 0)
    np.testing.assert_allclose(np.sort(found.confidence[2:]), np.linspace(0.1, 1, len(on) - 2))
    assert found.confidence[2:].min() > 0
    first = pair.source.components[2:] == 0
    np.testing.assert_array_equal(found.partners.target, [True, True, *first])
    np.testing.assert_array_equal(found.partners.source, [True, True, *~first])


def test_notes_report_paired_shells() -> None:
    pair = shells()

    def notes(**of: Any) -> tuple[str, ...]:
        return _from_shells(pair, shell_map(pair, **of)).notes

    assert notes() == ()
    assert notes(paired=2) == ("2 of 2 parts matched to their partners by position, size and shape.",)
    assert notes(paired=1)[0].endswith("; the others were mapped to the nearest surface.")
    assert notes(in_place=True)[0].startswith("The two meshes overlap in place")
    assert _from_shells(pair, shell_map(pair, alone=0.2)).placed == pytest.approx(0.8)


def test_hulls_are_lifted_by_their_shells(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = shells()
    hull = SimpleNamespace(proxy=SimpleNamespace(full=SimpleNamespace(is_hull=True)))
    found = shell_map(pair, paired=2)
    monkeypatch.setattr(module, "map_shells", lambda *_: found)
    both: Any = SimpleNamespace(source=pair.source, target=pair.target, target_shape=hull)
    assert lift(both, None, None, None).notes == _from_shells(pair, found).notes  # type: ignore[arg-type]
