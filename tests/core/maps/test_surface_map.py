# SPDX-License-Identifier: GPL-3.0-or-later
"""A map to points on triangles transfers values, inverts, extends to any point, and can be saved and loaded."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from creatures import Creature, creature

from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import SurfaceMap, read_vertex_map
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface


@pytest.fixture(scope="module")
def finer() -> Creature:
    """Another mesh of the resting creature in the same pose."""
    return creature(6000, seed=4)


@pytest.fixture(scope="module")
def onto(resting: Creature, finer: Creature) -> SurfaceMap:
    place = closest_points(finer.surface.vertices, resting.surface.vertices, resting.surface.triangles)
    return SurfaceMap(*place, resting.surface.triangles)


@pytest.mark.parametrize("shape", [(), (1,), (2,), (40,), (3, 3)])
def test_values_of_any_shape_are_mixed_by_barycentric_weights(resting, onto, shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(0).standard_normal((len(resting.surface.vertices), *shape))
    corners = values[onto.source_triangles[onto.triangle]]
    weights = onto.barycentric.reshape(*onto.barycentric.shape, *[1] * len(shape))
    np.testing.assert_allclose(onto.interpolate(values), (weights * corners).sum(axis=1), atol=1e-14)


def test_interpolation_does_not_gather_values_at_all_corners(resting, onto) -> None:
    values = np.ones((len(resting.surface.vertices), 100))
    tracemalloc.start()
    found = onto.interpolate(values)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1.5 * found.nbytes


def test_nearest_vertex_has_the_largest_weight(resting: Creature, onto: SurfaceMap) -> None:
    heaviest = onto.source_triangles[onto.triangle, onto.barycentric.argmax(axis=1)]
    assert np.array_equal(onto.vertex, heaviest)


def test_vertex_map_is_stored_exactly(resting: Creature) -> None:
    vertex = np.random.default_rng(0).integers(len(resting.surface.vertices), size=500)
    surface_map = SurfaceMap.from_vertices(vertex, resting.surface)
    assert np.array_equal(surface_map.vertex, vertex)
    np.testing.assert_array_equal(surface_map.interpolate(resting.surface.vertices), resting.surface.vertices[vertex])


def test_inverse_maps_back(resting: Creature, finer: Creature, onto: SurfaceMap) -> None:
    back = onto.invert(resting.surface, finer.surface)
    returned = back.interpolate(onto.interpolate(resting.surface.vertices))
    assert np.linalg.norm(returned - resting.surface.vertices, axis=1).max() < 0.12


def test_points_inside_faces_map_between_the_images_of_corners(resting, finer, onto) -> None:
    random = np.random.default_rng(0)
    triangle = random.integers(len(finer.surface.triangles), size=3000)
    barycentric = random.dirichlet([1, 1, 1], 3000)
    inside = onto.at(resting.surface, finer.surface, triangle, barycentric)
    expected = np.einsum("qc,qcx->qx", barycentric, finer.surface.vertices[finer.surface.triangles[triangle]])
    assert np.linalg.norm(inside.interpolate(resting.surface.vertices) - expected, axis=1).max() < 0.12


def test_map_survives_saving_and_loading(tmp_path: Path, resting: Creature, onto: SurfaceMap) -> None:
    onto.save(tmp_path / "map.npz", confidence=np.ones(len(onto.triangle)))
    with np.load(tmp_path / "map.npz") as file:
        assert set(file.files) == {"triangle", "barycentric", "vertex", "confidence"}
    again = SurfaceMap.load(tmp_path / "map.npz", resting.surface)
    for name in ("triangle", "barycentric", "source_triangles"):
        assert np.array_equal(getattr(again, name), getattr(onto, name))


@pytest.mark.parametrize(("saved", "loaded"), [("map", "map"), ("map", "map.npz"), ("map.npz", "map")])
def test_suffix_is_optional_when_saving_and_loading(tmp_path, resting, onto, saved: str, loaded: str) -> None:
    onto.save(tmp_path / saved)
    assert np.array_equal(SurfaceMap.load(tmp_path / loaded, resting.surface).triangle, onto.triangle)


def refusal_of(path: Path, source: Surface) -> str:
    with pytest.raises(MeshError) as refusal:
        SurfaceMap.load(path, source)
    message = str(refusal.value)
    assert path.name in message
    assert "\n" not in message
    assert "pickle" not in message
    return message


def test_missing_or_mismatched_files_are_refused(tmp_path: Path, resting: Creature, onto: SurfaceMap) -> None:
    onto.save(tmp_path / "map.npz")
    small = Surface(resting.surface.vertices, resting.surface.triangles[:50])
    assert "another source" in refusal_of(tmp_path / "map.npz", small)
    np.savez(tmp_path / "other.npz", something=1)
    assert "barycentric and triangle" in refusal_of(tmp_path / "other.npz", resting.surface)
    assert "no file" in refusal_of(tmp_path / "missing.npz", resting.surface)


@pytest.mark.parametrize("content", [b"", b"junk", b"PK\x03\x04 junk", b"\x93NUMPY junk", b"\x80\x04junk"])
def test_files_of_other_formats_are_refused(tmp_path: Path, resting: Creature, content: bytes) -> None:
    (tmp_path / "junk.npz").write_bytes(content)
    assert "not an .npz file" in refusal_of(tmp_path / "junk.npz", resting.surface)


def test_object_arrays_and_truncated_files_are_refused(tmp_path, resting: Creature, onto: SurfaceMap) -> None:
    np.savez(tmp_path / "objects.npz", triangle=np.array([None]), barycentric=np.array([None]))
    onto.save(tmp_path / "whole.npz")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "whole.npz").read_bytes()[:5000])
    np.save(tmp_path / "array.npy", np.zeros(3))
    for name in ("objects.npz", "cut.npz", "array.npy"):
        assert "contains no map" in refusal_of(tmp_path / name, resting.surface)


@pytest.mark.parametrize(
    ("name", "change", "sentence"),
    [
        ("triangle", lambda array: array - 1, "triangle -1"),
        ("triangle", lambda array: array[:-1], "do not fit together"),
        ("triangle", lambda array: array[:, None], "do not fit together"),
        ("triangle", lambda array: array * 1.0, "type float64"),
        ("barycentric", lambda array: array[:, :2], "do not fit together"),
        ("barycentric", lambda array: array * np.nan, "sum to one"),
        ("barycentric", lambda array: array * 2, "sum to one"),
        ("barycentric", lambda array: array * [3, 3, -3] + [-1, -1, 3], "sum to one"),
        ("barycentric", lambda array: array > 0, "bool"),
    ],
)
def test_maps_with_invalid_values_are_refused(tmp_path, resting, onto, name, change, sentence) -> None:
    arrays = {"triangle": onto.triangle - onto.triangle.min(), "barycentric": onto.barycentric}
    np.savez(tmp_path / "map.npz", **arrays | {name: change(arrays[name])})
    assert sentence in refusal_of(tmp_path / "map.npz", resting.surface)


@pytest.mark.parametrize("vertex", [[4000], [-1], [0.5], [np.nan], [[0]], [True], ["a"]])
def test_vertex_maps_to_invalid_vertices_are_refused(resting: Creature, vertex: list[object]) -> None:
    with pytest.raises(ValueError, match="Images on the source must be"):
        SurfaceMap.from_vertices(np.array(vertex), resting.surface)


def test_vertex_map_to_a_vertex_without_faces_is_refused(resting: Creature) -> None:
    partial = Surface(resting.surface.vertices, resting.surface.triangles[:50])
    unused = np.setdiff1d(np.arange(len(partial.vertices)), partial.triangles)[0]
    with pytest.raises(MeshError, match=f"vertex {unused} of the source, which belongs to no face"):
        SurfaceMap.from_vertices([unused], partial)


def test_vertex_map_is_read_without_surfaces(tmp_path, onto) -> None:
    onto.save(tmp_path / "map.npz")
    np.testing.assert_array_equal(read_vertex_map(tmp_path / "map.npz"), onto.vertex)
    (tmp_path / "empty.npz").touch()
    np.savez(tmp_path / "other.npz", triangle=onto.triangle)
    for name, sentence in (("empty", "contains no map"), ("other", "contains no map"), ("missing", "There is no file")):
        with pytest.raises(MeshError, match=sentence):
            read_vertex_map(tmp_path / f"{name}.npz")
