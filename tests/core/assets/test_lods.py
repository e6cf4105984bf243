# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail have the data of the mesh itself, and move like it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from creatures import creature
from scipy.sparse import csr_array
from scipy.spatial import ConvexHull
from skinned_tubes import LENGTH, write_tube

import zoomout_core as zo
from zoomout_core.assets.asset import MATERIALS, NORMALS, SHAPE_KEYS, Asset, Skin, at_rest
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.fit_level import LEVEL_FIT
from zoomout_core.assets.given_levels import complete_levels
from zoomout_core.assets.level import Level, errors_of_level
from zoomout_core.assets.lods import make_lods, with_fewer_weights
from zoomout_core.assets.stored_map import digest_of
from zoomout_core.assets.update_asset import update_asset
from zoomout_core.cli import main
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.mirror_pairs import mirror_pairs
from zoomout_core.mesh.simplification.collapsing_mesh import KEPT_TRIANGLES
from zoomout_core.mesh.simplification.quadrics import SIMPLIFICATION
from zoomout_core.mesh.triangles import area_normals, unit_vectors, vertex_normals
from zoomout_core.samples import character
from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.tuning import Tuning, retune

# Vertices of the sample character, and its levels.
COUNT, RATIOS = 2500, (0.6, 0.4)


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(main, list(map(str, arguments)))
    return result.exit_code, result.stdout + (result.stderr if result.exit_code else "")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sample character, `character.glb`, and its levels in `levels`."""
    path = tmp_path_factory.mktemp("lods")
    write_asset(character(COUNT), path / "character.glb")
    options = "-o", path / "levels", "--ratios", ",".join(map(str, RATIOS)), "--max-weights", 2, "--keep-map", "--json"
    code, said = run("lods", path / "character.glb", *options)
    assert code == 0, said
    (path / "report.json").write_text(said[: said.rindex("}") + 1])
    return path


@pytest.fixture(scope="module")
def coarse(folder: Path) -> tuple[Asset, Level]:
    """The last level, which is small enough to be fast, and a level made from it."""
    source = read_asset(folder / "levels" / "character_LOD2.glb")
    return source, make_lods(source, [0.4])[0]


def test_levels_have_all_data_and_the_requested_vertex_counts(folder: Path) -> None:
    source = read_asset(folder / "character.glb")
    for number, ratio in enumerate((1.0, *RATIOS)):
        level = read_asset(folder / "levels" / f"character_LOD{number}.glb")
        assert {each.name for each in level.attributes} == {each.name for each in source.attributes}
        assert level.skin is not None
        assert source.skin is not None
        assert level.skin.names == source.skin.names
        assert [each.name for each in level.materials] == [each.name for each in source.materials]
        assert abs(len(level.surface.working.vertices) / len(source.surface.working.vertices) - ratio) < 0.02
        assert np.diff(level.skin.weights.indptr).max() <= 2
        assert level.document is not None
        assert all(each.name.endswith(f"_LOD{number}") for each in level.document.gltf.meshes)


def test_levels_move_like_the_mesh(folder: Path) -> None:
    first, *levels = json.loads((folder / "report.json").read_text())["levels"]
    assert "rest_error" not in first
    for level in levels:
        assert 0 < level["rest_error"] < 0.002
        assert level["posed_error"] < 1.2 * level["posed_geometry_error"]


@pytest.mark.parametrize(
    ("stage", "change", "factor"),
    [
        (SIMPLIFICATION, {"poses": 0.0}, 1.05),
        (LEVEL_FIT, {"rounds": 0}, 1.3),
        (LEVEL_FIT, {"poses": 0.0}, 1.005),
        (LEVEL_FIT, {"slip": 100.0}, 1.05),
        (LEVEL_FIT, {"weights": 1e9}, 1.01),
    ],
    ids=["simplified at rest only", "not fitted", "fitted at rest only", "moved along normals only", "same weights"],
)
def test_each_part_reduces_the_error_in_poses(
    coarse: tuple[Asset, Level], stage: Tuning, change: dict, factor: float
) -> None:
    source, level = coarse
    with retune(stage, **change):
        assert make_lods(source, [0.4])[0].posed_error > factor * level.posed_error


def test_joints_whose_fitted_weights_vanish_are_left_out(coarse: tuple[Asset, Level]) -> None:
    _, level = coarse
    assert level.asset.skin is not None
    assert level.asset.skin.weights.data.min() > 0


def test_textures_do_not_slip(folder: Path) -> None:
    source = at_rest(read_asset(folder / "levels" / "character_LOD2.glb"))

    def slip() -> float:
        """Median distance of a level's texture coordinates from those of the asset at the same place."""
        level = make_lods(source, [0.4])[0].asset
        surfaces = [each.surface for each in (source, level)]
        charts = [each.find("uv 0").values[each.surface.triangle_corners] for each in (source, level)]
        middle = surfaces[0].vertices[surfaces[0].triangles].mean(axis=1)
        triangle, barycentric = closest_points(middle, surfaces[1].vertices, surfaces[1].triangles)
        found = np.einsum("nk,nkx->nx", barycentric, charts[1][triangle])
        return float(np.median(np.linalg.norm(found - charts[0].mean(axis=1), axis=1)))

    own = slip()
    with retune(LEVEL_FIT, slip=0.0):
        assert slip() > 1.5 * own


def test_seams_and_material_borders_stay_on_those_of_the_mesh(coarse: tuple[Asset, Level]) -> None:
    source, made = coarse
    corners = [
        {tuple(row) for row in np.column_stack([vertex, uv])}
        for vertex, uv in (
            (source.surface.corner_vertex, source.find("uv 0").values),
            (vertices_of(made)[made.asset.surface.corner_vertex], made.asset.find("uv 0").values),
        )
    ]
    assert corners[1] <= corners[0]
    seams = [repeated_vertices(rows) for rows in corners]
    assert seams[1] <= seams[0]
    assert len(seams[1]) > 20
    borders = [
        repeated_vertices(set(zip(vertex, np.repeat(asset.find("materials").values, 3), strict=True)))
        for asset, vertex in (
            (source, source.surface.corner_vertex),
            (made.asset, vertices_of(made)[made.asset.surface.corner_vertex]),
        )
    ]
    assert borders[1] <= borders[0]
    assert len(borders[1]) > 10


def vertices_of(level: Level) -> np.ndarray:
    """(n,) the vertex of the asset that each vertex of a level is."""
    found = level.match.surface_map
    at = found.barycentric.argmax(axis=1)
    return np.asarray(found.source_triangles[found.triangle, at])


def repeated_vertices(rows: set[tuple]) -> set[int]:
    """The vertices, first in each row, that occur in more than one row."""
    vertex, count = np.unique([row[0] for row in rows], return_counts=True)
    return set(vertex[count > 1].tolist())


def test_symmetric_meshes_stay_symmetric() -> None:
    half = creature(1500).surface.vertices * [1, 0.5, 0.7]
    points = half[half[:, 0] > 0.02]
    plane = np.column_stack([np.zeros(60), np.random.default_rng(0).normal(size=(60, 2))])
    directions = np.concatenate([points, points * [-1, 1, 1], plane])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    stretched = directions * [1.0, 0.6, 0.8] * (1 + 0.3 * directions[:, 1:2] ** 2)
    surface = zo.Surface(stretched, ConvexHull(directions).simplices)
    level = make_lods(Asset(surface), [0.3])[0].asset.surface
    pairs = mirror_pairs(level.vertices)
    assert pairs is not None
    assert (pairs >= 0).mean() > 0.95


def test_levels_keep_their_objects_and_nodes(tmp_path: Path) -> None:
    write_tube(tmp_path / "tube.glb")
    source = read_asset(tmp_path / "tube.glb")
    made = make_lods(source, [0.4])[0].asset
    assert [name for name, _ in made.objects] == [name for name, _ in source.objects]
    assert made.nodes == source.nodes
    write_asset(made, tmp_path / "level.glb")
    assert read_asset(tmp_path / "level.glb").nodes == source.nodes


def test_levels_can_be_updated(folder: Path, tmp_path: Path) -> None:
    level = read_asset(folder / "levels" / "character_LOD2.glb")
    source = read_asset(folder / "character.glb")
    assert level.stored_map is not None
    assert level.skin is not None
    assert source.skin is not None
    places = level.stored_map.on(source.surface).surface_map.interpolate(source.skin.rest)
    assert np.linalg.norm(places - level.skin.rest, axis=1).max() < 0.02 * np.ptp(source.skin.rest, axis=0).max()


def test_level_takes_no_data_from_a_nearby_layer() -> None:
    """A shell just outside another one, whose vertices have the other colour."""
    inner = creature(2000).surface
    normals = inner.vertices / np.linalg.norm(inner.vertices, axis=1)[:, None]
    outer = inner.vertices + 0.004 * normals * np.ptp(inner.vertices, axis=0).max()
    count = len(inner.vertices)
    both = zo.Surface(
        np.concatenate([inner.vertices, outer]), np.concatenate([inner.triangles, inner.triangles + count])
    )
    colors = np.repeat([[1.0, 0, 0, 1], [0, 0, 1.0, 1]], count, axis=0)
    asset = Asset(both, (Attribute("color 0", Domain.POINT, Kind.COLOR, colors),))
    (level,) = make_lods(asset, [0.25])
    color = level.asset.find("color 0")
    assert color is not None
    red = np.round(color.values[:, 0], 6)
    assert set(red) == {0.0, 1.0}
    triangles = level.asset.surface.triangles
    assert (red[triangles] == red[triangles][:, :1]).all()


def test_normals_agree_with_their_triangles() -> None:
    surface = creature(2000, bend=0.5).surface
    flat = unit_vectors(area_normals(surface.vertices, surface.triangles))
    normals = Attribute(NORMALS, Domain.CORNER, Kind.NORMAL, np.repeat(flat, 3, axis=0))
    (level,) = make_lods(Asset(surface, (normals,)), [0.05])
    made, found = level.asset.surface, level.asset.find(NORMALS)
    assert found is not None
    faces = unit_vectors(area_normals(made.vertices, made.triangles))
    cosine = np.einsum("mcx,mx->mc", np.asarray(found.values)[made.triangle_corners], faces)
    assert cosine.min() > 0.2


def test_nearby_parts_are_fitted_independently() -> None:
    inner = creature(2000).surface
    extent, count = np.ptp(inner.vertices, axis=0).max(), len(inner.vertices)
    outer = inner.vertices + 0.002 * extent * inner.vertices / np.linalg.norm(inner.vertices, axis=1)[:, None]
    both = zo.Surface(
        np.concatenate([inner.vertices, outer]), np.concatenate([inner.triangles, inner.triangles + count])
    )
    (alone,) = make_lods(Asset(inner), [0.1])
    (level,) = make_lods(Asset(both), [0.1])
    vertices, triangles = level.asset.surface.vertices, level.asset.surface.triangles
    triangles = triangles[vertices_of(level)[triangles[:, 0]] < count]
    triangle, barycentric = closest_points(inner.vertices, vertices, triangles)
    nearest = np.einsum("nk,nkx->nx", barycentric, vertices[triangles[triangle]])
    assert np.linalg.norm(inner.vertices - nearest, axis=1).mean() / extent < 1.1 * alone.rest_error


@pytest.mark.parametrize("bend", [0.0, 0.7])
def test_shape_keys_are_kept_and_posed_files_are_taken_to_rest(tmp_path: Path, bend: float) -> None:
    write_tube(tmp_path / "tube.glb", bend=bend)
    source = read_asset(tmp_path / "tube.glb")
    (made,) = make_lods(source, [0.6])
    write_asset(made.asset, tmp_path / "level.glb")
    level = read_asset(tmp_path / "level.glb")
    assert level.skin is not None
    assert source.skin is not None
    assert np.abs(level.skin.rest.max(axis=0) - source.skin.rest.max(axis=0)).max() < 0.05
    keys = level.find(SHAPE_KEYS)
    assert keys is not None
    expected = np.clip(level.skin.rest[:, 1] / LENGTH, 0, 1)
    moved = np.einsum("nxy,ny->nx", level.skin.linear, np.asarray(keys.values)[:, 0])
    assert np.abs(moved[:, 0] - expected).mean() < 0.03
    assert np.abs(moved[:, 1:]).mean() < 0.03


@pytest.mark.parametrize("way", ["simplified", "made by hand"])
def test_levels_of_posed_files_are_the_same_in_memory_and_in_files(tmp_path: Path, way: str) -> None:
    """Their weights are fitted, so that the joints move a vertex otherwise than the vertex of the file."""
    write_tube(tmp_path / "tube.glb", bend=0.7)
    source = with_normals(read_asset(tmp_path / "tube.glb"))
    (level,) = make_lods(source, [0.4])
    if way == "made by hand":
        level = complete_levels(source, {"level": Asset(at_rest(level.asset).surface)})["level"]
    write_asset(level.asset, tmp_path / "level.glb")
    found = read_asset(tmp_path / "level.glb")
    np.testing.assert_array_equal(found.surface.triangles, level.asset.surface.triangles)
    np.testing.assert_allclose(found.surface.vertices, level.asset.surface.vertices, atol=1e-5)
    for name in (SHAPE_KEYS, NORMALS):
        written, read = (np.asarray(each.find(name).values) for each in (level.asset, found))
        np.testing.assert_allclose(read, written, atol=1e-5)


def with_normals(asset: Asset) -> Asset:
    normals = vertex_normals(asset.surface.vertices, asset.surface.triangles)[asset.surface.corner_vertex]
    return replace(asset, attributes=(*asset.attributes, Attribute(NORMALS, Domain.CORNER, Kind.NORMAL, normals)))


def test_fewer_weights_keep_the_largest_and_their_sum() -> None:
    surface = creature(300).surface
    random = np.random.default_rng(0)
    weights = random.random((len(surface.vertices), 5))
    weights /= weights.sum(axis=1, keepdims=True)
    bones = np.tile(np.eye(4), (5, 1, 1))
    skin = skin_of(csr_array(weights), bones, surface)
    limited = with_fewer_weights(Asset(surface, skin=skin), 3).skin
    assert limited is not None
    assert np.diff(limited.weights.indptr).max() <= 3
    np.testing.assert_allclose(limited.weights.sum(axis=1), 1)
    np.testing.assert_array_equal(skin.weights.toarray(), weights)


def skin_of(weights: csr_array, bones: np.ndarray, surface: zo.Surface) -> Skin:
    count = len(bones)
    linear = np.tile(np.eye(3), (len(surface.vertices), 1, 1))
    names = tuple(f"bone {number}" for number in range(count))
    return Skin(np.arange(count), names, np.arange(count) - 1, bones, bones, surface.vertices, linear, weights)


@pytest.fixture(scope="module")
def hand_made(folder: Path) -> list[Path]:
    """Bare meshes in the place of `character_LOD1.glb` of the fixture's levels, the coarser one first.

    Their texture coordinates are one more than those of the character.
    """
    source = read_asset(folder / "levels" / "character_LOD1.glb")
    paths = [folder / f"hand made {number}.glb" for number in range(2)]
    for path, level in zip(paths, make_lods(source, [0.15, 0.3]), strict=True):
        uv = level.asset.find("uv 0")
        assert uv is not None
        write_asset(Asset(level.asset.surface, (replace(uv, values=np.asarray(uv.values) + 1),)), path)
    return paths


def test_given_meshes_become_levels_by_their_triangle_counts(
    folder: Path, hand_made: list[Path], tmp_path: Path
) -> None:
    given = [part for path in hand_made for part in ("--level", path)]
    options = "-o", tmp_path, "--max-weights", 2, "--keep-map", "--json"
    code, said = run("lods", folder / "levels" / "character_LOD1.glb", *given, *options)
    assert code == 0, said
    first, *rows = json.loads(said[: said.rindex("}") + 1])["levels"]
    assert "made_from" not in first
    assert [row["made_from"] for row in rows] == [str(path) for path in reversed(hand_made)]
    source = read_asset(folder / "levels" / "character_LOD1.glb")
    for number, (path, row) in enumerate(zip(reversed(hand_made), rows, strict=True), start=1):
        bare, level = read_asset(path), read_asset(tmp_path / f"character_LOD1_LOD{number}.glb")
        assert 0 < row["posed_error"] < 1.2 * row["rest_error"]
        assert level.skin is not None
        assert np.diff(level.skin.weights.indptr).max() <= 2
        places = [np.unique(np.round(each, 4), axis=0) for each in (level.skin.rest, bare.surface.vertices)]
        np.testing.assert_allclose(*places, atol=2e-4)
        assert len(level.surface.triangles) == len(bare.surface.triangles)
        assert {each.name for each in level.attributes} == {each.name for each in source.attributes}
        assert [each.name for each in level.materials] == [each.name for each in source.materials]
        assert np.asarray(level.find("uv 0").values)[:, 1].max() < 1.05
        assert level.document is not None
        assert all(each.name.endswith(f"_LOD{number}") for each in level.document.gltf.meshes)
        assert level.stored_map is not None
        assert level.stored_map.source == digest_of(source.surface)


def test_given_meshes_may_keep_their_uvs(coarse: tuple[Asset, Level]) -> None:
    source, made = coarse
    uv = made.asset.find("uv 0")
    shifted = replace(uv, values=np.asarray(uv.values) + 1)
    more = replace(shifted, name="uv 1")
    bare = at_rest(made.asset).surface
    given = {"own": Asset(bare, (shifted, more)), "without": Asset(bare)}
    levels = complete_levels(source, given, keep_uv=True)
    np.testing.assert_array_equal(levels["own"].asset.find("uv 0").values, shifted.values)
    assert any("1 of its UV maps" in note for note in levels["own"].notes)
    found = levels["without"].asset.find("uv 0").values
    assert np.quantile(np.abs(found - uv.values), 0.95) < 0.05


def test_weights_of_given_meshes_are_fitted(coarse: tuple[Asset, Level]) -> None:
    source, made = coarse
    given = {"level": Asset(at_rest(made.asset).surface)}
    level = complete_levels(source, given)["level"]
    assert level.posed_error < 1.05 * made.posed_error
    with retune(LEVEL_FIT, weights=1e9):
        assert complete_levels(source, given)["level"].posed_error > 1.01 * level.posed_error


def test_unused_vertices_of_given_meshes_need_no_place(coarse: tuple[Asset, Level]) -> None:
    source, made = coarse
    bare = at_rest(made.asset).surface
    given = Asset(zo.Surface(np.vstack([bare.vertices, [[np.nan] * 3]]), bare.triangles))
    level = complete_levels(source, {"level": given})["level"]
    assert level.posed_error < 1.05 * made.posed_error


@pytest.mark.parametrize("bend", [0.0, 0.7])
def test_given_meshes_receive_shape_keys_and_the_pose_of_the_file(tmp_path: Path, bend: float) -> None:
    write_tube(tmp_path / "tube.glb", bend=bend)
    source = read_asset(tmp_path / "tube.glb")
    (made,) = make_lods(source, [0.6])
    level = complete_levels(source, {"level": Asset(at_rest(made.asset).surface)})["level"].asset
    write_asset(level, tmp_path / "level.glb")
    found = read_asset(tmp_path / "level.glb")
    np.testing.assert_allclose(found.surface.vertices, level.surface.vertices, atol=1e-4)
    expected = np.clip(found.skin.rest[:, 1] / LENGTH, 0, 1)
    moved = np.einsum("nxy,ny->nx", found.skin.linear, np.asarray(found.find(SHAPE_KEYS).values)[:, 0])
    assert np.abs(moved[:, 0] - expected).mean() < 0.03
    assert np.abs(moved[:, 1:]).mean() < 0.03


def test_given_meshes_take_data_of_their_side_of_a_thin_sheet() -> None:
    """A sheet with two sides of other colours, thinner than a given mesh is displaced."""
    sheet = creature(2000).surface.vertices * [1, 1, 0.004]
    surface = zo.Surface(sheet, creature(2000).surface.triangles)
    up = area_normals(surface.vertices, surface.triangles)[:, 2] > 0
    side = Attribute("materials", Domain.FACE, Kind.LABEL, up.astype(int))
    moved = Asset(surface.with_vertices(surface.vertices + np.array([0, 0, 0.006])))
    found = complete_levels(Asset(surface, (side,)), {"sheet": moved})["sheet"].asset.find("materials")
    assert (np.asarray(found.values) == up).mean() > 0.95


def test_given_meshes_may_have_spikes_but_no_limb_elsewhere() -> None:
    """Blender's Decimate tears meshes whose edges are split at hard normals and UV seams."""
    body = creature(2000).surface
    extent = np.ptp(body.vertices, axis=0).max()
    normals = vertex_normals(body.vertices, body.triangles)[body.triangles]
    corners = body.vertices[body.triangles]
    corners[::3, 0] += 0.06 * extent * normals[::3, 0]
    torn = Asset(zo.Surface(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3)))
    level = complete_levels(Asset(body), {"torn": torn})["torn"].asset
    np.testing.assert_array_equal(level.surface.vertices, torn.surface.vertices)
    tip = body.vertices[:, 0] > np.quantile(body.vertices[:, 0], 0.95)
    moved = Asset(body.with_vertices(body.vertices + 0.2 * extent * tip[:, None] * [1.0, 0, 0]))
    with pytest.raises(zo.MeshError, match="is not in the place and rest pose"):
        complete_levels(Asset(body), {"moved": moved})


def test_layers_of_given_meshes_take_data_of_their_layers() -> None:
    """A fifth of the vertices of the outer one of two layers are closer to the inner one, as in coarse meshes."""
    inner = creature(2000).surface
    extent, count = np.ptp(inner.vertices, axis=0).max(), len(inner.vertices)
    normals = vertex_normals(inner.vertices, inner.triangles)
    layers = [inner.vertices + offset * extent * normals for offset in (0, 0.004, 0.0015)]
    triangles = np.concatenate([inner.triangles, inner.triangles + count])
    colors = np.repeat([[1.0, 0, 0, 1], [0, 0, 1.0, 1]], count, axis=0)
    asset = Asset(
        zo.Surface(np.concatenate(layers[:2]), triangles), (Attribute("color 0", Domain.POINT, Kind.COLOR, colors),)
    )
    noise = np.random.default_rng(0).uniform(0, 0.0025, count)[:, None] * extent * normals
    given = zo.Surface(np.concatenate([layers[0], layers[2] + noise]), triangles)
    color = complete_levels(asset, {"level": Asset(given)})["level"].asset.find("color 0")
    np.testing.assert_allclose(color.values, colors, atol=1e-6)


def test_small_parts_that_a_given_mesh_joins_to_a_large_one_keep_their_data() -> None:
    body = creature(2000).surface
    extent, count = np.ptp(body.vertices, axis=0).max(), len(body.vertices)
    hat = 0.1 * creature(200).surface.vertices + [0, 0, 0.6 * extent]
    triangles = np.concatenate([body.triangles, creature(200).surface.triangles + count])
    vertices = np.concatenate([body.vertices, hat])
    colors = np.repeat([[1.0, 0, 0, 1], [0, 0, 1.0, 1]], [count, len(hat)], axis=0)
    asset = Asset(zo.Surface(vertices, triangles), (Attribute("color 0", Domain.POINT, Kind.COLOR, colors),))
    bridge = [[int(body.vertices[:, 2].argmax()), count, count + 1]]
    given = Asset(zo.Surface(vertices, np.concatenate([triangles, bridge])))
    color = complete_levels(asset, {"level": given})["level"].asset.find("color 0")
    np.testing.assert_allclose(color.values, colors, atol=1e-6)


def test_updates_fit_weights_of_levels_where_they_change(folder: Path) -> None:
    old = read_asset(folder / "character.glb")
    assert old.skin is not None
    weights = old.skin.weights.toarray()
    weights[:, :3] @= [[0.6, 0.4, 0], [0.4, 0.6, 0], [0.5, 0, 0.5]]
    new = replace(old, skin=replace(old.skin, weights=csr_array(weights)))
    level = read_asset(folder / "levels" / "character_LOD2.glb")
    stored = level.stored_map
    assert stored is not None
    assert stored.fitted
    assert level.skin is not None
    plain = replace(level, stored_map=replace(stored, fitted=False))
    found = [update_asset(old, new, each).asset for each in (level, plain)]
    own = level.skin.weights.toarray()
    fitted, transferred = (each.skin.weights.toarray() for each in found)
    np.testing.assert_allclose(fitted.sum(axis=1), 1, atol=1e-6)
    stays = (transferred == own).all(axis=1)
    assert 0.2 < stays.mean() < 0.9
    np.testing.assert_array_equal(fitted[stays], own[stays])
    there = stored.on(old.surface).surface_map
    errors = [errors_of_level(at_rest(new), at_rest(each), there)[1] for each in found]
    assert errors[0] is not None
    assert errors[1] is not None
    assert errors[0] < 0.99 * errors[1]


def with_materials(asset: Asset, materials: np.ndarray) -> Asset:
    others = tuple(each for each in asset.attributes if each.name != MATERIALS)
    return replace(asset, attributes=(*others, Attribute(MATERIALS, Domain.FACE, Kind.LABEL, materials)))


def test_small_regions_of_materials_such_as_eyes_do_not_vanish() -> None:
    surface = creature(2500).surface
    center = surface.vertices[surface.triangles].mean(axis=1)
    eyes = center[np.argsort(-center[:, 2])[:200]]
    eyes = eyes[[eyes[:, 0].argmin(), eyes[:, 0].argmax()]]
    materials = np.zeros(len(center), dtype=int)
    for eye in eyes:
        materials[np.argsort(np.linalg.norm(center - eye, axis=1))[:4]] = 1
    for level in make_lods(with_materials(Asset(surface), materials), [0.3, 0.06]):
        made, numbers = level.asset.surface, level.asset.find(MATERIALS)
        assert numbers is not None
        center = made.vertices[made.triangles].mean(axis=1)[np.asarray(numbers.values) == 1]
        nearest = np.linalg.norm(center[:, None] - eyes, axis=2).argmin(axis=1)
        assert (np.bincount(nearest, minlength=2) >= KEPT_TRIANGLES).all()


def test_borders_of_materials_stay_although_seams_of_charts_are_ignored() -> None:
    surface = creature(2500).surface
    center = surface.vertices[surface.triangles].mean(axis=1)
    chart = np.repeat(np.arange(len(center))[:, None], 3, axis=0)  # seams everywhere
    uv = Attribute("uv 0", Domain.CORNER, Kind.UV, surface.vertices[surface.corner_vertex][:, :2] + 10.0 * chart)
    upper = (center[:, 2] > np.median(center[:, 2])).astype(int)
    source = with_materials(Asset(surface, (uv,)), upper)
    level = make_lods(source, [0.2])[0]
    assert len(level.asset.surface.vertices) < 0.22 * len(surface.vertices)
    used = level.match.surface_map.interpolate(np.arange(len(surface.vertices))[:, None].astype(float))
    original = np.round(used[:, 0]).astype(int)
    ends = [np.unique(surface.triangles[upper == side]) for side in (0, 1)]
    numbers = level.asset.find(MATERIALS)
    assert numbers is not None
    for side in (0, 1):
        own = original[level.asset.surface.triangles[np.asarray(numbers.values) == side]]
        assert np.isin(own, ends[side]).all()


def test_meshes_elsewhere_are_refused(folder: Path, hand_made: list[Path], tmp_path: Path) -> None:
    bare = read_asset(hand_made[0])
    moved = bare.surface.vertices + 0.1 * np.ptp(bare.surface.vertices, axis=0).max()
    write_asset(replace(bare, surface=bare.surface.with_vertices(moved)), tmp_path / "aside.glb")
    given = "--level", hand_made[1], "--level", tmp_path / "aside.glb"
    code, said = run("lods", folder / "levels" / "character_LOD1.glb", *given, "-o", tmp_path / "out")
    assert code == 1
    assert f"'{tmp_path / 'aside.glb'}' is not in the place and rest pose of the mesh" in said
    assert not (tmp_path / "out").exists()


def test_given_meshes_are_not_overwritten(folder: Path, hand_made: list[Path], tmp_path: Path) -> None:
    own = tmp_path / "character_LOD1.glb"
    own.write_bytes(hand_made[0].read_bytes())
    code, said = run("lods", folder / "character.glb", "--level", own, "-o", tmp_path)
    assert code == 1
    assert "input" in said
    assert [each.name for each in tmp_path.iterdir()] == ["character_LOD1.glb"]


@pytest.mark.parametrize(
    ("options", "code", "sentence"),
    [
        (("--ratios", "0.5", "--level", "low.glb"), 2, "--level and --ratios exclude each other"),
        (("--keep-uv",), 2, "--keep-uv is for meshes of --level"),
        (("--level", "low.blend"), 1, "export it as .glb"),
        (("--ratios", "half"), 2, "--ratios is 'half': give shares such as 0.5,0.25,0.1"),
        (("--ratios", "1.5"), 1, "A level cannot have 1.5 of"),
        (("--ratios", "0.0001"), 1, "that leave 12 vertices"),
        (("--format", "ply", "--keep-map"), 2, "--keep-map needs files in glTF"),
    ],
)
def test_invalid_options_are_reported(
    folder: Path, tmp_path: Path, options: tuple[str, ...], code: int, sentence: str
) -> None:
    ended, said = run("lods", folder / "character.glb", "-o", tmp_path / "out", *options)
    assert ended == code
    assert sentence in said
    assert not (tmp_path / "out").exists()


def test_files_read_only_as_shapes_are_refused(tmp_path: Path) -> None:
    (tmp_path / "hero.blend").touch()
    code, said = run("lods", tmp_path / "hero.blend", "-o", tmp_path / "levels")
    assert code == 1
    assert "export it as .glb" in said
