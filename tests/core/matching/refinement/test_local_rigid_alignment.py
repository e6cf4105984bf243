# SPDX-License-Identifier: GPL-3.0-or-later
"""A target is aligned with its source by rotations, never reflections, so that no limb is mirrored."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature, creature
from loose_parts import shape_of
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from zoomout_core.evaluation import flipped_share
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.refinement.local_rigid_alignment import RIGID_ALIGNMENT, _turns, align
from zoomout_core.samples.spheres import ball
from zoomout_core.tuning import retune

WIDTH = 0.08


@pytest.fixture(scope="module")
def shape() -> ShapeAnalysis:
    mesh, _ = creature(2500, seed=1, bend=0.4).surface.working.part(0)
    return analyse(mesh, 120, 400, 0)


def align_positions(images: np.ndarray, shape: ShapeAnalysis, mirrored: bool = False) -> np.ndarray:
    return align(shape.basis.coefficients(images), shape, WIDTH, mirrored).positions


def distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b, axis=1).mean())


def test_rotated_copy_is_aligned_with_itself(shape: ShapeAnalysis) -> None:
    turned = shape.mesh.vertices @ Rotation.from_euler("xyz", [0.5, 2.0, -1.0]).as_matrix().T
    assert distance(align_positions(turned, shape), turned) < 0.005


def test_mirrored_limb_is_aligned_without_a_reflection(shape: ShapeAnalysis) -> None:
    vertices = shape.mesh.vertices
    arm = vertices[:, 0] > 0.6 * vertices[:, 0].max()
    images = vertices.copy()
    images[arm, 1] = 2 * vertices[arm, 1].mean() - vertices[arm, 1]  # exchanges front and back of the arm
    assert distance(images[arm], vertices[arm]) > 0.02
    assert distance(align_positions(images, shape)[arm], vertices[arm]) < 0.5 * distance(images[arm], vertices[arm])


def test_orientation_reversing_maps_are_aligned_mirrored(shape: ShapeAnalysis) -> None:
    mirrored = shape.mesh.vertices * [1, -1, 1]
    assert distance(align_positions(mirrored, shape, mirrored=True), mirrored) < 0.005
    assert distance(align_positions(mirrored, shape, mirrored=False), mirrored) > 0.02


@pytest.mark.slow
def test_few_triangles_are_flipped(resting: Creature, bent: Creature) -> None:
    result = zo.match(resting.surface, bent.surface)
    assert flipped_share(result.surface_map, resting.surface, bent.surface) < 0.03


def test_each_end_of_a_bent_rod_has_its_own_rotation() -> None:
    rod = shape_of(ball(0.1, radii=(5, 1, 0.6), count=350), functions=80)
    vertices, normals = rod.mesh.vertices, rod.mesh.vertex_normals
    along, turn = vertices[:, 0] / vertices[:, 0].max(), Rotation.from_rotvec([0, 0.3, 0.9])
    images = np.where(along[:, None] > 0, turn.apply(vertices), vertices)
    found = align(rod.basis.coefficients(images), rod, WIDTH, False).normals
    expected = np.where(along[:, None] > 0, turn.apply(normals), normals)
    off = np.degrees(np.arccos(np.clip(np.einsum("nx,nx->n", found, expected), -1, 1)))
    # The joint blends over about the width of the rod.
    for far, most in ((0.4, 3.0), (0.6, 1.5)):
        assert np.median(off[np.abs(along) > far]) < most


def test_line_like_limb_takes_its_axial_rotation_from_the_body() -> None:
    small = analyse(creature(500, seed=1).surface.working.part(0)[0], 60, 250, 0)
    here = small.basis.smoothed(small.mesh.vertices, WIDTH**2)[small.search.samples[: len(small.distances)]]
    there, limbs = here.copy(), np.zeros(len(here), dtype=bool)
    for tip in ([1, 0.07, 0.35], [-1, 0.07, 0.35], [0.45, 0, -1], [-0.45, 0, -1]):
        axis = np.array(tip) / np.linalg.norm(tip)
        along = here @ axis
        there[along > 0.35] = along[along > 0.35, None] * axis
        limbs |= along > 0.35
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7])

    def off() -> float:
        turns = Rotation.from_matrix(_turns(here, turn.apply(there), small))
        return float((turns * turn.inv()).magnitude()[limbs].mean())

    with_neighbours = off()
    with retune(RIGID_ALIGNMENT, coherence=0.0):
        assert with_neighbours < 0.85 * off()
