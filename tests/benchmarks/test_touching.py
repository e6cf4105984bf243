# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies in poses in which limbs, hands or fingers touch, and no limb goes through another."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from benchmarks.everywhere.touching import GAP, POSES, arms_and_legs, feet_together, fingers, lips


@pytest.fixture(scope="module")
def bodies(benchmark_data: Path) -> Any:
    path = benchmark_data / "clothes" / "clothes.py"
    if not path.exists():
        pytest.skip("the clothes are not here")
    spec = importlib.util.spec_from_file_location("clothes", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Bodies()


def gap(vertices: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
    return float(np.asarray(cKDTree(vertices[one]).query(vertices[other])[0]).min())


def test_posed_limbs_touch(bodies: Any) -> None:
    limb, finger = arms_and_legs(bodies), fingers(bodies)
    still = bodies.vertices("woman")
    for pose, one, other in (
        (feet_together, limb == 2, limb == -2),
        (POSES["fingers together"][0], finger == 2, finger == 3),
    ):
        assert gap(still, one, other) > 3 * GAP
        assert gap(pose(bodies, "woman"), one, other) < GAP


def test_posed_bones_keep_lengths_and_other_limbs_stay(bodies: Any) -> None:
    limb, still = arms_and_legs(bodies), bodies.vertices("man")
    posed = POSES["crossed arms"][0](bodies, "man")
    np.testing.assert_allclose(posed[np.abs(limb) == 2], still[np.abs(limb) == 2], atol=1e-9)
    forearm = bodies.weights[:, bodies.bone_names.index("lowerarm01.L")] > 0.99
    apart = [np.linalg.norm(each[forearm] - each[forearm][0], axis=1) for each in (posed, still)]
    np.testing.assert_allclose(*apart, atol=0.2)
    assert np.abs(posed - still)[limb == 1].max() > 20


def test_limbs_are_numbered_by_side(bodies: Any) -> None:
    vertices = bodies.vertices("woman")
    for number in (arms_and_legs(bodies), fingers(bodies)):
        left = number > 0
        assert left.any()
        assert (number < 0).any()
        assert vertices[left, 0].min() > vertices[number < 0, 0].max() - 1
    lip = lips(bodies)
    assert vertices[lip == 1, 1].mean() > vertices[lip == 2, 1].mean()
