# SPDX-License-Identifier: GPL-3.0-or-later
"""Malformed files and hard meshes: those of the tests, and modified copies of a clean mesh."""

from __future__ import annotations

from collections.abc import Callable
from importlib import util
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.samples import creature
from zoomout_core.spectral.sampling import farthest_points

# The files that `tests/bad_input` gives to each entry point.
MALFORMED = Path(__file__).parents[2] / "tests" / "bad_input" / "malformed.py"
# Numbers of vertices of the clean mesh and of another sampling of the same shape, pose and position.
VERTICES = 1500, 1200

LANDMARKS = 8

Mesh = tuple[Floats, Integers]


def malformed_files() -> dict[str, bytes]:
    """The content of each malformed file, by its name."""
    spec = util.spec_from_file_location("malformed", MALFORMED)
    assert spec is not None
    assert spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    files: dict[str, bytes] = module.MALFORMED
    return files


def clean() -> tuple[Mesh, Mesh]:
    """The source, and the target to be modified: closest points are right to half an edge."""
    source, target = (creature(count, seed=seed).surface for seed, count in enumerate(VERTICES))
    return (source.vertices, source.triangles), (target.vertices, target.triangles)


def landmarks() -> Integers:
    """(8, 2) distant vertices of the source, and the target's vertices at the same places."""
    (source, _), (target, _) = clean()
    chosen = farthest_points(source, LANDMARKS)
    return np.stack([chosen, cKDTree(target).query(source[chosen])[1]], axis=1)


def hard_meshes() -> dict[str, Callable[[Mesh], Mesh]]:
    """Modified targets by name; their first vertices are the target's, in the same order."""
    return {
        "clean": lambda mesh: mesh,
        "half of the faces turned over": _turn_half,
        "every face twice": lambda mesh: (mesh[0], np.concatenate([mesh[1], mesh[1]])),
        "both sides of every face": lambda mesh: (mesh[0], np.concatenate([mesh[1], mesh[1][:, ::-1]])),
        "each triangle with vertices of its own": _soup,
        "every seventh face missing": lambda mesh: (mesh[0], mesh[1][np.arange(len(mesh[1])) % 7 > 0]),
        "faces without an extent": lambda mesh: (mesh[0], np.concatenate([mesh[1], mesh[1][:200, [0, 0, 1]]])),
        "300 vertices that no face uses": lambda mesh: (_with(mesh[0], 300, 0.0), mesh[1]),
        "an unused vertex that is NaN": lambda mesh: (_with(mesh[0], 1, np.nan), mesh[1]),
        "a used vertex that is NaN": lambda mesh: (_change(mesh[0], 7, np.nan), mesh[1]),
        "a used vertex at 1e30": lambda mesh: (_change(mesh[0], 7, 1e30), mesh[1]),
        "300 loose triangles around it": _dust,
        "a fan on one edge": _fan,
        "all faces between three vertices": lambda mesh: (mesh[0], np.tile([0, 1, 2], (len(mesh[1]), 1))),
        "no extent": lambda mesh: (mesh[0] * 0, mesh[1]),
        "one triangle": lambda mesh: (mesh[0], mesh[1][:1]),
        "no faces": lambda mesh: (mesh[0], mesh[1][:0]),
    }


def _turn_half(mesh: Mesh) -> Mesh:
    triangles = mesh[1].copy()
    triangles[::2] = triangles[::2, ::-1]
    return mesh[0], triangles


def _soup(mesh: Mesh) -> Mesh:
    corners = mesh[1].ravel()
    used = np.concatenate([mesh[0], mesh[0][corners]])
    return used, len(mesh[0]) + np.arange(len(corners)).reshape(-1, 3)


def _with(vertices: Floats, count: int, value: float) -> Floats:
    return np.concatenate([vertices, np.full((count, 3), value)])


def _change(vertices: Floats, which: int, value: float) -> Floats:
    changed = vertices.copy()
    changed[which] = value
    return changed


def _dust(mesh: Mesh) -> Mesh:
    centres = np.random.default_rng(0).uniform(mesh[0].min(), mesh[0].max(), (300, 1, 3))
    corners = (centres + np.random.default_rng(1).normal(size=(300, 3, 3)) * 0.01).reshape(-1, 3)
    return np.concatenate([mesh[0], corners]), np.concatenate([mesh[1], len(mesh[0]) + np.arange(900).reshape(-1, 3)])


def _fan(mesh: Mesh) -> Mesh:
    tips = mesh[0][mesh[1][0]].mean(axis=0) + np.random.default_rng(0).normal(size=(12, 3)) * 0.05
    fan = [[*mesh[1][0][:2], len(mesh[0]) + number] for number in range(12)]
    return np.concatenate([mesh[0], tips]), np.concatenate([mesh[1], fan])
