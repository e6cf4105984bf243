# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes are transferred to corresponding points of a mesh in another pose."""

import numpy as np
import pymeshlab
import pytest
from creature import (
    SOURCE_POSE,
    STRAIGHT,
    TARGET_POSE,
    chart_of,
    coordinates,
    creature,
    rest_of,
    write_textured_obj,
)
from mesh_set_state import everything

from meshlab_filter import compute_correspondence_by_zoomout, transfer_attributes_by_zoomout
from meshlab_filter.mesh_data import read_layer
from zoomout_core import Cancelled

pytestmark = pytest.mark.usefixtures("remember_matches")

# Errors in units of the square root of the area, as papers quote them.
SIZE = 14.2**0.5
# A vertex that is further off has another place's data.
WRONG_PLACE = 0.05


def colors(rest):
    return np.column_stack([0.5 + rest / 6, np.ones(len(rest))])


@pytest.fixture(scope="module")
def source():
    return creature(0.07, SOURCE_POSE)


@pytest.fixture(scope="module")
def target():
    return creature(0.09, TARGET_POSE)


@pytest.fixture(scope="module")
def coarse_source():
    return creature(0.15, SOURCE_POSE)


@pytest.fixture(scope="module")
def coarse_target():
    return creature(0.17, TARGET_POSE)


def mesh_set(source, target):
    """Mesh 0 has its rest positions as an attribute, and colours, scalars and selections derived from them."""
    ms = pymeshlab.MeshSet()
    faces = source.rest[source.faces].mean(axis=1)
    ms.add_mesh(
        source.mesh(
            v_color_matrix=colors(source.rest),
            f_color_matrix=colors(-faces),
            v_scalar_array=source.rest[:, 0],
            f_scalar_array=faces[:, 1],
        ),
        "source",
    )
    ms.add_mesh(target.mesh(), "target")
    ms.set_current_mesh(0)
    ms.apply_filter("compute_selection_by_condition_per_vertex", condselect="q > 0.5")
    ms.apply_filter("compute_selection_by_condition_per_face", condselect="fq > 0")
    ms.mesh(0).add_vertex_custom_point_attribute(source.rest, "rest")
    ms.mesh(0).add_face_custom_point_attribute(faces, "rest")
    ms.mesh(0).add_vertex_custom_scalar_attribute(source.rest[:, 2], "height")
    return ms


@pytest.fixture(scope="module")
def transferred(source, target):
    ms = mesh_set(source, target)
    report = transfer_attributes_by_zoomout(ms, selectiontransfer=True, customattributes=["rest", "height"])
    return ms, report


def test_vertex_data_is_accurate(transferred, target):
    ms, report = transferred
    new = ms.mesh(report["mesh_id"])
    error = np.linalg.norm(new.vertex_custom_point_attribute_matrix("rest") - target.rest, axis=1) / SIZE
    assert error.mean() < 0.015
    assert np.mean(error > WRONG_PLACE) < 0.015
    assert np.abs(new.vertex_custom_scalar_attribute_array("height") - target.rest[:, 2]).mean() / SIZE < 0.01
    assert np.abs(new.vertex_scalar_array() - target.rest[:, 0]).mean() / SIZE < 0.01
    assert np.abs(new.vertex_color_matrix() - colors(target.rest)).mean() < 0.01


def test_face_data_is_accurate(transferred, target):
    ms, report = transferred
    new, middle = ms.mesh(report["mesh_id"]), target.rest[target.faces].mean(axis=1)
    error = np.linalg.norm(new.face_custom_point_attribute_matrix("rest") - middle, axis=1) / SIZE
    assert error.mean() < 0.015
    assert np.abs(new.face_scalar_array() - middle[:, 1]).mean() / SIZE < 0.01
    assert np.abs(new.face_color_matrix() - colors(-middle)).mean() < 0.01


def test_selections_keep_their_outline(transferred, target):
    ms, report = transferred
    new, middle = ms.mesh(report["mesh_id"]), target.rest[target.faces].mean(axis=1)
    assert np.mean(new.vertex_selection_array() == (target.rest[:, 0] > 0.5)) > 0.97
    assert np.mean(new.face_selection_array() == (middle[:, 1] > 0)) > 0.95


def test_transfer_misplaces_far_fewer_vertices_than_closest_point(transferred, source, target):
    ms, report = transferred
    ours = ms.mesh(report["mesh_id"]).vertex_custom_point_attribute_matrix("rest")
    theirs = np.empty_like(ours)
    for axis in range(3):  # the filter transfers one scalar
        pair = pymeshlab.MeshSet()
        pair.add_mesh(source.mesh(v_scalar_array=source.rest[:, axis]))
        pair.add_mesh(target.mesh())
        pair.apply_filter(
            "transfer_attributes_per_vertex",
            sourcemesh=0,
            targetmesh=1,
            colortransfer=False,
            qualitytransfer=True,
            upperbound=pymeshlab.PercentageValue(100),
        )
        theirs[:, axis] = pair.mesh(1).vertex_scalar_array()
    error, their_error = (np.linalg.norm(found - target.rest, axis=1) / SIZE for found in (ours, theirs))
    assert np.mean(their_error > WRONG_PLACE) > 0.2
    assert np.mean(error > WRONG_PLACE) < 0.05 * np.mean(their_error > WRONG_PLACE)
    assert error.mean() < 0.3 * their_error.mean()


def test_report_and_new_layer_describe_the_transfer(transferred, target):
    ms, report = transferred
    new = ms.mesh(report["mesh_id"])
    assert ms.mesh_number() == 3
    assert ms.current_mesh_id() == report["mesh_id"]
    assert new.label() == "target_transferred"
    np.testing.assert_array_equal(new.vertex_matrix(), target.vertices)
    np.testing.assert_array_equal(new.face_matrix(), target.faces)
    names = {"vertex_color", "face_color", "vertex_scalar", "face_scalar", "vertex_selection", "face_selection"}
    assert set(report["transferred"]) == {*names, "rest", "height"}
    assert report["confidence"].shape == (len(target.rest),)
    assert report["confidence"].min() >= 0
    assert report["confidence"].max() <= 1
    assert {"origin", "reverses_orientation", "total"} <= set(report["candidates"][0])


SWITCHES = {
    "texcoordtransfer": {"texcoord"},
    "colortransfer": {"vertex_color", "face_color"},
    "qualitytransfer": {"vertex_scalar", "face_scalar"},
    "normaltransfer": {"vertex_normal"},
    "selectiontransfer": {"vertex_selection", "face_selection"},
}


def test_empty_source_selection_clears_target_selection(coarse_source, coarse_target):
    ms = pymeshlab.MeshSet()
    ms.add_mesh(coarse_source.mesh(), "source")
    ms.add_mesh(coarse_target.mesh(), "target")
    ms.apply_filter("set_selection_all")
    report = transfer_attributes_by_zoomout(
        ms, selectiontransfer=True, texcoordtransfer=False, initial="proximity", detail="fast"
    )
    assert set(report["transferred"]) == SWITCHES["selectiontransfer"]
    new = ms.mesh(report["mesh_id"])
    assert new.selected_vertex_number() == new.selected_face_number() == 0
    assert ms.mesh(1).selected_vertex_number() == len(coarse_target.vertices)


@pytest.fixture(scope="module")
def rich(tmp_path_factory, coarse_source, coarse_target):
    """Mesh 0 has data for every switch, and mesh 1 a correspondence."""
    folder = tmp_path_factory.mktemp("rich")
    write_textured_obj(folder, coarse_source)
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(folder / "creature.obj"))
    ms.apply_filter("compute_color_by_function_per_vertex", x="127+127*sin(vi)", y="17", z="0", a="255")
    ms.apply_filter("compute_color_by_function_per_face", r="127+127*sin(fi)", g="17", b="0", a="255")
    ms.apply_filter("compute_scalar_by_function_per_vertex", q="vi")
    ms.apply_filter("compute_scalar_by_function_per_face", q="fi")
    ms.apply_filter("compute_selection_by_condition_per_vertex", condselect="x>0.5")
    ms.apply_filter("compute_selection_by_condition_per_face", condselect="x0>0.5")
    ms.add_mesh(coarse_target.mesh(), "target")
    compute_correspondence_by_zoomout(ms)
    return ms


@pytest.mark.parametrize("switch", SWITCHES)
def test_each_switch_transfers_only_its_data(rich, switch):
    switches = {name: name == switch for name in SWITCHES}
    report = transfer_attributes_by_zoomout(rich, correspondence="correspondence", **switches)
    assert set(report["transferred"]) == SWITCHES[switch]


def test_source_and_target_are_unchanged(coarse_source, coarse_target):
    ms = mesh_set(coarse_source, coarse_target)
    before = everything(ms)
    transfer_attributes_by_zoomout(ms, qualitytransfer=False)
    ms.delete_current_mesh()
    ms.set_current_mesh(0)
    assert everything(ms) == before


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"sourcemesh": 5}, "no mesh 5"),
        ({"sourcemesh": 1, "targetmesh": 0}, "'target' has none of the attributes"),
        ({"customattributes": ["nothing"]}, "no custom attribute 'nothing'"),
        ({"customattributes": "height, nothing"}, "no custom attribute 'nothing'"),
        ({"initial": "landmarks"}, "landmarks"),
        ({"landmarks": ([0, 1], [0, 10**6]), "initial": "landmarks"}, "target"),
        ({"initial": "proximity", "candidate": 3}, "candidate 3"),
        ({"targetmesh": 2}, "too few"),
        ({"targetmesh": 3}, "too small"),
    ],
)
def test_failure_is_one_sentence_and_changes_nothing(coarse_source, coarse_target, arguments, sentence):
    ms = mesh_set(coarse_source, coarse_target)
    ms.add_mesh(pymeshlab.Mesh(np.eye(3), np.array([[0, 1, 2]])), "small")
    ms.add_mesh(pymeshlab.Mesh(np.eye(3)), "points")
    ms.set_current_mesh(1)
    before = everything(ms)
    with pytest.raises(ValueError, match=sentence) as refusal:
        transfer_attributes_by_zoomout(ms, **arguments)
    assert "\n" not in str(refusal.value)
    assert everything(ms) == before


def test_cancelled_transfer_changes_nothing(coarse_source, coarse_target):
    ms = mesh_set(coarse_source, coarse_target)
    before = everything(ms)
    fractions = []

    def give_up(fraction, _stage):
        fractions.append(fraction)
        if fraction > 0.8:
            raise Cancelled

    with pytest.raises(Cancelled):
        transfer_attributes_by_zoomout(ms, callback=give_up)
    assert everything(ms) == before
    assert fractions == sorted(fractions)


def test_disabled_kinds_keep_target_data(source, target):
    ms = mesh_set(source, target)
    ms.add_mesh(target.mesh(v_color_matrix=colors(-target.rest), v_scalar_array=target.rest[:, 2]), "coloured")
    report = transfer_attributes_by_zoomout(ms, targetmesh=2, colortransfer=False)
    new, old = ms.mesh(report["mesh_id"]), ms.mesh(2)
    assert set(report["transferred"]) == {"vertex_scalar", "face_scalar"}
    np.testing.assert_array_equal(new.vertex_color_matrix(), old.vertex_color_matrix())
    assert np.abs(new.vertex_scalar_array() - target.rest[:, 0]).mean() / SIZE < 0.01


def test_proximity_uses_layer_transforms(source, target):
    """Their own coordinates are far apart, but their transforms move them over each other."""
    ms = pymeshlab.MeshSet()
    resting = creature(0.09, SOURCE_POSE)
    transform = np.array([[0, -1e-2, 0, 5], [1e-2, 0, 0, -3], [0, 0, 1e-2, 1], [0, 0, 0, 1]])
    ms.add_mesh(source.mesh(v_scalar_array=source.rest[:, 0]))
    away = np.linalg.inv(transform)
    ms.add_mesh(pymeshlab.Mesh(resting.vertices @ away[:3, :3].T + away[:3, 3], resting.faces))
    ms.apply_filter("set_matrix", transformmatrix=transform, freeze=False)
    report = transfer_attributes_by_zoomout(ms, initial="proximity")
    new = ms.mesh(report["mesh_id"])
    assert np.abs(new.vertex_scalar_array() - resting.rest[:, 0]).mean() / SIZE < 0.01
    np.testing.assert_allclose(new.transform_matrix(), transform)
    np.testing.assert_array_equal(new.vertex_matrix(), ms.mesh(1).vertex_matrix())


@pytest.mark.slow
def test_landmarks_and_initial_map_reach_the_matching(source, target):
    ms = mesh_set(source, target)
    places = np.array([[1.9, 0.6, 0.7], [0.7, 2.1, 0.1], [0.4, -1.7, -0.1], [-1.7, 1.5, 0], [-2.3, -0.7, 0.3]])
    ids = [np.argmin(np.linalg.norm(made.rest[:, None] - places, axis=2), axis=0) for made in (source, target)]
    report = transfer_attributes_by_zoomout(ms, initial="landmarks", landmarks=tuple(ids))
    assert "landmarks" in report["candidates"][0]
    assert np.abs(ms.current_mesh().vertex_scalar_array() - target.rest[:, 0]).mean() / SIZE < 0.015
    nearest = np.argmin(np.linalg.norm(source.rest[None] - target.rest[:, None], axis=2), axis=1)
    report = transfer_attributes_by_zoomout(ms, initial="given", initial_map=nearest)
    assert len(report["candidates"]) == 1
    assert np.abs(ms.current_mesh().vertex_scalar_array() - target.rest[:, 0]).mean() / SIZE < 0.015


@pytest.fixture(scope="module")
def textured(tmp_path_factory, source, target):
    folder = tmp_path_factory.mktemp("textured")
    write_textured_obj(folder, source)
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(folder / "creature.obj"))
    ms.add_mesh(target.mesh(), "target")
    return ms, transfer_attributes_by_zoomout(ms)


def charts(ms, mesh_id):
    """Whether each face's corners are in the upper chart (m, 3), and the name of its texture (m,)."""
    uv = ms.mesh(mesh_id).wedge_tex_coord_matrix().reshape(-1, 3, 2)
    ms.set_current_mesh(mesh_id)
    ms.apply_filter("generate_copy_of_current_mesh")
    ms.apply_filter("compute_scalar_by_function_per_face", q="ti")
    names = np.array(texture_names(ms))
    return uv[:, :, 0] > 0.5, names[ms.current_mesh().face_scalar_array().astype(int)]


def texture_names(ms):
    """The textures' names in order, identified by the widths of the images."""
    mesh = ms.current_mesh()
    name_of = {image.width(): name for name, image in mesh.textures().items()}
    return [name_of[mesh.texture(number).width()] for number in range(mesh.texture_number())]


def test_each_face_lies_in_one_chart_and_has_its_texture(textured, target):
    ms, report = textured
    upper, texture = charts(ms, report["mesh_id"])
    assert (upper == upper[:, :1]).all()
    true_upper, true_texture = chart_of(target.rest[target.faces].mean(axis=1))
    assert np.mean(upper[:, 0] == true_upper) > 0.95
    assert np.mean(texture == np.array(["front.png", "back.png"])[true_texture]) > 0.98


def test_parts_of_a_layer_are_named_by_its_textures(textured):
    ms, _ = textured
    assert [part.label for part in read_layer(ms, 0).parts.names] == ["back.png", "front.bmp"]
    assert {part.label for part in read_layer(ms, 1).parts.names} == {"part 0"}


def test_texture_coordinates_are_accurate(textured, target):
    ms, report = textured
    uv = ms.mesh(report["mesh_id"]).wedge_tex_coord_matrix()
    error = np.linalg.norm(rest_of(uv) - target.rest[target.faces.ravel(), :2], axis=1) / SIZE
    assert error.mean() < 0.015
    assert np.mean(error > WRONG_PLACE) < 0.015


def test_a_textured_result_can_be_saved_and_loaded(textured, tmp_path):
    ms, report = textured
    for name in ("a.ply", "a.obj"):
        ms.set_current_mesh(report["mesh_id"])
        ms.save_current_mesh(str(tmp_path / name))
        again = pymeshlab.MeshSet()
        again.load_new_mesh(str(tmp_path / name))
        assert sorted(again.mesh(0).textures()) == ["back.png", "front.png"]
        old_upper, old_texture = charts(ms, report["mesh_id"])
        new_upper, new_texture = charts(again, 0)
        np.testing.assert_array_equal(new_upper, old_upper)
        np.testing.assert_array_equal(new_texture, old_texture)


def test_textures_of_the_target_stay_where_the_source_has_none(tmp_path, coarse_source, coarse_target):
    write_textured_obj(tmp_path, coarse_target)
    ms = pymeshlab.MeshSet()
    ms.add_mesh(coarse_source.mesh(v_color_matrix=colors(coarse_source.rest)))
    ms.load_new_mesh(str(tmp_path / "creature.obj"))
    report = transfer_attributes_by_zoomout(ms)
    uv = ms.mesh(report["mesh_id"]).wedge_tex_coord_matrix()
    upper, texture = chart_of(coarse_target.rest[coarse_target.faces].mean(axis=1))
    np.testing.assert_allclose(
        uv, coordinates(coarse_target.rest[coarse_target.faces.ravel()], np.repeat(upper, 3)), atol=1e-6
    )
    np.testing.assert_array_equal(charts(ms, report["mesh_id"])[1], np.array(["front.png", "back.png"])[texture])


def test_images_that_are_missing_are_reported(tmp_path, coarse_source, coarse_target):
    write_textured_obj(tmp_path, coarse_source)
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(tmp_path / "creature.obj"))
    copied = pymeshlab.MeshSet()
    copied.add_mesh(ms.mesh(0))  # pymeshlab does not copy images
    copied.add_mesh(coarse_target.mesh())
    assert any(
        "no image for front.bmp and back.png" in note for note in transfer_attributes_by_zoomout(copied)["notes"]
    )
    (tmp_path / "back.png").unlink()
    unread = pymeshlab.MeshSet()
    unread.load_new_mesh(str(tmp_path / "creature.obj"))
    unread.add_mesh(coarse_target.mesh())
    assert any(
        "could not read 1 of the texture images" in note for note in transfer_attributes_by_zoomout(unread)["notes"]
    )


def test_polygons_that_become_triangles_are_reported(tmp_path, coarse_source, coarse_target):
    write_textured_obj(tmp_path, coarse_source)
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(tmp_path / "creature.obj"))
    ms.add_mesh(creature(0.17, STRAIGHT).mesh())
    ms.apply_filter("meshing_tri_to_quad_by_smart_triangle_pairing")
    assert any("Polygons became triangles" in note for note in transfer_attributes_by_zoomout(ms)["notes"])
