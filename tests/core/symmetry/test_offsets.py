# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacements are mirrored in local frames, so that they fit a posed creature."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature

import zoomout_core as zo
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import vertex_normals
from zoomout_core.symmetry.offsets import (
    frames,
    left_share,
    mirror_offsets,
    shape_asymmetry,
    split_offsets,
    symmetrise_offsets,
)


def bumps(made: Creature, directions: np.ndarray) -> np.ndarray:
    """(n, 3) displacements along the normals, whose size depends on directions (n, 3)."""
    height = 0.1 * (1 + np.sin(4 * directions[:, 0] + 1) * np.cos(3 * directions[:, 2]))
    return height[:, None] * vertex_normals(made.surface.vertices, made.surface.triangles)


def test_mirrored_displacements_rotate_with_the_limbs(reflection: zo.Symmetry, bent: Creature) -> None:
    truth = bumps(bent, bent.directions * [-1, 1, 1])
    found = mirror_offsets(bumps(bent, bent.directions), reflection)
    assert np.linalg.norm(found - truth, axis=1).mean() < 0.15 * np.linalg.norm(truth, axis=1).mean()


def test_frames_are_reflections_and_mutually_inverse(reflection: zo.Symmetry) -> None:
    there = frames(reflection)
    np.testing.assert_allclose(there @ there.transpose(0, 2, 1), np.broadcast_to(np.eye(3), there.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(there), -1)
    back = there[reflection.surface_map.vertex]
    assert np.linalg.norm(back @ there - np.eye(3), axis=(1, 2)).mean() < 0.2


def test_the_winning_side_keeps_its_displacements(reflection: zo.Symmetry, bent: Creature) -> None:
    left = bent.directions[:, 0] > 0
    whole = bumps(bent, np.abs(bent.directions) * [1, 1, 1])
    only_left = whole * left[:, None]
    found = symmetrise_offsets(only_left, reflection, "left_to_right")
    clear = bent.directions[:, 0] > 0.1
    np.testing.assert_array_equal(found[clear], only_left[clear])
    symmetric = bumps(bent, np.column_stack([np.abs(bent.directions[:, 0]), 0 * left, 0 * left]))
    mended = symmetrise_offsets(symmetric * left[:, None], reflection, "left_to_right")
    size = np.linalg.norm(symmetric, axis=1).mean()
    assert np.linalg.norm(mended - symmetric, axis=1).mean() < 0.15 * size
    nothing = symmetrise_offsets(symmetric * left[:, None], reflection, "right_to_left")
    assert np.linalg.norm(nothing, axis=1).mean() < 0.05 * size
    exchanged = symmetrise_offsets(symmetric * left[:, None], reflection, "exchange")
    assert np.linalg.norm(exchanged - symmetric * ~left[:, None], axis=1).mean() < 0.15 * size
    half = symmetrise_offsets(symmetric * left[:, None], reflection, "average")
    assert np.linalg.norm(half - symmetric / 2, axis=1).mean() < 0.15 * size


def test_a_key_is_split_smoothly_into_left_and_right(reflection: zo.Symmetry, bent: Creature) -> None:
    offsets = bumps(bent, bent.directions)
    left, right = split_offsets(offsets, reflection, blend=0.1)
    np.testing.assert_allclose(left + right, offsets)
    far = np.abs(reflection.distance) > 0.1 * np.sqrt(bent.surface.area)
    assert far[np.abs(bent.directions[:, 0]) > 0.9].all()
    on_left = bent.directions[:, 0] > 0
    assert np.abs(left[far & ~on_left]).max() == 0
    np.testing.assert_array_equal(left[far & on_left], offsets[far & on_left])
    share = left_share(reflection, 0.1)
    assert ((share > 0) & (share < 1)).sum() > 50
    np.testing.assert_allclose(share + reflection.surface_map.interpolate(share), 1, atol=0.15)


def test_dent_on_one_side_shows_on_both_in_any_pose(bent: Creature) -> None:
    at = bent.directions @ (np.array([0.6, -0.7, 0.1]) / np.linalg.norm([0.6, -0.7, 0.1]))
    normals = vertex_normals(bent.surface.vertices, bent.surface.triangles)
    dented = Surface(bent.surface.vertices - 0.15 * np.exp(60 * (at - 1))[:, None] * normals, bent.surface.triangles)
    heat = shape_asymmetry(zo.detect_symmetry(dented)[0])
    other = bent.directions @ (np.array([-0.6, -0.7, 0.1]) / np.linalg.norm([0.6, -0.7, 0.1]))
    inside, outside = (at > 0.99) | (other > 0.99), (at < 0.9) & (other < 0.9)
    assert heat[inside].mean() > 4 * np.median(heat[outside])


def test_displacements_must_fit_the_surface(reflection: zo.Symmetry) -> None:
    with pytest.raises(zo.MeshError, match="three numbers for each"):
        mirror_offsets(np.zeros((3, 3)), reflection)
