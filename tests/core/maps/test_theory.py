# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of the papers on functional maps and ZoomOut, tested on a generated shape and a scanned person."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from creatures import Creature, true_vertex
from scipy.spatial import cKDTree

import zoomout_core as zo
from zoomout_core.spectral.laplacian import mesh_laplacian


class Shapes(NamedTuple):
    """Two poses of a body; `truth` is the source vertex of each target vertex."""

    source: zo.Surface
    basis_source: zo.SpectralBasis
    basis_target: zo.SpectralBasis
    truth: np.ndarray


@pytest.fixture(scope="module", params=["creature", "person"])
def shapes(request: pytest.FixtureRequest, resting: Creature, bent: Creature) -> Shapes:
    if request.param == "creature":
        source, target, truth = resting.surface, bent.surface, true_vertex(resting, bent)
    else:
        folder: Path = request.getfixturevalue("benchmark_data") / "faust_r"
        source, target = (zo.read_surface(folder / f"{name}.off") for name in ("tr_reg_000", "tr_reg_012"))
        with np.load(folder / "correspondence.npz") as file:
            known = cKDTree(target.vertices[file["tr_reg_012"]]).query(target.vertices)[1]
            truth = file["tr_reg_000"][known]
    return Shapes(source, zo.eigenbasis(source, 60), zo.eigenbasis(target, 60), truth)


def laplacian(surface: zo.Surface, functions: np.ndarray) -> np.ndarray:
    """(n, d) Laplacian of functions (n, d) at the vertices, at unit area."""
    stiffness, areas = mesh_laplacian(surface.working.vertices, surface.working.triangles)
    return (stiffness @ functions) / areas[:, None]


def test_only_isometries_have_diagonal_orthonormal_functional_maps(shapes: Shapes) -> None:
    """Nor do other maps commute with the Laplacian: a moved copy has all three properties, a stretched one has none."""
    random, source = np.random.default_rng(3), shapes.source
    order = random.permutation(len(source.vertices))
    place = np.argsort(order)
    rotation = np.linalg.qr(random.standard_normal((3, 3)))[0]
    functions = random.standard_normal((len(order), 3))

    def misses(vertices: np.ndarray) -> tuple[float, float, float]:
        """Deviation of C from orthonormal and from diagonal, and of the pull-back from commuting with the Laplacian."""
        copy = zo.Surface(vertices[order], place[source.triangles])
        C = zo.functional_map_of(order, shapes.basis_source, zo.eigenbasis(copy, 60))
        before, after = laplacian(source, functions)[order], laplacian(copy, functions[order])
        return (
            float(np.abs(C.T @ C - np.eye(60)).max()),
            float(np.abs(C - np.diag(C.diagonal())).max()),
            float(np.linalg.norm(before - after) / np.linalg.norm(before)),
        )

    assert max(misses(source.vertices @ rotation * 37 + [1, 2, 3])) < 1e-3
    assert min(misses(source.vertices * [1, 1, 2])) > 0.2


def test_zoomout_lowers_its_energy_in_every_step(shapes: Shapes) -> None:
    """The energy of each step's pointwise map is evaluated in all functions of the bases."""
    C = zo.functional_map_of(shapes.truth, shapes.basis_source, shapes.basis_target, 8, 8)
    vertex = zo.vertex_map_of(C, shapes.basis_source, shapes.basis_target)
    energy = []
    for k in (8, 16, 24, 32, 40):
        vertex = zo.zoomout(shapes.basis_source, shapes.basis_target, vertex, sizes=[k], samples=None).vertex
        energy.append(zo.orthonormality_error(zo.functional_map_of(vertex, shapes.basis_source, shapes.basis_target)))
    assert (np.diff(energy) < 0).all()
    assert energy[-1] < 0.5 * energy[0]


@pytest.mark.parametrize("samples", [None, 300])
def test_eigenvector_signs_do_not_change_pointwise_maps(shapes: Shapes, samples: int | None) -> None:
    random = np.random.default_rng(1)
    signs = random.choice([-1.0, 1.0], size=(2, 60))
    bases = shapes.basis_source, shapes.basis_target
    flipped = [
        zo.SpectralBasis(basis.eigenvalues, basis.eigenvectors * each, basis.areas, basis.points)
        for basis, each in zip(bases, signs, strict=True)
    ]
    wrong = random.random(len(shapes.truth)) < 0.3
    start = np.where(wrong, random.integers(len(shapes.source.vertices), size=len(wrong)), shapes.truth)
    one = zo.zoomout(*bases, start, k_final=60, samples=samples)
    two = zo.zoomout(*flipped, start, k_final=60, samples=samples)
    assert np.array_equal(one.vertex, two.vertex)
    np.testing.assert_allclose(one.functional_map * signs[0] * signs[1][:, None], two.functional_map, atol=1e-9)


@pytest.mark.slow(but=1)
def test_refining_both_ways_comes_closer_to_a_bijection(shapes: Shapes) -> None:
    bases = shapes.basis_source, shapes.basis_target
    C = zo.functional_map_of(shapes.truth, *bases, 10, 10)
    alone = zo.zoomout(*bases, C, k_final=60).vertex, zo.zoomout(*bases[::-1], C.T, k_final=60).vertex
    together = [refined.vertex for refined in zo.zoomout_both_ways(*bases, C, k_final=60)]

    def miss(there: np.ndarray, back: np.ndarray) -> float:
        """Mean distance of the source's vertices from their images after a round trip."""
        points = shapes.source.vertices
        return float(np.linalg.norm(points[there[back]] - points, axis=1).mean())

    assert miss(*together) < 0.7 * miss(*alone)
