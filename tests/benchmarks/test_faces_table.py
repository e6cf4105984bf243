# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of expression keys: figures of right and of wrong keys, and a row for each method."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from creatures import creature, true_vertex
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks import faces
from benchmarks.faces.cases import JAW_OPEN, REMESHED, Case
from benchmarks.faces.measures import BLINKS, figures
from benchmarks.faces.methods import METHODS
from zoomout_core.arrays import Floats
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

NAMES = [JAW_OPEN, *BLINKS]
FAULTS = ("error", "skin", "worst", "flipped", "overturned", "torn", "solids")


def head(scale: float = 1.0) -> Case:
    """A ball of radius 10 cm with lips, lids and an eye, whose true keys open the lips and close the lids."""
    surface = ball(10.0, count=900, seed=2)
    tree = cKDTree(surface.vertices)
    lips, lids = ((tree.query([[0, y, 10]])[1], tree.query([[0, -y, 10]])[1]) for y in (2.0, 4.0))
    truth = np.zeros((len(NAMES), 900, 3))
    truth[0, :, 1] = np.sign(surface.vertices[:, 1])
    truth[1:, :, 1] = -np.sign(surface.vertices[:, 1])
    eye = np.flatnonzero(surface.vertices[:, 2] < -8)
    return Case(
        REMESHED,
        "ball",
        surface,
        Surface(scale * surface.vertices, surface.triangles),
        NAMES,
        truth,
        scale * truth,
        np.ones(900, dtype=bool),
        scale,
        lips,
        lids,
        {"eye": eye},
    )


def test_true_keys_have_no_faults() -> None:
    case = head()
    found = figures(case, case.truth)
    assert {name: found[name] for name in FAULTS} == dict.fromkeys(FAULTS, 0)
    assert found["lips"] == pytest.approx(1)
    assert found["blink"] == pytest.approx(0, abs=1e-9)
    assert found["bent"] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_faults_are_counted_in_the_unit_of_the_source(scale: float) -> None:
    case = head(scale)
    half = figures(case, case.truth / 2)
    assert half["error"] == pytest.approx(0.5)
    assert half["lips"] == pytest.approx(0.5, abs=0.02)
    assert half["blink"] == pytest.approx(10, rel=0.05)  # lids that come 2 cm nearer stay 1 cm too far apart
    assert half["solids"] == pytest.approx(5, rel=0.01)
    wrong = case.truth.copy()
    wrong[1] *= -1
    assert figures(case, wrong)["worst"] == pytest.approx(2)
    assert figures(case, wrong)["key"] == NAMES[1]


def test_flipped_triangles_and_torn_edges_are_counted() -> None:
    case = head()
    keys = case.truth.copy()
    corner = case.target.triangles[np.abs(case.target.vertices[case.target.triangles, 1]).min(axis=1).argmax()][0]
    keys[0, corner] += 4 * np.cross([0, 0, 1.0], case.target.vertices[corner]) / 10
    found = figures(case, keys)
    assert found["flipped"] == found["overturned"] > 0
    assert found["torn"] > 0


def test_triangles_flipped_by_truth_are_not_overturned() -> None:
    case = head()
    keys = case.truth.copy()
    corner = case.target.triangles[np.abs(case.target.vertices[case.target.triangles, 1]).min(axis=1).argmax()][0]
    case.truth[0, corner] += 4 * np.cross([0, 0, 1.0], case.target.vertices[corner]) / 10
    found = figures(case, keys)
    assert found["flipped"] > 0
    assert found["overturned"] == 0


def test_turning_a_solid_does_not_bend_it() -> None:
    case = head()
    eye = case.solids["eye"]
    case.truth[:, eye] = 0
    keys = case.truth.copy()
    turned = Rotation.from_euler("x", 30, degrees=True).apply(case.target.vertices[eye])
    keys[:, eye] = turned - case.target.vertices[eye]
    assert figures(case, keys)["solids"] > 1
    assert figures(case, keys)["bent"] == pytest.approx(0, abs=1e-6)
    keys[:, eye] *= np.random.default_rng(0).uniform(0, 1, (1, len(eye), 1))
    assert figures(case, keys)["bent"] > 1


@pytest.mark.slow
def test_each_method_has_a_row(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    source, target = creature(700, 1), creature(600, 2)
    at = true_vertex(source, target)
    marks, marked = (found[:68] for found in np.unique(at, return_index=True))
    keys = np.stack([_bulge(source.surface.vertices, axis) for axis in range(3)])
    case = Case(
        REMESHED,
        "creature",
        source.surface,
        target.surface,
        NAMES,
        keys,
        keys[:, at],
        np.ones(600, dtype=bool),
        landmarks=(marks, target.surface.vertices[marked]),
    )
    monkeypatch.setattr(faces, "cases", lambda data, most: iter([case, replace(case, kind="other", landmarks=None)]))
    tables = faces.run(tmp_path, None, slow=False)
    errors = {(row["kind"], row["method"]): row["error"] for row in tables["rows"]}
    assert list(errors) == [(REMESHED, name) for name in METHODS] + [
        ("other", name) for name in METHODS if "68" not in name
    ]
    assert all(error < 0.4 for error in errors.values())
    assert [row["pair"] for row in tables["worst"]] == ["creature", "creature"]


def _bulge(vertices: Floats, axis: int) -> Floats:
    """(n, 3) offsets outward on one side."""
    return 0.1 * vertices * np.clip(vertices[:, [axis]], 0, None)
