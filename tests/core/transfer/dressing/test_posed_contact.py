# SPDX-License-Identifier: GPL-3.0-or-later
"""Cloth that stays outside of the skin in poses, by small displacements at rest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array

from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer.dressing.barriers import SidedSurface
from zoomout_core.transfer.dressing.dress import clear_in_poses, fit_to_shape
from zoomout_core.transfer.dressing.layers import Dressed
from zoomout_core.transfer.dressing.posed_contact import POSED_CONTACT, PosedBody
from zoomout_core.transfer.rigging.poses import pose_of_turns
from zoomout_core.tuning import retune

# A rod along z with a joint in its middle, and a sleeve around the middle that bends a little above it.
BODY = ball(1.0, radii=(0.3, 0.3, 1), count=2500, seed=1)
WHOLE = ball(1.0, radii=(0.303, 0.303, 1.003), count=1500, seed=2)
USED, CORNERS = np.unique(
    WHOLE.triangles[np.abs(WHOLE.vertices[WHOLE.triangles][:, :, 2]).max(axis=1) < 0.5], return_inverse=True
)
SLEEVE = Surface(WHOLE.vertices[USED], CORNERS.reshape(-1, 3))
POSES = np.array(
    [
        pose_of_turns(np.array([[0, 0, 0], [angle, 0, 0]]), np.array([[0.0, 0, -1], [0, 0, 0]]), np.array([-1, 0]))
        for angle in (-0.5, 0.5)
    ]
)


def weights(vertices: np.ndarray, shift: float = 0.0) -> csr_array:
    """(n, 2) weights of the two bones, which change around a place on the z axis."""
    upper = np.clip(0.5 + (vertices[:, 2] - shift) / 0.6, 0, 1)
    return csr_array(np.column_stack([1 - upper, upper]))


RIG = PosedBody(weights(BODY.vertices), POSES)


def dressed(unit: float = 1.0) -> Dressed:
    body, sleeve = (each.with_vertices(unit * each.vertices) for each in (BODY, SLEEVE))
    return fit_to_shape(body, body.vertices, body, [sleeve])


def depth(sleeve: np.ndarray, of_sleeve: csr_array, poses: np.ndarray = POSES) -> float:
    """The mean depth in the skin of the sleeve's vertices, over the poses."""
    inside = []
    for pose in poses:
        skin = transform_points(blend_matrices(pose, RIG.weights), BODY.vertices)
        off = SidedSurface(skin, BODY.triangles).sides(transform_points(blend_matrices(pose, of_sleeve), sleeve))[0]
        inside.append(np.maximum(-off, 0).mean())
    return float(np.mean(inside))


@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_cloth_is_displaced_where_the_skin_comes_through_in_poses(unit: float) -> None:
    of_sleeve = weights(SLEEVE.vertices, 0.05)
    before = dressed(unit)
    rig = RIG._replace(poses=POSES * [1, 1, 1, unit])
    after = clear_in_poses(before, rig, [of_sleeve])
    sleeve = after.vertices[0] / unit
    assert depth(before.vertices[0] / unit, of_sleeve) > 2e-4
    assert depth(sleeve, of_sleeve) < 0.5 * depth(before.vertices[0] / unit, of_sleeve)
    assert SidedSurface(BODY.vertices, BODY.triangles).sides(sleeve)[0].min() > 0
    moved = np.linalg.norm(sleeve - before.vertices[0] / unit, axis=1)
    assert 0.001 < moved.max() < 0.03


def test_cloth_with_other_weights_is_displaced_if_it_stays_near() -> None:
    """Such as a shoe that one toe moves."""
    lower = csr_array(np.eye(2)[np.zeros(len(SLEEVE.vertices), dtype=int)])
    poses = np.array(
        [
            pose_of_turns(np.array([[0, 0, 0], [angle, 0, 0]]), np.array([[0.0, 0, -1], [0, 0, 0]]), np.array([-1, 0]))
            for angle in (-0.03, 0.03)
        ]
    )
    before = dressed()
    after = clear_in_poses(before, RIG._replace(poses=poses), [lower])
    assert depth(after.vertices[0], lower, poses) < 0.5 * depth(before.vertices[0], lower, poses)


def test_cloth_that_moves_with_the_skin_stays() -> None:
    """But where the bend presses it together."""
    before = dressed()
    moved = [
        np.linalg.norm(
            clear_in_poses(before, RIG, [weights(SLEEVE.vertices, shift)]).vertices[0] - before.vertices[0], axis=1
        ).mean()
        for shift in (0.0, 0.05)
    ]
    assert moved[0] < 0.5 * moved[1]


@pytest.mark.parametrize("column", [0, None])
def test_cloth_that_hangs_free_or_has_no_weights_stays(column: int | None) -> None:
    """A skirt that moves with the hips cannot be kept above a knee."""
    before = dressed()
    free = None if column is None else csr_array(np.eye(2)[np.full(len(SLEEVE.vertices), column)])
    after = clear_in_poses(before, RIG, [free])
    upper = SLEEVE.vertices[:, 2] > 0.25
    assert np.linalg.norm(after.vertices[0] - before.vertices[0], axis=1)[upper].max() < 0.004


@pytest.mark.parametrize("limit", [{"near": 0.0}, {"depth": 0.0}])
def test_each_limit_excludes_places(limit: dict[str, float]) -> None:
    """Those far from the skin, or deep in it in a pose."""
    bent, moved = np.abs(SLEEVE.vertices[:, 2]) < 0.2, []
    for limits in ({}, limit):
        before = dressed()
        with retune(POSED_CONTACT, **limits):
            after = clear_in_poses(before, RIG, [weights(SLEEVE.vertices, 0.05)])
        moved.append(np.linalg.norm(after.vertices[0] - before.vertices[0], axis=1)[bent].mean())
    assert moved[1] < 0.2 * moved[0]
