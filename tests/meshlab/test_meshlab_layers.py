# SPDX-License-Identifier: GPL-3.0-or-later
"""A layer's data survives the conversion to arrays and back."""

import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pymeshlab
import pytest
from creature import STRAIGHT, creature, write_textured_obj
from PIL import Image

from meshlab_filter.layer import TEXCOORD
from meshlab_filter.mesh_data import COMPONENTS, CUSTOM, add_layer, check_target, read_layer
from zoomout_core.mesh.errors import MeshError
from zoomout_core.transfer import Domain, Kind

TRANSFORM = np.array([[0, -2.0, 0, 1], [2, 0, 0, 1 / 3], [0, 0, -1, 0], [0, 0, 0, 1]])


@pytest.fixture
def rich(tmp_path):
    """A MeshSet with one mesh that has all kinds of data, and the custom attributes 'heat' and 'flow'."""
    resting = creature(0.12, STRAIGHT)
    write_textured_obj(tmp_path, resting)
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(tmp_path / "creature.obj"))
    ms.apply_filter("set_matrix", transformmatrix=TRANSFORM, freeze=False)
    ms.apply_filter("compute_color_by_function_per_vertex", x="127+127*sin(vi)", y="17", z="127+127*cos(vi)", a="100")
    ms.apply_filter("compute_color_by_function_per_face", r="127+127*sin(fi)", g="17", b="127+127*cos(fi)", a="255")
    ms.apply_filter("compute_scalar_by_function_per_vertex", q="vi/3")
    ms.apply_filter("compute_scalar_by_function_per_face", q="fi/7")
    ms.apply_filter("compute_selection_by_condition_per_vertex", condselect="sin(vi)>0.5")
    ms.apply_filter("compute_selection_by_condition_per_face", condselect="sin(fi)>0.7")
    mesh = ms.current_mesh()
    random = np.random.default_rng(0)
    mesh.add_vertex_custom_scalar_attribute(random.random(mesh.vertex_number()), "heat")
    mesh.add_vertex_custom_point_attribute(random.random((mesh.vertex_number(), 3)), "flow")
    mesh.add_face_custom_scalar_attribute(random.random(mesh.face_number()), "heat")
    mesh.add_face_custom_point_attribute(random.random((mesh.face_number(), 3)), "flow")
    return ms


def texture_numbers(ms, mesh_id):
    ms.set_current_mesh(mesh_id)
    ms.apply_filter("generate_copy_of_current_mesh")
    ms.apply_filter("compute_scalar_by_function_per_face", q="ti")
    return ms.current_mesh().face_scalar_array()


def pixels(image, folder):
    image.save(str(folder / "seen.png"))
    return np.array(Image.open(folder / "seen.png").convert("RGB"))


def test_layer_round_trip_keeps_all_data(rich, tmp_path):
    layer = read_layer(rich, 0, ["heat", "flow"])
    old, new = rich.mesh(0), rich.mesh(add_layer(rich, replace(layer, label="new")))
    assert new.label() == "new"
    assert rich.current_mesh_id() == new.id()
    assert len(layer.components) == len(COMPONENTS) + 1
    getters = ["vertex_matrix", "vertex_normal_matrix", "face_matrix", "transform_matrix", "wedge_tex_coord_matrix"]
    for getter in [*getters, *(component.getter for component in COMPONENTS)]:
        np.testing.assert_array_equal(getattr(new, getter)(), getattr(old, getter)(), err_msg=getter)
    for (_, kind), (getter, _) in CUSTOM.items():
        name = "heat" if kind is Kind.SCALAR else "flow"
        np.testing.assert_array_equal(getattr(new, getter)(name), getattr(old, getter)(name), err_msg=getter)
    assert list(new.textures()) == ["back.png", "front.png"]
    np.testing.assert_array_equal(texture_numbers(rich, new.id()), texture_numbers(rich, old.id()))
    assert set(texture_numbers(rich, new.id())) == {0, 1}


def test_textures_arrive_without_loss(rich, tmp_path):
    old = rich.mesh(0).textures()
    new = rich.mesh(add_layer(rich, read_layer(rich, 0))).textures()
    assert set(old) == {"back.png", "front.bmp"}
    for before, after in (("back.png", "back.png"), ("front.bmp", "front.png")):
        np.testing.assert_array_equal(pixels(new[after], tmp_path), pixels(old[before], tmp_path))


def test_surface_applies_the_layer_transform(rich):
    surface = read_layer(rich, 0).surface
    np.testing.assert_allclose(surface.vertices, rich.mesh(0).transformed_vertex_matrix(), atol=1e-12)
    np.testing.assert_array_equal(surface.triangles, rich.mesh(0).face_matrix())


def test_colours_are_converted_to_scene_linear():
    colors = np.array([[0.0, 0.5, 1.0, 0.25], [188 / 255, 10 / 255, 0.2, 1], [0, 0, 0, 1]])
    ms = pymeshlab.MeshSet()
    ms.add_mesh(pymeshlab.Mesh(np.eye(3), np.array([[0, 1, 2]]), v_color_matrix=colors))
    values = read_layer(ms, 0).components["vertex_color"].values
    np.testing.assert_allclose(values[1, :2], [0.503, 0.00304], atol=2e-3)  # half the light; the straight part
    np.testing.assert_allclose(values[:, 3], [63 / 255, 1, 1], atol=1e-2)


def test_defaults_filled_in_by_meshlab_are_ignored():
    ms = pymeshlab.MeshSet()
    ms.add_mesh(pymeshlab.Mesh(np.eye(3), np.array([[0, 1, 2]])))  # white, of quality 0, nothing selected
    assert ms.mesh(0).has_vertex_color()
    assert read_layer(ms, 0).components == {}


def test_default_grey_of_faces_without_material_is_ignored(tmp_path):
    lines = ["v 0 0 0", "v 1 0 0", "v 0 1 0", "vt 0 0", "vt 1 0", "vt 0 1"]
    (tmp_path / "plain.obj").write_text("\n".join([*lines, "f 1/1 2/2 3/3"]))
    (tmp_path / "blue.mtl").write_text("newmtl blue\nKd 0.2 0.4 0.8\n")
    (tmp_path / "blue.obj").write_text("\n".join(["mtllib blue.mtl", *lines, "usemtl blue", "f 1/1 2/2 3/3"]))
    ms = pymeshlab.MeshSet()
    for name in ("plain.obj", "blue.obj"):
        ms.load_new_mesh(str(tmp_path / name))
        assert ms.current_mesh().has_face_color()
    assert set(read_layer(ms, 0).components) == {TEXCOORD}
    assert set(read_layer(ms, 1).components) == {TEXCOORD, "face_color"}


def test_texture_coordinates_of_vertices_become_those_of_corners():
    faces = np.array([[0, 1, 2], [2, 1, 3]])
    coordinates = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]])
    ms = pymeshlab.MeshSet()
    vertices = np.hstack([coordinates, np.zeros((4, 1))])
    ms.add_mesh(pymeshlab.Mesh(vertices, faces, v_tex_coords_matrix=coordinates))
    layer = read_layer(ms, 0)
    np.testing.assert_array_equal(layer.components[TEXCOORD].values, coordinates[faces.ravel()])
    np.testing.assert_array_equal(ms.mesh(add_layer(ms, layer)).wedge_tex_coord_matrix(), coordinates[faces.ravel()])


def test_zero_texture_coordinates_are_ignored():
    ms = pymeshlab.MeshSet()
    ms.add_mesh(pymeshlab.Mesh(np.eye(3), np.array([[0, 1, 2]]), w_tex_coords_matrix=np.zeros((3, 2))))
    assert ms.mesh(0).has_wedge_tex_coord()
    assert read_layer(ms, 0).components == {}


def test_nan_texture_coordinates_leave_others_unchanged():
    coordinates = np.array([[0.0, 0], [1, 0], [0, 1], [np.nan, 0], [0, np.nan], [1, 1]])
    ms = pymeshlab.MeshSet()
    faces = np.array([[0, 1, 2], [2, 1, 3]])
    ms.add_mesh(pymeshlab.Mesh(np.eye(4)[:, :3], faces, w_tex_coords_matrix=coordinates))
    np.testing.assert_array_equal(ms.mesh(add_layer(ms, read_layer(ms, 0))).wedge_tex_coord_matrix(), coordinates)


def quads():
    """A 6 x 6 grid of quads, a triangle and a pentagon."""
    x, y = np.meshgrid(np.arange(7.0), np.arange(7.0), indexing="ij")
    number = np.arange(49).reshape(7, 7)
    corners = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=2).reshape(-1, 4)
    vertices = np.vstack(
        [np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]), [[-1, 0, 0], [7, 0, 0], [7, 7, 0], [8, 3, 0]]]
    )
    return vertices, [*corners, np.array([0, 1, 49]), np.array([42, 50, 52, 51, 48])]


def corner_sets(polygons):
    return sorted(tuple(sorted(polygon)) for polygon in polygons)


def test_polygons_are_kept_where_there_are_no_texture_coordinates():
    ms = pymeshlab.MeshSet()
    ms.add_mesh(pymeshlab.Mesh(*quads()))
    new = ms.mesh(add_layer(ms, read_layer(ms, 0)))
    assert corner_sets(new.polygonal_face_list()) == corner_sets(quads()[1])


def test_polygon_texture_coordinates_are_written_to_obj(tmp_path):
    vertices, faces = quads()
    lines = ["v {} {} {}".format(*vertex) for vertex in vertices]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
    (tmp_path / "quads.obj").write_text("\n".join(lines))
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(tmp_path / "quads.obj"))
    assert corner_sets(ms.current_mesh().polygonal_face_list()) == corner_sets(faces)
    ms.apply_filter(
        "compute_texcoord_by_function_per_wedge", u0="x0/9", v0="y0/9", u1="x1/9", v1="y1/9", u2="x2/9", v2="y2/9"
    )
    add_layer(ms, read_layer(ms, 0))
    ms.save_current_mesh(str(tmp_path / "a.obj"))
    lines = (tmp_path / "a.obj").read_text().splitlines()
    places = np.array([line.split()[1:3] for line in lines if line.startswith("v ")], float)
    written = np.array([line.split()[1:] for line in lines if line.startswith("vt ")], float)
    corners = [corner.split("/") for line in lines if line.startswith("f ") for corner in line.split()[1:]]
    for vertex, coordinate, *_ in corners:
        np.testing.assert_allclose(written[int(coordinate) - 1], places[int(vertex) - 1] / 9, atol=1e-6)


@pytest.mark.parametrize("broken", ["a face that names a vertex twice", "a vertex that is not finite"])
def test_target_that_meshlab_would_prune_is_refused(broken):
    vertices = np.vstack([np.eye(3), [[0, 0, 0], [1, 1, 1]]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    if "twice" in broken:
        faces = np.vstack([faces, [[0, 0, 4]]])
    else:
        vertices[4] = np.nan
    ms = pymeshlab.MeshSet()
    ms.add_mesh(pymeshlab.Mesh(vertices, faces))
    with pytest.raises(MeshError, match=r"1 (face that uses a vertex twice|vertex that is not finite)") as refusal:
        check_target(read_layer(ms, 0))
    (remedy,) = [word.strip(".") for word in str(refusal.value).split() if word.startswith("meshing_")]
    ms.apply_filter(remedy)
    check_target(read_layer(ms, 0))


def test_a_missing_mesh_and_a_missing_attribute_are_named(rich):
    with pytest.raises(MeshError, match="no mesh 7: the MeshSet has only mesh 0"):
        read_layer(rich, 7)
    with pytest.raises(MeshError, match=r"'creature.obj' has no custom attribute 'mine'"):
        read_layer(rich, 0, ["heat", "mine"])


def test_name_shared_by_vertices_and_faces_reads_both(rich):
    heat = read_layer(rich, 0, ["heat"]).custom
    assert [attribute.domain for attribute in heat] == [Domain.POINT, Domain.FACE]


def test_reading_leaves_the_mesh_set_as_it_is(rich):
    before = rich.mesh_number(), rich.current_mesh_id(), rich.mesh(0).label(), rich.mesh(0).vertex_matrix()
    read_layer(rich, 0, ["heat"])
    after = rich.mesh_number(), rich.current_mesh_id(), rich.mesh(0).label(), rich.mesh(0).vertex_matrix()
    assert before[:3] == after[:3]
    np.testing.assert_array_equal(before[3], after[3])


@pytest.mark.skipif(find_spec("bpy") is None, reason="Blender is not installed as a module")
def test_the_filters_can_be_imported_before_blender():
    subprocess.run([sys.executable, "-c", "import meshlab_filter, bpy, pymeshlab"], check=True)
