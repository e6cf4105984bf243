# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers of points, without faces, as source and as target of every filter."""

import numpy as np
import pymeshlab
import pytest
from creature import SOURCE_POSE, TARGET_POSE, creature

import meshlab_filter
from meshlab_filter.mesh_data import add_layer, read_layer
from meshlab_filter.samples import SYMMETRIC, sample
from zoomout_core.mesh.point_cloud import PointCloud

pytestmark = pytest.mark.usefixtures("remember_matches")

SIZE = 14.2**0.5
SOURCE, TARGET = creature(0.12, SOURCE_POSE), creature(0.14, TARGET_POSE)


@pytest.fixture(scope="module")
def clouds():
    """Points as meshes 0 and 1, with the correspondence stored on mesh 1, and the target's faces as mesh 2."""
    ms = pymeshlab.MeshSet()
    ms.add_mesh(pymeshlab.Mesh(SOURCE.vertices, v_scalar_array=SOURCE.rest[:, 0]), "source")
    ms.apply_filter("compute_selection_by_condition_per_vertex", condselect="q > 0.5")
    ms.add_mesh(pymeshlab.Mesh(TARGET.vertices), "target")
    ms.add_mesh(TARGET.mesh(f_scalar_array=np.arange(len(TARGET.faces), dtype=float)), "faces")
    return ms, meshlab_filter.compute_correspondence_by_zoomout(ms)


def test_point_clouds_match_like_their_surfaces(clouds):
    ms, report = clouds
    place = np.column_stack([ms.mesh(1).vertex_custom_scalar_attribute_array(f"correspondence_{a}") for a in "xyz"])
    true = np.linalg.norm(SOURCE.rest[None] - TARGET.rest[:, None], axis=2).argmin(axis=1)
    assert np.median(np.linalg.norm(place - SOURCE.vertices[true], axis=1)) / SIZE < 0.02
    assert report["certainty"] > 0.5


def test_point_data_is_transferred_to_points(clouds):
    ms, _ = clouds
    report = meshlab_filter.transfer_attributes_by_zoomout(ms, correspondence="correspondence", selectiontransfer=True)
    new = ms.mesh(report["mesh_id"])
    assert set(report["transferred"]) == {"vertex_scalar", "vertex_selection"}
    assert new.is_point_cloud()
    np.testing.assert_array_equal(new.vertex_matrix(), TARGET.vertices)
    assert np.abs(new.vertex_scalar_array() - TARGET.rest[:, 0]).mean() / SIZE < 0.03
    assert np.mean(new.vertex_selection_array() == (TARGET.rest[:, 0] > 0.5)) > 0.95


def test_data_is_transferred_between_points_and_faces(clouds):
    """Faces receive from points; points receive the vertex data of faces, and a note on the rest."""
    ms, _ = clouds
    given = meshlab_filter.transfer_attributes_by_zoomout(ms, sourcemesh=0, targetmesh=2)
    made = given["mesh_id"]
    assert np.abs(ms.mesh(made).vertex_scalar_array() - TARGET.rest[:, 0]).mean() / SIZE < 0.03
    taken = meshlab_filter.transfer_attributes_by_zoomout(ms, sourcemesh=made, targetmesh=1, initial="proximity")
    assert taken["transferred"] == ["vertex_scalar"]
    assert "Layer 'target' has no faces, so face_scalar cannot be transferred to it." in taken["notes"]
    np.testing.assert_allclose(
        ms.mesh(taken["mesh_id"]).vertex_scalar_array(), ms.mesh(made).vertex_scalar_array(), atol=1e-6
    )


def test_points_are_coloured_measured_and_conformed(clouds):
    ms, _ = clouds
    meshlab_filter.compute_color_by_correspondence(ms)
    assert np.ptp(ms.mesh(1).vertex_color_matrix()[:, :3], axis=0).min() > 0.9
    error = meshlab_filter.compute_scalar_by_correspondence_error(ms)
    assert error["median"] / SIZE < 0.03
    bent = ms.mesh(meshlab_filter.apply_conform_by_zoomout(ms, correspondence="correspondence")["mesh_id"])
    assert bent.is_point_cloud()
    true = np.linalg.norm(SOURCE.rest[None] - TARGET.rest[:, None], axis=2).argmin(axis=1)
    assert np.linalg.norm(bent.vertex_matrix() - SOURCE.vertices[true], axis=1).mean() / SIZE < 0.03


def test_point_cloud_symmetry_has_left_and_right():
    made = sample(SYMMETRIC, 0.14, np.zeros(6))
    ms = pymeshlab.MeshSet()
    ms.add_mesh(pymeshlab.Mesh(made.vertices))
    side = meshlab_filter.compute_symmetry_by_zoomout(ms, left="y", detail="fast")["side"]
    clear = np.abs(made.rest[:, 1]) > 0.2
    assert np.mean((side > 0)[clear] == (made.rest[:, 1] > 0)[clear]) > 0.98


def test_point_normals_are_read_and_written(clouds):
    """Unit normals in the global frame; a cloud that is read and added is unchanged."""
    ms = pymeshlab.MeshSet()
    normals = np.random.default_rng(0).standard_normal((len(TARGET.vertices), 3))
    ms.add_mesh(pymeshlab.Mesh(TARGET.vertices, v_normals_matrix=normals), "points")
    turn = np.array([[0, -2.0, 0, 1], [2, 0, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]])
    ms.apply_filter("set_matrix", transformmatrix=turn, freeze=False)
    layer = read_layer(ms, 0)
    assert isinstance(layer.shape, PointCloud)
    expected = normals[:, [1, 0, 2]] * [-1, 1, 1] / np.linalg.norm(normals, axis=1)[:, None]
    np.testing.assert_allclose(layer.shape.normals, expected, atol=1e-6)
    assert read_layer(clouds[0], 1).shape.normals is None
    new = ms.mesh(add_layer(ms, layer))
    np.testing.assert_array_equal(new.vertex_matrix(), TARGET.vertices)
    np.testing.assert_allclose(new.vertex_normal_matrix(), normals, atol=1e-6)
    np.testing.assert_array_equal(new.transform_matrix(), turn)
