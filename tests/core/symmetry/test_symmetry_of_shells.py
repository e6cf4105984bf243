# SPDX-License-Identifier: GPL-3.0-or-later
"""A figure of loose shells is as symmetric as one skin: left and right shells swap."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh

import zoomout_core as zo
from zoomout_core.matching.components.hulls import HULLS
from zoomout_core.mesh.triangles import vertex_normals
from zoomout_core.symmetry.offsets import frames, mirror_offsets, shape_asymmetry
from zoomout_core.tuning import retune

pytestmark = pytest.mark.usefixtures("quick_search", "coarse_hulls")

# Ellipsoids: centre and radii. The figure faces -y; its left is +x. SIDED lists the left side only.
MIDDLE = {
    "hips": ((0, 0, 1.0), (0.2, 0.15, 0.17)),
    "chest": ((0, 0, 1.35), (0.24, 0.17, 0.28)),
    "head": ((0, -0.03, 1.82), (0.14, 0.17, 0.2)),
    "nose": ((0, -0.21, 1.8), (0.03, 0.06, 0.04)),
    "tail": ((0, 0.3, 0.95), (0.06, 0.24, 0.06)),
}
SIDED = {
    "upper arm": ((0.42, 0, 1.52), (0.22, 0.085, 0.085)),
    "lower arm": ((0.77, 0, 1.52), (0.2, 0.07, 0.07)),
    "hand": ((1.03, 0, 1.52), (0.12, 0.09, 0.04)),
    "thigh": ((0.13, 0, 0.72), (0.11, 0.12, 0.28)),
    "shin": ((0.14, 0, 0.3), (0.08, 0.09, 0.26)),
    "foot": ((0.14, -0.08, 0.03), (0.07, 0.17, 0.06)),
}
# A pose lists moves (side, shells, joint, angle, axis), outer joints first.
ARM, LEG = ("upper arm", "lower arm", "hand"), ("thigh", "shin", "foot")
JOINTS = {"elbow": (0.6, 0, 1.52), "shoulder": (0.2, 0, 1.52), "knee": (0.14, 0, 0.5), "hip": (0.12, 0, 1.0)}
Move = tuple[int, tuple[str, ...], str, float, tuple[float, float, float]]
WALK: tuple[Move, ...] = (
    (1, ARM[1:], "elbow", 0.9, (0, 0, -1)),
    (1, ARM, "shoulder", 0.7, (0, 1, 0)),
    (-1, ARM, "shoulder", 0.4, (0, 1, 0)),
    (-1, ARM, "shoulder", 0.5, (0, 0, -1)),
    (1, LEG[1:], "knee", 0.5, (1, 0, 0)),
    (1, LEG, "hip", 0.5, (-1, 0, 0)),
    (-1, LEG, "hip", 0.3, (1, 0, 0)),
)


@dataclass(frozen=True)
class Doll:
    """A surface with the shell's name, the shell's side and the place at rest (n, 3) of each vertex."""

    surface: zo.Surface
    shell: np.ndarray
    side: np.ndarray
    rest: np.ndarray


def doll(moves: tuple[Move, ...] = ()) -> Doll:
    """The figure in a pose; each shell has its own mesh."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    shells = [(0, name, *shape) for name, shape in MIDDLE.items()]
    shells += [(side, name, *shape) for side in (1, -1) for name, shape in SIDED.items()]
    points, rest = [], []
    for number, (side, name, centre, radii) in enumerate(shells):
        turned = (
            ball.vertices
            @ trimesh.transformations.random_rotation_matrix(np.random.default_rng(number).random(3))[:3, :3]
        )
        place = (turned * radii + centre) * [1 if side >= 0 else -1, 1, 1]
        rest.append(place)
        points.append(posed(place, side, name, moves))
    count = len(ball.vertices)
    faces = np.concatenate(
        [(ball.faces if side >= 0 else ball.faces[:, ::-1]) + count * i for i, (side, *_) in enumerate(shells)]
    )
    surface = zo.Surface(np.concatenate(points), faces)
    names = np.repeat([name for _, name, *_ in shells], count)
    return Doll(surface, names, np.repeat([side for side, *_ in shells], count), np.concatenate(rest))


def posed(points: np.ndarray, side: int, name: str, moves: tuple[Move, ...]) -> np.ndarray:
    for of_side, names, joint, angle, axis in moves:
        if side == of_side and name in names:
            about = np.array(JOINTS[joint]) * [side, 1, 1]
            # Rotations about y and z change sign on the right.
            sense = np.array([1, side, side])
            turn = trimesh.transformations.rotation_matrix(angle, sense * axis)[:3, :3]
            points = (points - about) @ turn.T + about
    return points


def heap() -> zo.Surface:
    """A random heap of ellipsoids without symmetry."""
    random = np.random.default_rng(1)
    ball = trimesh.creation.icosphere(subdivisions=1)
    places = [ball.vertices * random.uniform(0.15, 0.6, 3) + random.uniform(-1, 1, 3) for _ in range(14)]
    faces = np.concatenate([ball.faces + len(ball.vertices) * i for i in range(len(places))])
    return zo.Surface(np.concatenate(places), faces)


@pytest.fixture(scope="module")
def walking() -> Doll:
    return doll(WALK)


@pytest.fixture(scope="module")
def found(walking: Doll) -> zo.Symmetry:
    """The first symmetry of the walking figure."""
    return zo.detect_symmetry(walking.surface)[0]


def test_left_and_right_shells_are_swapped_in_a_pose(found: zo.Symmetry, walking: Doll) -> None:
    assert found.shape.proxy.full.is_hull
    assert found.reverses_orientation
    assert found.certainty > 0.9
    image = found.surface_map.vertex
    right = (walking.shell[image] == walking.shell) & (walking.side[image] == -walking.side)
    assert right.mean() > 0.97
    off = found.surface_map.interpolate(walking.rest) - walking.rest * [-1, 1, 1]
    assert np.linalg.norm(off, axis=1).mean() < 0.05


def test_shells_are_on_their_side_and_middle_ones_on_both(found: zo.Symmetry, walking: Doll) -> None:
    sided = walking.side != 0
    np.testing.assert_array_equal(found.sides()[sided], walking.side[sided])
    clear = ~sided & (np.abs(walking.rest[:, 0]) > 0.05)
    assert (found.sides()[clear] == np.sign(walking.rest[clear, 0])).mean() > 0.95


def test_symmetry_line_crosses_only_the_middle_shells(found: zo.Symmetry, walking: Doll) -> None:
    on_line = walking.shell[found.line.edges].ravel()
    assert set(on_line) <= set(MIDDLE)
    assert {"hips", "chest", "head"} <= set(on_line)


def test_displacements_of_shells_are_mirrored_in_local_frames(found: zo.Symmetry, walking: Doll) -> None:
    height = 0.02 * (1 + np.sin(9 * walking.rest[:, 2] + 4 * walking.rest[:, 0]))
    mirrored = 0.02 * (1 + np.sin(9 * walking.rest[:, 2] - 4 * walking.rest[:, 0]))
    normals = vertex_normals(walking.surface.vertices, walking.surface.triangles)
    truth = mirrored[:, None] * normals
    off = np.linalg.norm(mirror_offsets(height[:, None] * normals, found) - truth, axis=1)
    assert off.mean() < 0.25 * np.linalg.norm(truth, axis=1).mean()
    np.testing.assert_allclose(np.linalg.det(frames(found)), -1)


def test_a_dent_in_a_shell_shows_on_both_sides(found: zo.Symmetry, walking: Doll) -> None:
    centre = np.array([0.42, -0.085, 1.52])
    dent = 0.05 * np.exp(-((np.linalg.norm(walking.rest - centre, axis=1) / 0.08) ** 2))
    normals = vertex_normals(walking.surface.vertices, walking.surface.triangles)
    dented = walking.surface.with_vertices(walking.surface.vertices - dent[:, None] * normals)
    heat = shape_asymmetry(replace(found, surface=dented))
    near = np.linalg.norm(walking.rest * np.where(walking.rest[:, :1] < 0, [-1, 1, 1], 1) - centre, axis=1) < 0.04
    assert heat[near].mean() > 4 * np.median(heat)


@pytest.mark.slow
def test_asymmetric_heap_has_no_certain_symmetry() -> None:
    with retune(HULLS, resolution=64):
        assert zo.detect_symmetry(heap(), samples=400)[0].certainty < 0.5
