"""A map to points on triangles carries values, inverts, extends to any point, and survives a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from creatures import Creature, creature, true_vertex

from zoomout_core.correspondence.surface_map import SurfaceMap
from zoomout_core.projection import closest_points
from zoomout_core.surface import MeshError, Surface


@pytest.fixture(scope="module")
def finer() -> Creature:
    """The resting creature, meshed anew in the same pose."""
    return creature(6000, seed=4)


@pytest.fixture(scope="module")
def onto(resting: Creature, finer: Creature) -> SurfaceMap:
    place = closest_points(finer.surface.vertices, resting.surface.vertices, resting.surface.triangles)
    return SurfaceMap(*place, resting.surface.triangles)


def test_positions_and_linear_functions_are_carried_exactly(
    resting: Creature, onto: SurfaceMap, finer: Creature
) -> None:
    images = onto.interpolate(resting.surface.vertices)
    assert np.linalg.norm(images - finer.surface.vertices, axis=1).max() < 0.12
    linear = resting.surface.vertices @ [1.0, -2, 3]
    np.testing.assert_allclose(onto.interpolate(linear), images @ [1, -2, 3], atol=1e-12)


def test_the_nearest_vertex_is_the_one_that_weighs_most(resting: Creature, onto: SurfaceMap) -> None:
    heaviest = onto.source_triangles[onto.triangle, onto.barycentric.argmax(axis=1)]
    assert np.array_equal(onto.vertex, heaviest)


def test_a_vertex_map_is_kept_to_the_vertex(resting: Creature) -> None:
    vertex = np.random.default_rng(0).integers(len(resting.surface.vertices), size=500)
    surface_map = SurfaceMap.from_vertices(vertex, resting.surface)
    assert np.array_equal(surface_map.vertex, vertex)
    np.testing.assert_array_equal(surface_map.interpolate(resting.surface.vertices), resting.surface.vertices[vertex])


def test_inverting_leads_back(resting: Creature, finer: Creature, onto: SurfaceMap) -> None:
    back = onto.invert(resting.surface, finer.surface)
    returned = back.interpolate(onto.interpolate(resting.surface.vertices))
    assert np.linalg.norm(returned - resting.surface.vertices, axis=1).max() < 0.12


def test_points_inside_faces_lie_between_the_images_of_their_corners(resting, finer, onto) -> None:
    random = np.random.default_rng(0)
    triangle = random.integers(len(finer.surface.triangles), size=3000)
    barycentric = random.dirichlet([1, 1, 1], 3000)
    inside = onto.at(resting.surface, finer.surface, triangle, barycentric)
    expected = np.einsum("qc,qcx->qx", barycentric, finer.surface.vertices[finer.surface.triangles[triangle]])
    assert np.linalg.norm(inside.interpolate(resting.surface.vertices) - expected, axis=1).max() < 0.12


def test_a_map_survives_a_file(tmp_path: Path, resting: Creature, onto: SurfaceMap) -> None:
    onto.save(tmp_path / "map.npz", confidence=np.ones(len(onto.triangle)))
    with np.load(tmp_path / "map.npz") as file:
        assert set(file.files) == {"triangle", "barycentric", "vertex", "confidence"}
    again = SurfaceMap.load(tmp_path / "map.npz", resting.surface)
    for name in ("triangle", "barycentric", "source_triangles"):
        assert np.array_equal(getattr(again, name), getattr(onto, name))


def test_a_file_that_does_not_fit_is_refused(tmp_path: Path, resting: Creature, onto: SurfaceMap) -> None:
    onto.save(tmp_path / "map.npz")
    small = Surface(resting.surface.vertices, resting.surface.triangles[:50])
    with pytest.raises(MeshError, match="another source"):
        SurfaceMap.load(tmp_path / "map.npz", small)
    np.savez(tmp_path / "other.npz", something=1)
    with pytest.raises(MeshError, match="no surface map"):
        SurfaceMap.load(tmp_path / "other.npz", resting.surface)


@pytest.mark.parametrize("vertex", [[4000], [-1]])
def test_a_vertex_map_to_nowhere_is_refused(resting: Creature, vertex: list[int]) -> None:
    with pytest.raises(MeshError, match="do not exist"):
        SurfaceMap.from_vertices(np.array(vertex), resting.surface)


def test_the_true_map_of_another_pose_is_accepted(resting: Creature, bent: Creature) -> None:
    surface_map = SurfaceMap.from_vertices(true_vertex(resting, bent), resting.surface)
    assert len(surface_map.triangle) == len(bent.surface.vertices)
