# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of correctives: what keys should add, and means over pairs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array

from benchmarks import correctives
from benchmarks.outfits.clothes import Body, Bones, move
from zoomout_core.geometry.procrustes import Similarities
from zoomout_core.mesh.affine_maps import transform_points
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer.rigging.poses import pose_of_turns
from zoomout_core.transfer.rigging.skinning import skinning_matrices


def test_corrected_body_equals_dual_quaternion_skinning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(correctives, "JOINTS", {"waist": ("upper", (0, 0, 1), 90.0)})
    surface = ball(1.0, count=300, seed=0)
    upper = np.clip(0.5 + surface.vertices[:, 1], 0, 1)
    heads = np.array([[0.0, -1, 0], [0, 0, 0]])
    bones = Bones(("lower", "upper"), np.array([-1, 0]), heads, np.array([[0.0, 0, 0], [0, 1, 0]]))
    body = Body(surface, np.column_stack([1 - upper, upper]), {}, [], bones)
    pose = pose_of_turns(np.radians([[0, 0, 0], [90.0, 0, 0]]), heads, bones.parents)
    transforms = Similarities(np.ones(2), pose[:, :, :3], pose[:, :, 3])
    smooth = skinning_matrices(transforms, csr_array(body.weights), preserve_volume=True)
    added, offsets = correctives._correct(body, "waist")
    posed = transform_points(smooth, surface.vertices)
    np.testing.assert_allclose(move(surface.vertices + offsets, body.weights, pose), posed, atol=1e-9)
    np.testing.assert_allclose(move(surface.vertices, body.weights, pose) + added, posed, atol=1e-9)
    assert np.linalg.norm(added, axis=1).max() > 0.2


def test_rows_are_means_over_pairs_with_the_smallest_value() -> None:
    record = {"rig": correctives.OWN, "joint": "elbow", correctives.COPIED: 0.5, "error": 0.1, "value": 1.0}
    (row,) = correctives._rows(
        [record, record | {"error": 0.3, "value": 0.9}], ("rig", "joint"), (correctives.COPIED, "error")
    )
    assert (row["pairs"], row["error"], row["value"]) == (2, pytest.approx(0.2), 0.9)
