# SPDX-License-Identifier: GPL-3.0-or-later
"""A set of generated creatures, in the format of the benchmark data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from creatures import creature, directions, mirrored_vertex, true_vertex
from scipy.spatial import cKDTree

from benchmarks.datasets import TRUTH
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

BENDS = {"a": 0.0, "b": 0.9}
VERTICES, PLACES = 900, 300
# The pose and the builds of the set of clothes.
HALF_TURN = np.diag([-1.0, 1, -1])
BUILDS = ["woman", "man", "thin", "tall"]


@pytest.fixture(scope="module", autouse=True)
def _each_match_quick(few_candidates: None) -> None:
    """Matches are computed by the core, and tested there."""


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one set of two shapes and two published maps: the truth, and its mirror image."""
    folder = tmp_path_factory.mktemp("data") / "creatures"
    folder.mkdir()
    shapes = {name: creature(VERTICES, seed, bend) for seed, (name, bend) in enumerate(BENDS.items())}
    places = directions(PLACES, seed=2)
    known = {}
    for name, shape in shapes.items():
        write_off(folder / f"{name}.off", shape.surface)
        tree = cKDTree(shape.directions)
        known[name], known[f"{name}.sym"] = tree.query(places)[1], tree.query(places * [-1, 1, 1])[1]
    np.savez(folder / "correspondence.npz", **known)
    (folder / "pairs.txt").write_text("a b\n")
    for method, found in (("direct", true_vertex), ("symm", mirrored_vertex)):
        np.savez(folder / f"map_ini_{method}.npz", a__b=found(shapes["b"], shapes["a"]))
    return folder.parent


@pytest.fixture(scope="session")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cuts and one mesh with holes of a creature with longer limbs on one side, and one mesh of two parts."""
    folder = tmp_path_factory.mktemp("data") / "partial"
    folder.mkdir()
    truths = {}
    kinds = {"cut_a_00": -0.2, "cut_a_01": -0.4, "holes_a_00": -0.6, "both_partial_00": -0.2}
    for seed, (name, beyond) in enumerate(kinds.items()):
        whole, bent = creature(1300, 5 + seed, asymmetry=0.3), creature(1200, seed, bend=0.5, asymmetry=0.3)
        inside = (bent.directions[:, 0] > beyond)[bent.surface.triangles].all(axis=1)
        used, triangles = np.unique(bent.surface.triangles[inside], return_inverse=True)
        write_off(folder / f"{name}_source.off", whole.surface)
        write_off(folder / f"{name}_target.off", Surface(bent.surface.vertices[used], triangles.reshape(-1, 3)))
        truths[name] = true_vertex(whole, bent)[used]
    truths["both_partial_00"][::3] = -1
    np.savez(folder / TRUTH, **truths)
    return folder.parent


@pytest.fixture
def wardrobe(tmp_path: Path) -> Path:
    """A set `clothes`: egg-shaped bodies that differ in height, with two bones, and a shirt with its own bone."""
    body = ball(1.0, count=700, seed=1)
    builds = [body.vertices * [1, height, 1] * 20 for height in (1.5, 1.6, 1.2, 1.8)]
    upper = body.vertices[:, 1] > 0
    bones = {
        "weight_vertex": np.arange(700),
        "weight_bone": upper.astype(int),
        "weight_value": np.ones(700),
    }
    shape = {"face_sizes": np.full(len(body.triangles), 3), "face_vertices": body.triangles.ravel()}
    names = {"key_names": np.array(["wide", "odd"]), "key_strict": np.array([True, False])}
    wide = 0.1 * body.vertices * [20, 0, 20]
    folder = tmp_path / "clothes"
    (folder / "garments").mkdir(parents=True)
    np.savez(
        folder / "bodies.npz",
        builds=np.array(BUILDS),
        build_strict=np.array([True, True, True, False]),
        vertices=np.array(builds),
        keys=np.array([wide, wide]),
        bone_names=np.array(["lower", "upper"]),
        bone_parents=np.array(["", "lower"]),
        heads=np.array([[points[~upper].mean(axis=0), np.zeros(3)] for points in builds]),
        tails=np.array([[np.zeros(3), points[upper].mean(axis=0)] for points in builds]),
        poses=np.array([[np.eye(3), HALF_TURN]]),
        topologies=np.array(["again"]),
        **{
            f"again_{name}": value
            for name, value in {**shape, **bones, "vertices": builds, "keys": [wide, wide]}.items()
        },
        **shape,
        **bones,
        **names,
    )
    shirts = [points * 1.1 for points in builds]
    hem = np.array([points[:5].mean(axis=0, keepdims=True) for points in shirts])
    own = np.arange(5)
    np.savez(
        folder / "garments" / "shirt.npz",
        builds=np.array(BUILDS),
        vertices=np.array(shirts),
        keys=np.array([1.1 * wide, 1.1 * wide]),
        extra_names=np.array(["hem"]),
        extra_parents=np.array(["upper"]),
        extra_heads=hem,
        **shape,
        **names,
        weight_vertex=np.arange(700),
        weight_bone=np.where(np.isin(np.arange(700), own), 2, upper),
        weight_value=np.ones(700),
    )
    return tmp_path


def write_off(path: Path, surface: Surface) -> None:
    lines = [f"OFF\n{len(surface.vertices)} {len(surface.triangles)} 0"]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in surface.vertices.tolist()]
    lines += [f"3 {a} {b} {c}" for a, b, c in surface.triangles.tolist()]
    path.write_text("\n".join(lines))
