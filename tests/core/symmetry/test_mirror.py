# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes are mirrored on a posed, unevenly meshed creature by the rules of their kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from creatures import Creature
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.symmetry.mirror import asymmetry, flip_names, mirror, symmetrise, with_partners

NAMES = ("Arm.L", "Arm.R", "Spine")


def true_weights(directions: np.ndarray) -> np.ndarray:
    """(n, 3) symmetric weights that change smoothly and sum to one."""
    x = directions[:, 0]
    left, right = np.clip(1.5 * x, 0, 0.9), np.clip(-1.5 * x, 0, 0.9)
    return np.column_stack([left, right, 1 - left - right])


def weights_of(values: np.ndarray, labels: tuple[str, ...] = NAMES) -> zo.Attribute:
    return zo.Attribute("Weights", zo.Domain.POINT, zo.Kind.WEIGHT, csr_array(values), labels)


def point(values: np.ndarray, kind: zo.Kind = zo.Kind.SCALAR) -> zo.Attribute:
    return zo.Attribute("Values", zo.Domain.POINT, kind, values)


def test_weights_are_copied_from_the_winning_side(reflection: zo.Symmetry, bent: Creature) -> None:
    truth = true_weights(bent.directions)
    broken = truth.copy()
    broken[bent.directions[:, 0] < 0] = [0, 0, 1]
    mended = symmetrise(weights_of(broken), reflection, "left_to_right")
    assert mended.labels == NAMES
    np.testing.assert_allclose(mended.values.sum(axis=1), 1, atol=1e-6)
    error = np.abs(mended.values.toarray() - truth).sum(axis=1)
    assert error.mean() < 0.03 < 0.3 * np.abs(broken - truth).sum(axis=1).mean()
    left = bent.directions[:, 0] > 0.1
    np.testing.assert_allclose(mended.values.toarray()[left], truth[left], atol=1e-3)
    spoilt = symmetrise(weights_of(broken), reflection, "right_to_left").values.toarray()
    assert np.abs(spoilt[:, 2] - 1).mean() < 0.02


def test_average_of_weights_keeps_the_limit_of_groups(reflection: zo.Symmetry, bent: Creature) -> None:
    truth = true_weights(bent.directions)
    mean = symmetrise(weights_of(truth), reflection, "average")
    assert np.abs(mean.values.toarray() - truth).sum(axis=1).mean() < 0.03
    assert np.diff(mean.values.indptr).max() <= np.diff(csr_array(truth).indptr).max()
    np.testing.assert_allclose(mean.values.sum(axis=1), 1, atol=1e-6)


def test_groups_without_a_partner_get_one(reflection: zo.Symmetry, bent: Creature) -> None:
    truth = true_weights(bent.directions)
    one_sided = weights_of(truth[:, [0, 2]], ("Arm.L", "Spine"))
    assert with_partners(one_sided).labels == ("Arm.L", "Spine", "Arm.R")
    flipped = flip_names(one_sided).values.toarray()
    np.testing.assert_array_equal(flipped, np.column_stack([0 * truth[:, 0], truth[:, 2], truth[:, 0]]))
    both = mirror(one_sided, reflection).values.toarray()
    assert np.abs(both[:, 2] - truth[:, 1]).mean() < 0.03
    assert both[:, 0].max() == 0


def test_oddly_spelled_name_gets_a_partner() -> None:
    flipped = flip_names(weights_of(np.array([[0.5, 0.25]]), ("arm lEFT", "Spine")))
    assert flipped.labels == ("arm lEFT", "Spine", "arm right")
    np.testing.assert_array_equal(flipped.values.toarray(), [[0, 0.25, 0.5]])
    assert with_partners(flipped).labels == flipped.labels


def test_unused_vertices_keep_their_values(reflection: zo.Symmetry, bent: Creature) -> None:
    count = len(bent.surface.vertices)
    surface = zo.Surface(np.vstack([bent.surface.vertices, [[9.0, 9, 9], [8.0, 8, 8]]]), bent.surface.triangles)
    triangle = np.append(reflection.surface_map.triangle, [0, 0])
    barycentric = np.vstack([reflection.surface_map.barycentric, np.eye(3)[:2]])
    symmetry = replace(
        reflection,
        surface=surface,
        surface_map=zo.SurfaceMap(triangle, barycentric, surface.triangles),
        distance=np.append(reflection.distance, [0, 0]),
        confidence=np.append(reflection.confidence, [0, 0]),
    )
    loose = [[0.25, 0, 0.5], [0, 0, 0]]
    for direction in ("left_to_right", "average", "exchange"):
        made = symmetrise(weights_of(np.vstack([true_weights(bent.directions), loose])), symmetry, direction)
        np.testing.assert_array_equal(made.values.toarray()[count:], loose)
        numbers = symmetrise(point(np.arange(count + 2.0)), symmetry, direction)
        np.testing.assert_array_equal(numbers.values[count:], [count, count + 1])


def test_numbers_colours_and_labels_take_the_winning_side(reflection: zo.Symmetry, bent: Creature) -> None:
    x, height = bent.directions[:, 0], bent.directions[:, 2]
    left = x > 0
    off_line = np.abs(x) > 0.1
    number = symmetrise(point(np.where(left, height, 5.0)), reflection).values
    assert np.abs(number - height)[off_line].mean() < 0.03
    colour = np.where(left[:, None], np.abs(bent.directions), 0)
    taken = symmetrise(point(colour, zo.Kind.COLOR), reflection).values
    assert np.abs(taken - np.abs(bent.directions))[off_line].mean() < 0.03
    label = np.where(left, np.where(height > 0, "upper", "lower"), "none")
    clear = off_line & (np.abs(height) > 0.1)
    taken = symmetrise(point(label, zo.Kind.LABEL), reflection).values
    assert (taken == np.where(height > 0, "upper", "lower"))[clear].mean() > 0.99
    with pytest.raises(zo.MeshError, match="cannot be averaged"):
        symmetrise(point(label, zo.Kind.LABEL), reflection, "average")


def test_average_of_a_selection_is_on_both_sides(reflection: zo.Symmetry, bent: Creature) -> None:
    x = bent.directions[:, 0]
    selected = point(x > 0.3, zo.Kind.BOOLEAN)
    clear = np.abs(np.abs(x) - 0.3) > 0.1
    both = symmetrise(selected, reflection, "average").values
    assert (both == (np.abs(x) > 0.3))[clear].mean() > 0.99
    other = mirror(selected, reflection).values
    assert (other == (x < -0.3))[clear].mean() > 0.99


def test_faces_and_corners_take_the_winning_side(reflection: zo.Symmetry, bent: Creature) -> None:
    surface = bent.surface
    x = bent.directions[surface.triangles, 0].mean(axis=1)
    z = bent.directions[surface.triangles, 2].mean(axis=1)
    clear = np.abs(z) > 0.15
    label = zo.Attribute("Label", zo.Domain.FACE, zo.Kind.LABEL, np.where(x > 0, (z > 0).astype(int), 7))
    assert (symmetrise(label, reflection).values == (z > 0))[clear].mean() > 0.98
    height = bent.directions[surface.corner_vertex, 2]
    corner = zo.Attribute("Height", zo.Domain.CORNER, zo.Kind.SCALAR, np.where(np.repeat(x, 3) > 0, height, 9.0))
    found = symmetrise(corner, reflection).values
    assert np.median(np.abs(found - height)) < 0.03


def test_asymmetry_is_where_the_sides_differ(reflection: zo.Symmetry, bent: Creature) -> None:
    truth = true_weights(bent.directions)
    assert asymmetry(weights_of(truth), reflection).mean() < 0.02
    broken = truth.copy()
    arm = truth[:, 1] > 0.3
    broken[arm] = [0, 0, 1]
    differs = asymmetry(weights_of(broken), reflection)
    assert differs[truth[:, 1] > 0.5].min() > 0.3
    assert differs[truth[:, 0] > 0.5].min() > 0.3
    assert differs[truth[:, 2] > 0.95].mean() < 0.02


def test_symmetry_without_sides_can_only_average(reflection: zo.Symmetry, bent: Creature) -> None:
    turn = replace(reflection, distance=np.zeros_like(reflection.distance))
    values = point(np.abs(bent.directions[:, 0]))
    with pytest.raises(zo.MeshError, match="no left and right"):
        symmetrise(values, turn, "left_to_right")
    assert np.abs(symmetrise(values, turn, "average").values - values.values).mean() < 0.02
    with pytest.raises(ValueError, match="direction"):
        symmetrise(values, reflection, "both")  # type: ignore[arg-type]


def test_exchange_swaps_the_sides(reflection: zo.Symmetry, bent: Creature) -> None:
    x = bent.directions[:, 0]
    clear = np.abs(x) > 0.1
    exchanged = symmetrise(point(x), reflection, "exchange").values
    assert np.abs(exchanged + x).mean() < 0.02
    truth = true_weights(bent.directions)
    lopsided = np.column_stack([truth[:, 0] / 2, truth[:, 1], 1 - truth[:, 0] / 2 - truth[:, 1]])
    wanted = np.column_stack([truth[:, 0], truth[:, 1] / 2, 1 - truth[:, 0] - truth[:, 1] / 2])
    found = symmetrise(weights_of(lopsided), reflection, "exchange")
    assert np.abs(found.values.toarray() - wanted).sum(axis=1).mean() < 0.03
    label = point(np.where(x > 0, "left", "right"), zo.Kind.LABEL)
    assert (symmetrise(label, reflection, "exchange").values != label.values)[clear].mean() > 0.99
    turn = replace(reflection, distance=np.zeros_like(x))
    np.testing.assert_allclose(symmetrise(point(x), turn, "exchange").values, exchanged)


def ring(made: Creature, axis: int) -> np.ndarray:
    """(e,) mask of the edges between faces on opposite sides of the middle plane perpendicular to an axis."""
    surface = made.surface
    beyond = made.directions[surface.triangles, axis].mean(axis=1) > 0
    n, sides = len(surface.vertices), np.stack([surface.triangles, np.roll(surface.triangles, -1, axis=1)], axis=-1)
    numbers = [np.sort(ends, axis=-1) @ [n, 1] for ends in (surface.edges, sides)]
    order = np.argsort(numbers[0])
    edge = order[np.searchsorted(numbers[0], numbers[1], sorter=order)]
    return np.bincount(edge.ravel(), np.repeat(beyond, 3), len(surface.edges)) == 1


def marks_of(marked: np.ndarray) -> zo.Attribute:
    return zo.Attribute("Sharp", zo.Domain.EDGE, zo.Kind.BOOLEAN, marked)


def length_of(marked: np.ndarray, made: Creature) -> float:
    ends = made.surface.vertices[made.surface.edges[marked]]
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())


def test_edge_lines_are_redrawn_on_the_other_side(reflection: zo.Symmetry, bent: Creature) -> None:
    belt, x = ring(bent, 2), bent.directions[bent.surface.edges, 0]
    left, right = x.min(axis=1) > 0.1, x.max(axis=1) < -0.1
    found = symmetrise(marks_of(belt & (x.mean(axis=1) > 0)), reflection).values
    np.testing.assert_array_equal(found[left], belt[left])
    assert length_of(found & right, bent) == pytest.approx(length_of(belt & right, bent), rel=0.2)
    assert np.abs(bent.directions[bent.surface.edges[found & right], 2]).max() < 0.2
    both = symmetrise(marks_of(belt), reflection, "average").values
    assert both[belt].all()


def test_a_line_along_the_middle_stays_whole(reflection: zo.Symmetry, bent: Creature) -> None:
    middle = ring(bent, 0)
    found = symmetrise(marks_of(middle), reflection).values
    assert found[middle].mean() > 0.9
    assert length_of(found, bent) < 1.3 * length_of(middle, bent)
