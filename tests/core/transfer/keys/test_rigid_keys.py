# SPDX-License-Identifier: GPL-3.0-or-later
"""Loose parts that the source's keys move rigidly, such as teeth, move rigidly on the target."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from transfer_meshes import globe, identity

from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer import Attribute, Domain, Kind, transfer

TURN = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
BODY = globe(40, 30)[0]
TEETH = [ball(0.15, (x, 0, -0.2), count=200, seed=seed) for seed, x in enumerate((-0.25, 0.0, 0.25))]
SOURCE = Surface.joined([BODY, *TEETH])
TOOTH = np.repeat(np.arange(4), [len(BODY.vertices), 200, 200, 200])


def jaw(points: np.ndarray) -> np.ndarray:
    """(n, 3) offsets by a rotation about an axis behind the parts."""
    pivot = np.array([0, 1.0, 0])
    return Rotation.from_euler("x", 25, degrees=True).apply(points - pivot) + pivot - points


def scatter_teeth(seed: int) -> SurfaceMap:
    """The identity, but on the teeth each vertex is mapped to another one of the same tooth, up to 0.1 away."""
    random = np.random.default_rng(seed)
    vertex = np.arange(len(SOURCE.vertices))
    for part in (1, 2, 3):
        mine = np.flatnonzero(part == TOOTH)
        near = np.linalg.norm(SOURCE.vertices[mine][:, None] - SOURCE.vertices[mine], axis=2) < 0.1
        vertex[mine] = [mine[random.choice(np.flatnonzero(row))] for row in near]
    return SurfaceMap.from_vertices(vertex, SOURCE)


def transfer_keys(offsets: np.ndarray, surface_map: SurfaceMap, target: Surface) -> np.ndarray:
    attribute = Attribute("keys", Domain.POINT, Kind.OFFSET, offsets[:, None])
    return np.asarray(transfer(attribute, surface_map, SOURCE, target).values)[:, 0]


def bend(vertices: np.ndarray, offsets: np.ndarray) -> float:
    """How far moved points (n, 3) are from the best rigid motion of all."""
    motion = procrustes(vertices, vertices + offsets, scales=(1, 1))
    return float(np.linalg.norm(motion(vertices) - vertices - offsets, axis=1).max())


def test_teeth_follow_the_jaw_on_a_turned_and_scaled_head() -> None:
    offsets = np.where((TOOTH > 0)[:, None] | (SOURCE.vertices[:, [2]] < 0), jaw(SOURCE.vertices), 0)
    target = SOURCE.with_vertices(2 * SOURCE.vertices @ TURN.T + 5)
    found, truth = transfer_keys(offsets, scatter_teeth(0), target), 2 * offsets @ TURN.T
    teeth = TOOTH > 0
    assert bend(target.vertices[teeth], found[teeth]) < 1e-9
    assert np.linalg.norm(found - truth, axis=1)[teeth].max() < 0.05 * np.linalg.norm(truth, axis=1)[teeth].max()


def test_round_parts_turn_with_the_body_however_they_are_mapped() -> None:
    eye, centre = TOOTH == 2, TEETH[1].vertices.mean(axis=0)
    offsets = np.zeros_like(SOURCE.vertices)
    offsets[eye] = Rotation.from_euler("y", 20, degrees=True).apply(SOURCE.vertices[eye] - centre) + centre
    offsets[eye] -= SOURCE.vertices[eye]
    offsets[0] = 1e-3  # of the body, too
    vertex = np.arange(len(SOURCE.vertices))
    turned = Rotation.from_euler("x", 90, degrees=True).apply(SOURCE.vertices[eye] - centre) + centre
    vertex[eye] = np.flatnonzero(eye)[np.linalg.norm(SOURCE.vertices[eye][:, None] - turned, axis=2).argmin(axis=0)]
    found = transfer_keys(offsets, SurfaceMap.from_vertices(vertex, SOURCE), SOURCE)
    assert np.linalg.norm(found - offsets, axis=1)[eye].max() < 0.1 * np.linalg.norm(offsets, axis=1).max()


# Teeth and an eye: their centres are not on a line.
SKULL = Surface.joined([SOURCE, ball(0.15, (0, 0.3, 0.3), count=200, seed=3)])
INSIDE = np.arange(len(SKULL.vertices)) >= len(BODY.vertices)


def jaw_of_head(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offsets of the inner parts by a key that moves all, and those found on a head with other vertices (n, 3)."""
    offsets = np.where(INSIDE[:, None], jaw(SKULL.vertices), 1e-3)
    attribute = Attribute("keys", Domain.POINT, Kind.OFFSET, offsets[:, None])
    found = transfer(attribute, identity(SKULL), SKULL, SKULL.with_vertices(vertices)).values
    return offsets[INSIDE], np.asarray(found)[INSIDE, 0]


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_parts_of_a_skull_move_in_its_frame_not_that_of_the_skin(mirror: float) -> None:
    side = np.array([mirror, 1, 1])
    offsets, found = jaw_of_head(side * np.where(INSIDE[:, None], SKULL.vertices, SKULL.vertices @ TURN.T))
    assert np.linalg.norm(found - side * offsets, axis=1).max() < 0.01 * np.linalg.norm(offsets, axis=1).max()


def test_parts_without_a_rigid_frame_move_like_the_body() -> None:
    vertices = SKULL.vertices.copy()
    vertices[-200:] += 0.8, 0, 0  # the eye is elsewhere
    offsets, found = jaw_of_head(vertices @ TURN.T)
    assert np.linalg.norm(found - offsets @ TURN.T, axis=1).max() < 0.05 * np.linalg.norm(offsets, axis=1).max()


@pytest.mark.parametrize("part", [1, 3])
def test_parts_that_a_key_bends_or_leaves_in_place_are_not_rigid(part: int) -> None:
    mine = part == TOOTH
    offsets = np.zeros_like(SOURCE.vertices)
    offsets[mine] = 0.1 * np.sin(20 * SOURCE.vertices[mine])
    found = transfer_keys(offsets, identity(SOURCE), SOURCE)
    assert np.linalg.norm(found - offsets) < 0.05 * np.linalg.norm(offsets)
    assert not found[~mine].any()
