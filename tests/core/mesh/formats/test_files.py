# SPDX-License-Identifier: GPL-3.0-or-later
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_point_cloud, read_shape, read_surface
from zoomout_core.mesh.point_cloud import PointCloud

trimesh = pytest.importorskip("trimesh")


@pytest.fixture
def shuffled_sphere():
    """A sphere with randomly ordered vertices and one unused vertex."""
    sphere = trimesh.creation.icosphere(subdivisions=3)
    order = np.random.default_rng(0).permutation(len(sphere.vertices))
    number = np.argsort(order)
    vertices = np.vstack([sphere.vertices[order], [[9.0, 9.0, 9.0]]])
    return vertices, number[sphere.faces]


def off_text(vertices, faces):
    lines = ["OFF", "# a comment", f"{len(vertices)} {len(faces)} 0"]
    lines += [" ".join(map(repr, map(float, vertex))) for vertex in vertices]
    lines += [" ".join(map(str, [len(face), *face])) for face in faces]
    return "\n".join(lines)


def ply_bytes(vertices, faces, texcoord=None):
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property double {axis}" for axis in "xyz"]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header += ["property list uchar float texcoord"] if texcoord is not None else []
    body = np.asarray(vertices, "<f8").tobytes()
    for number, face in enumerate(faces):
        body += struct.pack(f"<B{len(face)}i", len(face), *face)
        if texcoord is not None:
            body += struct.pack("<B6f", 6, *texcoord[number])
    return "\n".join([*header, "end_header\n"]).encode() + body


def obj_text(vertices, faces, texcoords):
    """OBJ text with a texture coordinate and a normal per corner, and alternating materials."""
    lines = ["mtllib none.mtl"]
    lines += ["v " + " ".join(map(repr, map(float, vertex))) for vertex in vertices]
    lines += [f"vt {u} {v}" for u, v in texcoords] + ["vn 0 0 1", "vn 0 1 0"]
    for number, face in enumerate(faces):
        corners = [f"{vertex + 1}/{3 * number + i + 1}/{i % 2 + 1}" for i, vertex in enumerate(face)]
        lines += [f"usemtl material{number % 3}", "f " + " ".join(corners)]
    return "\n".join(lines)


def assert_same_mesh(surface, vertices, faces):
    np.testing.assert_array_equal(surface.vertices, vertices)
    np.testing.assert_array_equal(surface.triangles, faces)


def test_off_keeps_the_order_of_vertices_and_faces(tmp_path, shuffled_sphere):
    (tmp_path / "a.off").write_text(off_text(*shuffled_sphere))
    assert_same_mesh(read_surface(tmp_path / "a.off"), *shuffled_sphere)


def test_ply_keeps_vertices_with_several_texture_coordinates(tmp_path, shuffled_sphere):
    vertices, faces = shuffled_sphere
    texcoord = np.random.default_rng(1).random((len(faces), 6))
    (tmp_path / "a.ply").write_bytes(ply_bytes(vertices, faces, texcoord))
    assert_same_mesh(read_surface(tmp_path / "a.ply"), vertices, faces)


def test_obj_keeps_vertices_with_several_uvs_and_materials(tmp_path, shuffled_sphere):
    vertices, faces = shuffled_sphere
    texcoords = np.random.default_rng(1).random((faces.size, 2))
    (tmp_path / "a.obj").write_text(obj_text(vertices, faces, texcoords))
    assert_same_mesh(read_surface(tmp_path / "a.obj"), vertices, faces)


def test_obj_reads_polygons_negative_indices_and_continued_lines(tmp_path):
    (tmp_path / "a.OBJ").write_text(
        "o first\nv 0 0 0\nv\t1 0 0 0.5 0.5 0.5\nv 1 1 0\nv 0 1 0\nf -4 -3 \\\n -2 -1\n"
        "o second\nv 2 0 0\nv 2 1 0\n\n  f 2//1 -2//1 -1//1 3//1\nl 1 2\n"
    )
    surface = read_surface(tmp_path / "a.OBJ")
    assert surface.corner_vertex.tolist() == [0, 1, 2, 3, 1, 4, 5, 2]
    assert surface.face_start.tolist() == [0, 4, 8]
    assert surface.area == pytest.approx(2)


@pytest.mark.parametrize("name", ["quads.off", "quads.ply"])
def test_polygons_of_different_sizes_keep_their_vertices_and_area(tmp_path, name):
    angles = np.arange(5) * 2 * np.pi / 5
    pentagon = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    vertices = np.vstack([pentagon, 2 * pentagon])
    faces = [[0, 1, 2, 3, 4], [0, 5, 6, 1], [1, 6, 2]]
    (tmp_path / "quads.off").write_text(off_text(vertices, faces))
    (tmp_path / "quads.ply").write_bytes(ply_bytes(vertices, faces))
    surface = read_surface(tmp_path / name)
    np.testing.assert_array_equal(surface.vertices, vertices)
    assert surface.face_start.tolist() == [0, 5, 9, 12]
    assert surface.area == pytest.approx((2.5 + 1.5 + 0.5) * np.sin(2 * np.pi / 5))


def test_off_with_colours_and_counts_in_the_first_line_is_read(tmp_path):
    (tmp_path / "a.off").write_text(
        "COFF 4 1 5\n0 0 0 9 9 9 9\n1 0 0 9 9 9 9\n1 1 0 9 9 9 9\n0 1 0 9 9 9 9\n4 0 1 2 3 7 7 7"
    )
    surface = read_surface(tmp_path / "a.off")
    assert surface.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert surface.corner_vertex.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_is_read_in_every_encoding_ignoring_other_elements(tmp_path, encoding):
    vertices = [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0.5, 0]]
    faces = [[0, 1, 2, 3], [1, 4, 2]]
    header = f"""ply
format {encoding} 1.0
comment exported by hand
element camera 1
property list uchar short pose
element vertex 5
property float x
property float y
property float z
property uchar red
property list uchar double weights
element face 2
property int material
property list uchar uint vertex_index
property list int float texcoord
end_header
"""
    rows = [("B2h", (2, -7, 7))]
    rows += [(f"3fBB{i}d", (*vertex, 200, i, *[0.5] * i)) for i, vertex in enumerate(vertices)]
    rows += [(f"iB{len(f)}Ii{2 * len(f)}f", (3, len(f), *f, 2 * len(f), *[0.25] * (2 * len(f)))) for f in faces]
    if encoding == "ascii":
        body = "\n".join(" ".join(map(str, values)) for _, values in rows).encode()
    else:
        order = ">" if "big" in encoding else "<"
        body = b"".join(struct.pack(order + layout, *values) for layout, values in rows)
    (tmp_path / "a.ply").write_bytes(header.encode() + body)
    surface = read_surface(tmp_path / "a.ply")
    np.testing.assert_array_equal(surface.vertices, vertices)
    assert surface.corner_vertex.tolist() == [0, 1, 2, 3, 1, 4, 2]
    assert surface.face_start.tolist() == [0, 4, 7]


def test_stl_keeps_the_corners_of_its_triangles(tmp_path, shuffled_sphere):
    vertices, faces = shuffled_sphere
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "a.stl")
    surface = read_surface(tmp_path / "a.stl")
    np.testing.assert_allclose(surface.vertices, vertices[faces].reshape(-1, 3), atol=1e-6)
    assert len(surface.working.vertices) == len(vertices) - 1  # welded, without the unused vertex


def test_scene_is_joined_in_file_order_with_its_transforms(tmp_path, shuffled_sphere):
    vertices, faces = shuffled_sphere
    meshes = [trimesh.Trimesh(vertices, faces, process=False), trimesh.creation.box(), trimesh.creation.box()]
    mirror = np.diag([-2.0, 1.0, 1.0, 1.0])
    mirror[:3, 3] = 5, 6, 7
    scene = trimesh.Scene()
    scene.add_geometry(meshes[0], transform=mirror)
    scene.add_geometry(meshes[1])
    scene.add_geometry(meshes[2], transform=trimesh.transformations.translation_matrix([0, 0, 9]))
    scene.export(tmp_path / "a.glb")
    surface = read_surface(tmp_path / "a.glb")
    n = len(vertices)
    np.testing.assert_allclose(surface.vertices[:n], vertices * [-2, 1, 1] + [5, 6, 7], atol=1e-5)
    np.testing.assert_allclose(surface.vertices[n : n + 8], meshes[1].vertices, atol=1e-6)
    np.testing.assert_allclose(surface.vertices[n + 8 :], meshes[2].vertices + np.array([0, 0, 9]), atol=1e-6)
    np.testing.assert_array_equal(
        surface.triangles[: len(faces)], faces[:, [0, 2, 1]]
    )  # flipped, as the transform mirrors
    np.testing.assert_array_equal(surface.triangles[len(faces) + 12 :], meshes[2].faces + n + 8)


def test_a_point_cloud_is_read_as_points_and_refused_as_a_surface(tmp_path):
    points = np.random.default_rng(0).random((40, 3))
    (tmp_path / "cloud.ply").write_bytes(ply_bytes(points, []))
    np.testing.assert_array_equal(read_point_cloud(tmp_path / "cloud.ply").points, points)
    with pytest.raises(MeshError, match="no faces, only 40 points"):
        read_surface(tmp_path / "cloud.ply")


def test_a_cloud_has_the_normals_of_its_ply_file(tmp_path):
    rows = np.random.default_rng(0).random((40, 6)).astype(np.float32)
    names = ("x", "y", "z", "nx", "ny", "nz")
    header = ["ply", "format binary_little_endian 1.0", "element vertex 40", *(f"property float {n}" for n in names)]
    (tmp_path / "cloud.ply").write_bytes("\n".join([*header, "end_header\n"]).encode() + rows.tobytes())
    cloud = read_shape(tmp_path / "cloud.ply")
    assert isinstance(cloud, PointCloud)
    np.testing.assert_array_equal(cloud.normals, rows[:, 3:])


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("broken.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n", "could not be read"),
        ("broken.ply", "ply\nformat binary_little_endian 1.0\n", "could not be read"),
        ("broken.obj", "v 0 0 0\nv 1 0 0\nv 0 one 0\nf 1 2 3\n", "could not be read"),
        ("short.obj", "v 0 0 0\nv 1 0\nv 0 1 0\nf 1 2 3\n", "could not be read"),
        ("word.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x/1\n", "could not be read"),
        ("range.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "vertex 3"),
        ("cut.off", "OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "could not be read"),
        (
            "cut.ply",
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nend_header\n0 0",
            "could not",
        ),
        ("zero.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "refers to vertex"),
        ("flat.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n", "no area"),
        ("thing.xyzzy", "what is this", "is not supported"),
    ],
)
def test_unusable_files_are_refused_by_name_in_one_sentence(tmp_path, name, content, sentence):
    (tmp_path / name).write_text(content)
    with pytest.raises(MeshError, match=sentence) as refusal:
        read_surface(tmp_path / name)
    assert "\n" not in str(refusal.value)
    assert name in str(refusal.value)


def test_missing_files_and_folders_are_refused(tmp_path):
    for reader in (read_surface, read_point_cloud):
        with pytest.raises(MeshError, match=r"no file .*nowhere\.off"):
            reader(tmp_path / "nowhere.off")
        with pytest.raises(MeshError, match="is a folder"):
            reader(tmp_path)


@pytest.mark.parametrize("path", [None, 7, np.zeros((4, 3)), ["a.off"], b"a.off"])
def test_arguments_that_are_not_paths_are_refused(path):
    for reader in (read_surface, read_point_cloud):
        with pytest.raises(TypeError, match=r"a string or a path, not as a \w+\.$"):
            reader(path)


def test_missing_trimesh_is_reported_with_how_to_install_it(tmp_path, monkeypatch, shuffled_sphere):
    vertices, faces = shuffled_sphere
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "a.stl")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ImportError, match="pip install"):
        read_surface(tmp_path / "a.stl")


def test_faces_at_nan_vertices_are_left_out(tmp_path: Path) -> None:
    lines = ["v 0 0 0", "v 1 0 0", "v 1 1 0", "v nan 1 0", "f 1 2 3", "f 1 3 4"]
    (tmp_path / "torn.obj").write_text("\n".join(lines))
    surface = read_surface(tmp_path / "torn.obj")
    assert surface.triangles.tolist() == [[0, 1, 2]]
    assert len(surface.vertices) == 4  # numbers stay
    (tmp_path / "nothing.obj").write_text("\n".join([*lines[:4], lines[5]]))
    with pytest.raises(MeshError, match="not finite"):
        read_surface(tmp_path / "nothing.obj")
