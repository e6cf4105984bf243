# SPDX-License-Identifier: GPL-3.0-or-later
"""Edge marks, custom normals and attributes of every type, transferred and then used by Blender."""

import bmesh
import bpy
import numpy as np
import pytest
from scenes import activate, add_attribute, decimate, ellipsoid, link, positions, values
from true_match import keep_true_match

from blender_addon import mesh_data
from blender_addon.adapters import Settings
from blender_addon.services.transfer import transfer_objects
from zoomout_core.transfer import frames
from zoomout_core.transfer.cut_mesh import cut_surface


@pytest.fixture
def source():
    return ellipsoid("Source")


@pytest.fixture
def target(source):
    """The source's shape with fewer triangles, rotated and moved in mesh space, and the true match."""
    obj = decimate()
    keep_true_match(obj)
    return obj


def transfer(source, target, *data):
    return transfer_objects(bpy.context, source, target, data)


def edge_array(mesh, name, dtype=bool):
    array = np.empty(len(mesh.edges), dtype)
    mesh.edges.foreach_get(name, array)
    return array


def ends(mesh):
    array = np.empty(2 * len(mesh.edges), np.int32)
    mesh.edges.foreach_get("vertices", array)
    return array.reshape(-1, 2)


def mark_equator(mesh, plane=0.1):
    """(e,) the edges between faces on different sides of a plane: one loop."""
    working = bmesh.new()
    working.from_mesh(mesh)
    above = [[face.calc_center_median()[2] > plane for face in edge.link_faces] for edge in working.edges]
    working.free()
    return np.array([len(set(sides)) == 2 for sides in above])


def unwrapped_islands(obj):
    """The number of islands that Blender's unwrapping creates along a mesh's seams."""
    activate(obj)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.unwrap()
    bpy.ops.object.mode_set(mode="OBJECT")
    surface = mesh_data.read_surface_at_rest(obj)
    uv = values(obj.data, obj.data.uv_layers.active.name)
    return cut_surface(surface, uv).island.max() + 1


def test_transferred_seam_can_be_unwrapped(source, target):
    seams = mark_equator(source.data)
    source.data.edges.foreach_set("use_seam", seams)
    assert unwrapped_islands(source) == 2
    target.data.edges[5].use_seam = True  # replaced
    report = transfer(source, target, "edges")
    assert report["written"]["edges"] == ["seams"]
    heights = positions(target.data)[ends(target.data)[edge_array(target.data, "use_seam")], 2]
    assert np.abs(heights - 0.1).max() < 0.08
    assert unwrapped_islands(target) == 2


def test_each_edge_mark_is_transferred_and_others_stay(source, target):
    loop = mark_equator(source.data)
    source.data.edges.foreach_set("use_edge_sharp", loop)
    for name in ("crease_edge", "bevel_weight_edge"):
        add_attribute(source.data, name, "FLOAT", "EDGE", np.where(loop, 0.75, 0))
    activate(source)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_mode(type="EDGE")
    bpy.ops.mesh.select_all(action="DESELECT")
    bpy.ops.object.mode_set(mode="OBJECT")
    source.data.edges.foreach_set("select", loop)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.mark_freestyle_edge()
    bpy.ops.object.mode_set(mode="OBJECT")
    crease = np.zeros(len(source.data.vertices))
    crease[[5, 100]] = 0.5, 1.0
    add_attribute(source.data, "crease_vert", "FLOAT", "POINT", crease)
    target.data.edges[5].use_seam = True
    before = edge_array(target.data, "use_seam")

    report = transfer(source, target, "edges")
    assert report["written"]["edges"] == [
        "sharp edges",
        "Freestyle edges",
        "creases",
        "bevel weights",
        "vertex creases",
    ]
    line = edge_array(target.data, "use_edge_sharp")
    assert 30 < line.sum() < 200
    for name in ("crease_edge", "bevel_weight_edge"):
        np.testing.assert_allclose(values(target.data, name), np.where(line, 0.75, 0), atol=1e-6)
    freestyle = {marks.name: marks.values for marks in mesh_data.read_marks(target.data)}["Freestyle edges"]
    np.testing.assert_array_equal(freestyle, line)
    vertices = np.flatnonzero(values(target.data, "crease_vert"))
    np.testing.assert_allclose(values(target.data, "crease_vert")[vertices].max(), 1)
    assert len(vertices) == 2
    distance = np.linalg.norm(positions(target.data)[vertices][:, None] - positions(source.data)[[5, 100]], axis=2)
    assert distance.min(axis=1).max() < 0.1
    np.testing.assert_array_equal(edge_array(target.data, "use_seam"), before)


def cube(name, cuts, triangles=False):
    """A cube of faces divided into grids."""
    mesh = bpy.data.meshes.new(name)
    working = bmesh.new()
    bmesh.ops.create_cube(working, size=2)
    bmesh.ops.subdivide_edges(working, edges=working.edges, cuts=cuts, use_grid_fill=True)
    if triangles:
        bmesh.ops.triangulate(working, faces=working.faces)
    working.to_mesh(mesh)
    working.free()
    return link(name, mesh)


def subdivided_volume(obj):
    obj.modifiers.new("Finer", "SUBSURF").levels = 2
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    working = bmesh.new()
    working.from_mesh(evaluated.to_mesh())
    evaluated.to_mesh_clear()
    volume = working.calc_volume()
    working.free()
    obj.modifiers.clear()
    return volume


@pytest.mark.parametrize("cuts", [5, 17])
def test_creases_keep_the_edges_of_a_subdivided_cube(cuts):
    source, target = cube("Source", 11), cube("Target", cuts, triangles=True)
    keep_true_match(target)
    on_sides = (np.abs(positions(source.data)[ends(source.data)]) > 0.999).all(axis=1).sum(axis=1) == 2
    assert on_sides.sum() == 12 * 12
    add_attribute(source.data, "crease_edge", "FLOAT", "EDGE", on_sides)
    rounded = 8 - subdivided_volume(target)
    transfer(source, target, "edges")
    assert values(target.data, "crease_edge").astype(bool).sum() == 12 * (cuts + 1)
    assert 8 - subdivided_volume(target) < 0.05 * rounded


# --- custom normals -----------------------------------------------------------------------------------------


def corner_normals(obj):
    """(c, 3) Blender's corner normals in world space."""
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    array = np.empty(3 * len(mesh.loops), np.float32)
    mesh.corner_normals.foreach_get("vector", array)
    evaluated.to_mesh_clear()
    normals = array.reshape(-1, 3) @ np.linalg.inv(np.array(obj.matrix_world)[:3, :3])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def corner_vertices(mesh):
    array = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", array)
    return array


def degrees(first, second):
    return np.degrees(np.arccos(np.clip(np.einsum("cx,cx->c", first, second), -1, 1)))


def bulging(points):
    """Normals of a rounder shape than the points' own."""
    normals = points / np.array([1.0, 0.9, 0.8])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def give_normals(obj, normals):
    obj.data.shade_smooth()
    obj.data.normals_split_custom_set(normals)


@pytest.mark.parametrize("placed", ["still", "turned", "mirrored", "turned mesh"])
def test_custom_normals_turn_with_the_target(source, target, placed):
    still = positions(target.data).astype(float)
    give_normals(source, bulging(positions(source.data))[corner_vertices(source.data)])
    assert degrees(corner_normals(source), bulging(positions(source.data))[corner_vertices(source.data)]).max() < 0.5
    target.data.shade_smooth()
    turn = np.eye(3)
    if placed == "turned":
        target.rotation_euler, target.scale = (0.5, -1, 2), (2, 2, 2)
        bpy.context.view_layer.update()
        turn = np.array(target.matrix_world)[:3, :3] / 2
    elif placed == "mirrored":
        target.scale = (-1, 1, 1)
        bpy.context.view_layer.update()
        turn = np.diag([-1.0, 1, 1])
    elif placed == "turned mesh":
        turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        target.data.vertices.foreach_set("co", (still @ turn.T).ravel())
        target.data.update()
    keep_true_match(target, still)
    report = transfer(source, target, "custom_normals")
    assert report["written"]["custom_normals"] == ["custom_normal"]
    truth = (bulging(still) @ turn.T)[corner_vertices(target.data)]
    error = degrees(corner_normals(target), truth)
    assert np.median(error) < 1
    assert np.percentile(error, 99) < 4
    assert not edge_array(target.data, "use_edge_sharp").any()


def test_normals_of_faces_that_cancel_are_zero():
    mesh = bpy.data.meshes.new("Both")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2), (0, 2, 1)])
    mesh.shade_smooth()
    np.testing.assert_array_equal(mesh_data.read_normals(bpy.data.objects.new("Both", mesh), mesh).values, 0)


def test_target_marks_respect_missing_mode_and_mask(source, target):
    source.data.edges.foreach_set("use_seam", mark_equator(source.data))
    own = positions(target.data)[ends(target.data)][:, :, 2].mean(axis=1) > 0.4
    target.data.edges.foreach_set("use_seam", own)
    target.vertex_groups.new(name="Mask").add(np.flatnonzero(positions(target.data)[:, 0] > 0).tolist(), 1, "REPLACE")
    transfer_objects(bpy.context, source, target, ["edges"], Settings(mode="missing"))
    both = edge_array(target.data, "use_seam")
    traced = both & ~own
    assert both[own].all()
    assert 30 < traced.sum() < 200
    target.data.edges.foreach_set("use_seam", own)
    transfer_objects(bpy.context, source, target, ["edges"], Settings(mask_group="Mask"))
    inside = (positions(target.data)[ends(target.data)][:, :, 0] > 0).all(axis=1)
    masked = edge_array(target.data, "use_seam")
    np.testing.assert_array_equal(masked[inside], traced[inside])
    np.testing.assert_array_equal(masked[~inside & own], True)
    assert not masked[~inside & ~own].any()


def test_custom_normals_of_posed_target_are_stored_at_rest(source, target):
    give_normals(source, bulging(positions(source.data))[corner_vertices(source.data)])
    target.data.shade_smooth()
    truth = bulging(positions(target.data))[corner_vertices(target.data)]
    still = positions(target.data).astype(float)
    modifier = target.modifiers.new("Bend", "SIMPLE_DEFORM")
    modifier.deform_method, modifier.deform_axis, modifier.angle = "BEND", "Z", 1.5
    keep_true_match(target, still)
    transfer(source, target, "custom_normals")
    modifier.show_viewport = False
    assert np.median(degrees(corner_normals(target), truth)) < 1


def test_normals_split_along_transferred_sharp_edges(source, target):
    loop = mark_equator(source.data, 0.0)
    source.data.shade_smooth()
    source.data.edges.foreach_set("use_edge_sharp", loop)
    centres = np.array([polygon.center[2] for polygon in source.data.polygons])
    per_corner = np.repeat(centres > 0, [polygon.loop_total for polygon in source.data.polygons])
    tilted = bulging(positions(source.data))[corner_vertices(source.data)] + np.where(per_corner, 0.6, -0.6)[
        :, None
    ] * [0, 0, 1]
    give_normals(source, tilted / np.linalg.norm(tilted, axis=1, keepdims=True))
    target.data.shade_smooth()
    transfer(source, target, "edges", "custom_normals")
    line = edge_array(target.data, "use_edge_sharp")
    heights = positions(target.data)[ends(target.data)[line], 2]
    assert np.abs(heights).max() < 0.12
    centres = np.array([polygon.center[2] for polygon in target.data.polygons])
    above = np.repeat(centres > 0, [polygon.loop_total for polygon in target.data.polygons])
    truth = bulging(positions(target.data))[corner_vertices(target.data)] + np.where(above, 0.6, -0.6)[:, None] * [
        0,
        0,
        1,
    ]
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    error = degrees(corner_normals(target), truth)
    assert np.median(error) < 1
    assert (error < 5).mean() > 0.97


def test_free_normals_are_replaced(source, target):
    if bpy.app.version < (4, 5, 0):
        pytest.skip("this version keeps no normals as they are")
    give_normals(source, bulging(positions(source.data))[corner_vertices(source.data)])
    target.data.shade_smooth()
    add_attribute(
        target.data, "custom_normal", "FLOAT_VECTOR", "POINT", np.tile([0, 0, 1.0], (len(target.data.vertices), 1))
    )
    transfer(source, target, "custom_normals")
    truth = bulging(positions(target.data))[corner_vertices(target.data)]
    assert np.median(degrees(corner_normals(target), truth)) < 1


@pytest.mark.parametrize("smooth", [True, False])
def test_custom_normals_outside_the_mask_stay_as_shown(source, target, smooth):
    give_normals(source, bulging(positions(source.data))[corner_vertices(source.data)])
    target.data.polygons.foreach_set("use_smooth", np.full(len(target.data.polygons), smooth))
    shown = corner_normals(target)
    inside = positions(target.data)[:, 0] > 0
    target.vertex_groups.new(name="Mask").add(np.flatnonzero(inside).tolist(), 1, "REPLACE")
    transfer_objects(bpy.context, source, target, ["custom_normals"], Settings(mask_group="Mask"))
    of_corner = corner_vertices(target.data)
    inside, truth = inside[of_corner], bulging(positions(target.data))[of_corner]
    assert degrees(corner_normals(target), shown)[~inside].max() < 0.5
    assert np.median(degrees(shown, truth)[inside]) > 2
    assert np.median(degrees(corner_normals(target), truth)[inside]) < 1


def test_custom_normals_mix_by_the_factor(source, target):
    give_normals(source, bulging(positions(source.data))[corner_vertices(source.data)])
    target.data.shade_smooth()
    shown = corner_normals(target)
    transfer(source, target, "custom_normals")
    whole = corner_normals(target)
    give_normals(target, shown)
    transfer_objects(bpy.context, source, target, ["custom_normals"], Settings(factor=0.5))
    between = (shown + whole) / np.linalg.norm(shown + whole, axis=1, keepdims=True)
    assert degrees(corner_normals(target), between).max() < 0.5


def test_missing_mode_keeps_custom_normals_of_the_target(source, target):
    give_normals(source, bulging(positions(source.data))[corner_vertices(source.data)])
    target.data.shade_smooth()
    give_normals(target, np.tile([0, 0, 1.0], (len(target.data.loops), 1)))
    report = transfer_objects(bpy.context, source, target, ["custom_normals"], Settings(mode="missing"))
    assert report["skipped"]["custom normals"] == "the target has its own"
    assert degrees(corner_normals(target), np.array([[0, 0, 1.0]])).max() < 1
    target.data.attributes.remove(target.data.attributes["custom_normal"])
    transfer_objects(bpy.context, source, target, ["custom_normals"], Settings(mode="missing"))
    truth = bulging(positions(target.data))[corner_vertices(target.data)]
    assert np.median(degrees(corner_normals(target), truth)) < 1


def test_much_finer_target_keeps_normals_unless_requested_alone():
    coarse, fine = ellipsoid("Coarse", 3), ellipsoid("Fine", 5)
    give_normals(coarse, bulging(positions(coarse.data))[corner_vertices(coarse.data)])
    coarse.data.edges[3].use_seam = True
    activate(fine, coarse)
    report = transfer_objects(bpy.context, coarse, fine, ["edges", "custom_normals"], initial="nearest")
    assert "much finer" in report["skipped"]["custom normals"]
    assert report["written"]["custom_normals"] == []
    assert not fine.data.has_custom_normals
    report = transfer(coarse, fine, "custom_normals")
    assert report["written"]["custom_normals"] == ["custom_normal"]
    assert fine.data.has_custom_normals


def test_target_keeps_normals_if_source_has_none(source, target):
    source.data.edges[3].use_seam = True
    report = transfer(source, target, "edges", "custom_normals")
    assert report["written"]["custom_normals"] == []
    assert not target.data.has_custom_normals


# --- attributes of every type -------------------------------------------------------------------------------


def count_of(mesh, domain):
    return len({"POINT": mesh.vertices, "EDGE": mesh.edges, "FACE": mesh.polygons, "CORNER": mesh.loops}[domain])


def places_of(mesh, domain):
    """(count, 3) the centre of each element."""
    points = positions(mesh)
    if domain == "POINT":
        return points
    if domain == "EDGE":
        return points[ends(mesh)].mean(axis=1)
    if domain == "CORNER":
        return points[corner_vertices(mesh)]
    return np.array([polygon.center for polygon in mesh.polygons])


SMOOTH = {
    "FLOAT": lambda p: p[:, 0],
    "FLOAT2": lambda p: p[:, :2],
    "FLOAT_VECTOR": lambda p: p,
    "FLOAT_COLOR": lambda p: np.column_stack([p / 3 + 0.5, np.ones(len(p))]),
    "BYTE_COLOR": lambda p: np.column_stack([p / 3 + 0.5, np.ones(len(p))]),
    "QUATERNION": lambda p: np.column_stack([np.cos(p[:, 0]), np.sin(p[:, 0]), 0 * p[:, 0], 0 * p[:, 0]]),
    "FLOAT4X4": lambda p: np.column_stack(
        [np.tile([2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0], (len(p), 1)), p, np.ones(len(p))]
    ),
}
STEPPED = {
    "INT": lambda east: np.where(east, 70000, -3),
    "INT8": lambda east: np.where(east, 5, -5),
    "INT16_2D": lambda east: np.where(east[:, None], [300, 2], [1, -2]),
    "INT32_2D": lambda east: np.where(east[:, None], [70000, 2], [1, -2]),
    "BOOLEAN": lambda east: east,
}


def lacks(data_type):
    return data_type not in {item.identifier for item in bpy.types.Attribute.bl_rna.properties["data_type"].enum_items}


@pytest.mark.parametrize("domain", ["POINT", "EDGE", "FACE", "CORNER"])
@pytest.mark.parametrize("data_type", list(SMOOTH))
def test_numeric_attributes_of_every_type_are_interpolated(source, target, data_type, domain):
    if lacks(data_type):
        pytest.skip(f"this version has no {data_type}")
    add_attribute(source.data, "data", data_type, domain, SMOOTH[data_type](places_of(source.data, domain)))
    kinds = ("attributes", "color_attributes", "uv_maps")
    if domain == "EDGE" and data_type in ("QUATERNION", "FLOAT4X4"):
        report = transfer(source, target, *kinds)
        assert "cannot be transferred" in report["skipped"]["data"]
        return
    transfer(source, target, *kinds)
    assert (target.data.attributes["data"].data_type, target.data.attributes["data"].domain) == (data_type, domain)
    error = np.abs(values(target.data, "data") - SMOOTH[data_type](places_of(target.data, domain)))
    assert error.mean() < 0.01
    assert error.max() < 0.12


@pytest.mark.parametrize("domain", ["POINT", "EDGE", "FACE", "CORNER"])
@pytest.mark.parametrize("data_type", list(STEPPED))
def test_integer_attributes_of_every_type_use_majority_vote(source, target, data_type, domain):
    if lacks(data_type):
        pytest.skip(f"this version has no {data_type}")
    add_attribute(source.data, "data", data_type, domain, STEPPED[data_type](places_of(source.data, domain)[:, 0] > 0))
    transfer(source, target, "attributes")
    assert (target.data.attributes["data"].data_type, target.data.attributes["data"].domain) == (data_type, domain)
    expected = STEPPED[data_type](places_of(target.data, domain)[:, 0] > 0)
    right = (values(target.data, "data") == expected).reshape(len(expected), -1).all(axis=1)
    assert right.mean() > 0.97


@pytest.mark.parametrize("domain", ["POINT", "EDGE", "FACE", "CORNER"])
def test_strings_use_majority_vote(source, target, domain):
    words = np.where(places_of(source.data, domain)[:, 0] > 0, b"boot", b"glove")
    for element, word in zip(source.data.attributes.new("word", "STRING", domain).data, words.tolist(), strict=True):
        element.value = word
    source.data.update()
    transfer(source, target, "attributes")
    written = np.array([element.value for element in target.data.attributes["word"].data])
    expected = np.where(places_of(target.data, domain)[:, 0] > 0, b"boot", b"glove")
    assert (written == expected).mean() > 0.97


def test_named_vectors_rotate_with_the_mesh(source, target, monkeypatch):
    solved = []
    on = frames.frames_on
    monkeypatch.setattr(frames, "frames_on", lambda *given: solved.append(given) or on(*given))
    still = positions(target.data).astype(float)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    target.data.vertices.foreach_set("co", (still @ turn.T).ravel())
    target.data.update()
    keep_true_match(target, still)
    for name in ("flow", "plain"):
        add_attribute(source.data, name, "FLOAT_VECTOR", "POINT", bulging(positions(source.data)))
    missing = ["frame"] if lacks("FLOAT4X4") else []
    if not missing:
        matrices = np.tile(np.eye(4).ravel(), (len(source.data.vertices), 1))
        add_attribute(source.data, "frame", "FLOAT4X4", "POINT", matrices)
    add_attribute(source.data, "spin", "QUATERNION", "POINT", np.tile([1.0, 0, 0, 0], (len(source.data.vertices), 1)))
    add_attribute(source.data, "height", "FLOAT", "POINT", positions(source.data)[:, 2])
    settings = Settings(turning=("flow", "frame", "spin", "height"))
    report = transfer_objects(bpy.context, source, target, ["attributes"], settings)
    assert len(solved) == 1  # how the mesh rotates is worked out once for all of them
    assert [note.split(":")[0] for note in report["notes"] if "not rotated" in note] == [*missing, "height"]
    assert np.median(degrees(values(target.data, "plain"), bulging(still))) < 1
    assert np.median(degrees(values(target.data, "flow"), bulging(still) @ turn.T)) < 1
    quarter = np.tile([np.sqrt(0.5), 0, 0, np.sqrt(0.5)], (len(still), 1))
    assert np.abs(np.einsum("nx,nx->n", values(target.data, "spin"), quarter)).min() > 0.99
    if not missing:
        frame = np.array(target.data.attributes["frame"].data[7].value)
        np.testing.assert_allclose(frame[:3, :3], turn, atol=0.05)


def test_seams_are_marked_at_island_borders_of_transferred_uvs(source, target):
    layer = source.data.uv_layers.new(name="Atlas")
    uv = positions(source.data)[corner_vertices(source.data), :2] / 10
    upper = np.repeat(face_heights(source.data) > 0, [len(polygon.vertices) for polygon in source.data.polygons])
    layer.data.foreach_set("uv", np.ascontiguousarray(uv + 0.5 * upper[:, None], np.float32).ravel())
    report = transfer(source, target, "uv_maps", "edges")
    assert report["written"]["edges"] == []  # no mark of the source
    source.data.edges[0].use_seam = True  # anywhere: borders of islands need no marks
    report = transfer(source, target, "uv_maps", "edges")
    assert report["written"]["edges"] == ["seams"]
    assert any("Seams were marked where the islands of 'Atlas' meet" in note for note in report["notes"])
    bm = bmesh.new()
    bm.from_mesh(target.data)
    arrived = bm.loops.layers.uv["Atlas"]
    marked = 0
    for edge in bm.edges:
        one, other = edge.link_loops
        apart = (one[arrived].uv - other.link_loop_next[arrived].uv).length > 1e-4
        assert edge.seam == apart
        marked += apart
    assert marked > 10
    # The line between the islands is closed: every vertex on it has two of its edges, or more where it forks.
    assert all(sum(edge.seam for edge in vertex.link_edges) != 1 for vertex in bm.verts)
    bm.free()


def face_heights(mesh):
    array = np.empty(3 * len(mesh.polygons), np.float32)
    mesh.polygons.foreach_get("center", array)
    return array.reshape(-1, 3)[:, 2]
