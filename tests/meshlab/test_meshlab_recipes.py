"""The recipes of docs/meshlab.md, run as they stand there, and the figures beside them."""

import re
from pathlib import Path

import creatures
import numpy as np
import pymeshlab
import pytest
from creature import SOURCE_POSE, TARGET_POSE, Creature, creature, rest_of, write_textured_obj
from PIL import Image

from meshlab_filter import transfer_attributes_by_zoomout
from meshlab_filter.script import read_script

SIZE = 14.2**0.5
DOCUMENT = (Path(__file__).parents[2] / "docs" / "meshlab.md").read_text(encoding="utf-8")
RECIPES = dict(re.findall(r"^### (.*?)$.*?```python\n(.*?)```", DOCUMENT, re.MULTILINE | re.DOTALL))


def scanned(made):
    """A mesh with noise of a tenth of an edge, and a hole on its back."""
    noise = np.random.default_rng(0).normal(scale=0.01, size=made.vertices.shape)
    at = made.rest[made.faces].mean(axis=1)
    keep = np.linalg.norm(at - [0.1, 0, 0.42], axis=1) > 0.2
    used, faces = np.unique(made.faces[keep], return_inverse=True)
    return Creature(made.rest[used], (made.vertices + noise)[used], faces.reshape(-1, 3))


@pytest.fixture(scope="module")
def source():
    return creature(0.08, SOURCE_POSE)


@pytest.fixture(scope="module")
def target():
    return scanned(creature(0.1, TARGET_POSE))


@pytest.fixture
def folder(tmp_path, monkeypatch, source, target):
    """Where the recipes find their files."""
    write_textured_obj(tmp_path, source)
    (tmp_path / "creature.obj").rename(tmp_path / "character.obj")
    ms = pymeshlab.MeshSet()
    ms.add_mesh(target.mesh())
    ms.save_current_mesh(str(tmp_path / "retopology.ply"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(title):
    names = {}
    exec(compile(RECIPES[title], title, "exec"), names)
    return names  # to be kept while its meshes are used


def texture_error(mesh, target):
    uv = mesh.wedge_tex_coord_matrix()
    return np.linalg.norm(rest_of(uv) - target.rest[mesh.face_matrix().ravel(), :2], axis=1) / SIZE


def test_every_recipe_has_a_test():
    names = {f"test_{title.lower().replace(' ', '_')}" for title in RECIPES}
    assert len(names) == 6
    assert names <= set(globals())


def test_texture_a_retopologised_scan(folder, target):
    run("Texture a retopologised scan")
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(folder / "textured.obj"))
    assert texture_error(ms.current_mesh(), target).mean() < 0.02
    assert sorted(ms.current_mesh().textures()) == ["back.png", "front.png"]


def place_error(colors, places):
    """Off by how much the places are that colours of `gradient` stand for, in thousandths of the size."""
    return 1000 * np.linalg.norm(rest_of(colors[:, :2]) - places[:, :2], axis=1) / SIZE


def gradient(pixels=256):
    """An image whose red is u and whose green is v."""
    middle = (np.arange(pixels) + 0.5) / pixels
    u, v = np.meshgrid(middle, middle[::-1])
    return Image.fromarray(np.rint(255 * np.stack([u, v, 0 * u], axis=-1)).astype(np.uint8))


def test_bake_the_texture_anew(folder, target):
    for name in ("front.bmp", "back.png"):
        gradient().save(folder / name)
    names = run("Bake the texture anew")
    assert place_error(names["ms"].mesh(1).vertex_color_matrix(), target.rest).mean() < 10
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(folder / "baked.obj"))
    baked = ms.current_mesh()
    assert list(baked.textures()) == ["baked.png"]
    image = np.array(Image.open(folder / "baked.png").convert("RGB")) / 255
    u, v = baked.wedge_tex_coord_matrix().reshape(-1, 3, 2).mean(axis=1).T
    assert ((u > 0) & (u < 1) & (v > 0) & (v < 1)).all()
    seen = image[((1 - v) * len(image)).astype(int), (u * len(image[0])).astype(int)]
    np.testing.assert_array_equal(baked.face_matrix(), target.faces)
    error = place_error(seen, target.rest[target.faces].mean(axis=1))
    assert error.mean() < 10
    assert np.mean(error > 50) < 0.01


def test_propagate_a_selection(folder, source, target):
    ms = run("Propagate a selection")["ms"]
    nearest = np.argmin(np.linalg.norm(source.rest[None] - target.rest[:, None], axis=2), axis=1)
    wanted = (source.vertices[:, 0] > 0.9)[nearest]
    assert wanted.any()
    assert np.mean(ms.current_mesh().vertex_selection_array() == wanted) > 0.98


def test_map_quality(folder, target):
    names = run("Map quality")
    assert names["found"]["certainty"] > 0.5
    assert names["error"]["median"] / SIZE < 0.02
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(folder / "quality.ply"))
    np.testing.assert_allclose(ms.current_mesh().vertex_scalar_array(), names["error"]["error"], atol=1e-6)


def test_remesh_a_posed_shape_symmetrically(tmp_path, monkeypatch):
    made = creatures.creature(3000, seed=1, bend=0.9)
    scan = made.surface
    monkeypatch.chdir(tmp_path)
    ms = pymeshlab.MeshSet()
    ms.add_mesh(pymeshlab.Mesh(scan.vertices, scan.triangles))
    ms.save_current_mesh("scan.ply")
    names = run("Remesh a posed shape symmetrically")
    measures = names["ms"].apply_filter("get_topological_measures")
    assert measures["is_mesh_two_manifold"]
    assert measures["boundary_edges"] == 0
    assert measures["genus"] == 0
    assert measures["connected_components_number"] == 1
    size = np.sqrt(scan.area)
    symmetric = names["ms"].current_mesh_id()
    for one, other in ((0, symmetric), (symmetric, 0)):
        names["ms"].set_current_mesh(one)
        distance = names["ms"].apply_filter(
            "get_hausdorff_distance", sampledmesh=one, targetmesh=other, maxdist=pymeshlab.PercentageValue(50)
        )
        assert 1000 * distance["mean"] / size < 1.5
    # The truth is known at vertices of the scan, which are 18 apart.
    nearest = np.linalg.norm(names["here"][:, None] - scan.vertices, axis=2).argmin(axis=1)
    mirrored = scan.vertices[creatures.mirrored_vertex(made, made)[nearest]]
    off = 1000 * np.linalg.norm(names["there"] - mirrored, axis=1) / size
    assert np.median(off) < 36
    assert np.mean(off > 100) < 0.05


@pytest.mark.parametrize("rebuilt", ["iso", "qes", "mc", "dense"])
def test_measure_a_correspondence_against_the_truth(benchmark_data, monkeypatch, rebuilt):
    """The figures are those of the document's table."""
    monkeypatch.chdir(benchmark_data / "faust_discretisation")
    title = "Measure a correspondence against the truth"
    monkeypatch.setitem(RECIPES, title, RECIPES[title].replace("iso_081", f"{rebuilt}_081"))
    error = run(title)["error"]
    assert error["zoomout"].mean() < 15
    assert error["closest point"].mean() > 4 * error["zoomout"].mean()
    assert np.mean(error["closest point"] > 50) > 20 * np.mean(error["zoomout"] > 50)


def test_the_script_of_the_document_can_be_read(tmp_path):
    (xml,) = re.findall(r"```xml\n(.*?)```", DOCUMENT, re.DOTALL)
    (tmp_path / "script.mlx").write_text(xml)
    assert [call.element.line for call in read_script(tmp_path / "script.mlx")] == [3, 8, 11]


def test_transfer_is_several_times_as_exact_as_by_the_closest_point(folder, source, target):
    """At another pose; the figures are those of the document's table."""
    colors = np.column_stack([0.5 + source.rest / 6, np.ones(len(source.rest))])
    truth = 0.5 + target.rest / 6
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh("character.obj")
    ms.add_mesh(source.mesh(v_color_matrix=colors, v_scalar_array=source.rest[:, 0]), "source")
    ms.add_mesh(target.mesh(), "ours")
    ms.add_mesh(target.mesh(), "closest")
    ms.set_current_mesh(1)
    ms.apply_filter("compute_selection_by_condition_per_vertex", condselect="q > 0.5")
    ms.apply_filter("compute_selection_transfer_vertex_to_face", inclusive=False)
    ms.apply_filter(
        "transfer_attributes_per_vertex",
        sourcemesh=1,
        targetmesh=3,
        qualitytransfer=True,
        selectiontransfer=True,
        upperbound=pymeshlab.PercentageValue(100),
    )
    report = transfer_attributes_by_zoomout(ms, sourcemesh=1, targetmesh=2, selectiontransfer=True)
    textured = transfer_attributes_by_zoomout(ms, sourcemesh=0, targetmesh=2)
    figures = {}
    for name, mesh in (("closest", ms.mesh(3)), ("ours", ms.mesh(report["mesh_id"]))):
        figures[name] = np.array(
            [
                1000 * np.abs(mesh.vertex_scalar_array() - target.rest[:, 0]).mean() / SIZE,
                255 * np.abs(mesh.vertex_color_matrix()[:, :3] - truth).mean(),
                np.mean(mesh.vertex_selection_array() != (target.rest[:, 0] > 0.5)),
            ]
        )
    # Selections differ at their border alone, by a few dozen vertices.
    assert (figures["closest"] > [3, 3, 2] * figures["ours"]).all(), figures
    assert 1000 * texture_error(ms.mesh(textured["mesh_id"]), target).mean() < 10
