# SPDX-License-Identifier: GPL-3.0-or-later
"""Filters by their names, their results, and what they refuse."""

import inspect

import numpy as np
import pymeshlab
import pytest
from creature import SOURCE_POSE, TARGET_POSE, creature
from mesh_set_state import everything

import meshlab_filter
from meshlab_filter import apply_filter, filter_list, print_filter_list, print_filter_parameter_list, search
from meshlab_filter.catalogue import CATALOGUE, meaning
from meshlab_filter.mesh_data import custom_names

pytestmark = pytest.mark.usefixtures("remember_matches")

SIZE = 14.2**0.5


@pytest.fixture(scope="module")
def source():
    return creature(0.12, SOURCE_POSE)


@pytest.fixture(scope="module")
def target():
    return creature(0.14, TARGET_POSE)


@pytest.fixture
def pair(source, target):
    """Meshes 0 and 1 without any attributes."""
    ms = pymeshlab.MeshSet()
    ms.add_mesh(source.mesh(), "source")
    ms.add_mesh(target.mesh(), "target")
    return ms


@pytest.fixture(scope="module")
def found(source, target):
    """A pair with a correspondence, the true vertices, and the filter's results; tests must not change it."""
    ms = pymeshlab.MeshSet()
    ms.add_mesh(source.mesh(v_scalar_array=source.rest[:, 0]), "source")
    ms.add_mesh(target.mesh(), "target")
    return ms, meshlab_filter.compute_correspondence_by_zoomout(ms)


def copy_of(ms):
    """Another MeshSet with the same meshes and the same custom attributes of vertices."""
    copied = pymeshlab.MeshSet()
    for number in range(ms.mesh_number()):
        mesh = ms.mesh(number)
        copied.add_mesh(pymeshlab.Mesh(mesh.vertex_matrix(), mesh.face_matrix()), mesh.label())
        for name in custom_names(ms, number):
            if name.endswith("barycentric"):
                values = mesh.vertex_custom_point_attribute_matrix(name)
                copied.mesh(number).add_vertex_custom_point_attribute(values, name)
            else:
                values = mesh.vertex_custom_scalar_attribute_array(name)
                copied.mesh(number).add_vertex_custom_scalar_attribute(values, name)
    return copied


def test_every_filter_is_listed_and_is_a_function_of_the_package():
    assert set(CATALOGUE) <= set(filter_list())
    assert "meshing_close_holes" in filter_list()
    for name, row in CATALOGUE.items():
        function = getattr(meshlab_filter, name)
        assert function.row is row
        assert list(inspect.signature(function).parameters) == ["ms", *(p.name for p in row.parameters), "callback"]
        assert all(f"{p.name}: {p.meaning}" in function.__doc__ for p in row.parameters)


def test_search_finds_filters_by_words_in_names_and_parameters(capsys):
    found = search("TEXTURE transfer")
    assert "transfer_attributes_by_zoomout" in found  # a parameter names textures
    assert "transfer_texture_to_color_per_vertex" in found
    assert search("close holes") == ["meshing_close_holes"]
    assert search("nothing_like_it") == []
    print_filter_list("symmetry pose")
    assert capsys.readouterr().out == f"compute_symmetry_by_zoomout: {meaning('compute_symmetry_by_zoomout')}\n"
    print_filter_list()
    assert [line.partition(":")[0] for line in capsys.readouterr().out.splitlines()] == list(CATALOGUE)


def test_callback_receives_progress_and_can_cancel(pair):
    told = []
    meshlab_filter.compute_correspondence_by_zoomout(
        pair, detail="fast", callback=lambda fraction, stage: told.append((fraction, stage))
    )
    fractions = [fraction for fraction, _ in told]
    assert len(fractions) > 10
    assert fractions == sorted(fractions)
    assert all(stage for _, stage in told)
    told.clear()
    apply_filter(pair, "create_sphere", callback=lambda *progress: told.append(progress))
    assert told == [(0.0, "create_sphere"), (1.0, "create_sphere")]
    before = everything(pair)

    def stop(fraction, _stage):
        if fraction > 0.5:
            raise KeyboardInterrupt

    for give_up in (apply_filter, lambda ms, name, **options: getattr(meshlab_filter, name)(ms, **options)):
        with pytest.raises(KeyboardInterrupt):
            give_up(pair, "apply_conform_by_zoomout", detail="fast", callback=stop)
    assert everything(pair) == before


@pytest.mark.parametrize("name", CATALOGUE)
def test_parameters_are_printed_with_type_default_and_meaning(name, capsys):
    print_filter_parameter_list(name)
    printed = capsys.readouterr().out
    for parameter in CATALOGUE[name].parameters:
        assert f"\t{parameter.name} : {parameter.type.label} = " in printed
        assert parameter.meaning in printed


def test_the_parameters_of_native_filters_are_printed_by_pymeshlab(capfd):
    print_filter_parameter_list("create_sphere")
    assert "subdiv : int = 3" in capfd.readouterr().out


def test_native_filters_are_handed_to_pymeshlab(pair):
    area = apply_filter(pair, "get_geometric_measures")["surface_area"]
    assert area == pytest.approx(SIZE**2, rel=0.1)
    apply_filter(pair, "meshing_decimation_quadric_edge_collapse", targetfacenum=100)
    assert pair.current_mesh().face_number() <= 100


def test_a_correspondence_is_stored_on_the_target(found, source, target):
    ms, report = found
    mesh = ms.mesh(1)
    assert ms.mesh_number() == 2
    np.testing.assert_array_equal(
        mesh.vertex_custom_scalar_attribute_array("correspondence_triangle"), report["triangle"]
    )
    np.testing.assert_array_equal(
        mesh.vertex_custom_scalar_attribute_array("correspondence_confidence"), report["confidence"]
    )
    np.testing.assert_array_equal(
        mesh.vertex_custom_scalar_attribute_array("correspondence_has_partner"), report["has_partner"]
    )
    assert report["source_has_partner"].shape == (len(source.rest),)
    assert 0 <= report["share_without_partner"] < 0.05
    rest = np.einsum("nc,ncx->nx", report["barycentric"], source.rest[source.faces[report["triangle"]]])
    assert np.linalg.norm(rest - target.rest, axis=1).mean() / SIZE < 0.03
    place = np.einsum("nc,ncx->nx", report["barycentric"], source.vertices[source.faces[report["triangle"]]])
    for i, axis in enumerate("xyz"):
        stored = mesh.vertex_custom_scalar_attribute_array(f"correspondence_{axis}")
        np.testing.assert_allclose(stored, place[:, i], atol=1e-12)
    assert 0 <= report["certainty"] <= 1
    assert {"origin", "reverses_orientation", "total"} <= set(report["candidates"][0])
    with pytest.raises(ValueError, match="already has an attribute 'correspondence_triangle'"):
        meshlab_filter.compute_correspondence_by_zoomout(ms)


def test_a_stored_correspondence_transfers_as_a_new_one_does(found):
    ms, report = found
    old = meshlab_filter.transfer_attributes_by_zoomout(ms, correspondence="correspondence")
    new = meshlab_filter.transfer_attributes_by_zoomout(ms)
    for first, second in ((old, new),):
        np.testing.assert_allclose(
            ms.mesh(first["mesh_id"]).vertex_scalar_array(), ms.mesh(second["mesh_id"]).vertex_scalar_array(), atol=1e-9
        )
    np.testing.assert_array_equal(old["confidence"], report["confidence"])
    assert "correspondence_triangle" in custom_names(ms, old["mesh_id"])


def test_a_correspondence_with_another_source_is_refused(found):
    copied = copy_of(found[0])
    copied.set_current_mesh(0)
    copied.apply_filter("compute_coord_by_function", x="x+0.1", y="y", z="z")
    with pytest.raises(ValueError, match="belongs to a different source than 'source'"):
        meshlab_filter.compute_color_by_correspondence(copied)


def test_corresponding_points_get_equal_colours(found, source):
    ms, report = found
    copied = copy_of(ms)
    copied.set_current_mesh(0)
    meshlab_filter.compute_color_by_correspondence(copied)
    assert copied.current_mesh_id() == 0
    place = (source.vertices - source.vertices.min(axis=0)) / np.ptp(source.vertices, axis=0)
    colors = copied.mesh(0).vertex_color_matrix()
    np.testing.assert_allclose(colors[:, :3], place, atol=0.5001 / 255)
    expected = np.einsum("nc,ncx->nx", report["barycentric"], place[source.faces[report["triangle"]]])
    np.testing.assert_allclose(copied.mesh(1).vertex_color_matrix()[:, :3], expected, atol=0.5001 / 255)


def test_error_is_the_distance_to_the_truth(found, source, target):
    ms, report = found
    copied = copy_of(ms)
    true = np.argmin(np.linalg.norm(source.rest[None] - target.rest[:, None], axis=2), axis=1)
    copied.mesh(1).add_vertex_custom_scalar_attribute(true.astype(float), "true")
    said = meshlab_filter.compute_scalar_by_correspondence_error(
        copied, truth="true", selectabove=pymeshlab.PercentageValue(2)
    )
    image = np.einsum("nc,ncx->nx", report["barycentric"], source.vertices[source.faces[report["triangle"]]])
    error = np.linalg.norm(image - source.vertices[true], axis=1)
    np.testing.assert_allclose(said["error"], error, atol=1e-9)
    np.testing.assert_allclose(copied.mesh(1).vertex_scalar_array(), error, atol=1e-9)
    diagonal = np.linalg.norm(np.ptp(target.vertices, axis=0))
    selected = copied.mesh(1).vertex_selection_array()
    np.testing.assert_array_equal(selected, error > 0.02 * diagonal)
    assert selected.any()
    assert said["median"] <= said["percentile_95"]
    with pytest.raises(ValueError, match="attribute 'correspondence_confidence'"):
        meshlab_filter.compute_scalar_by_correspondence_error(copied, truth="correspondence_confidence", name="other")


def test_inverse_map_reveals_wrong_vertices(found, target):
    """One limb's tip gets the images of another's."""
    copied = copy_of(found[0])
    mesh = copied.mesh(1)
    tip = target.rest[:, 1] > 1.5
    spoilt = {}
    for part in ("triangle", "x", "y", "z", "confidence"):
        spoilt[part] = mesh.vertex_custom_scalar_attribute_array(f"correspondence_{part}")
    spoilt["barycentric"] = mesh.vertex_custom_point_attribute_matrix("correspondence_barycentric")
    elsewhere = np.argmin(target.rest[:, 1])
    for values in spoilt.values():
        values[tip] = values[elsewhere]
    for part, values in spoilt.items():
        add = mesh.add_vertex_custom_scalar_attribute if values.ndim == 1 else mesh.add_vertex_custom_point_attribute
        add(values, f"spoilt_{part}")
    error = meshlab_filter.compute_scalar_by_correspondence_error(copied, correspondence="spoilt")["error"]
    assert np.median(error[tip]) / SIZE > 0.3
    assert np.median(error[~tip]) / SIZE < 0.05


def test_eigenfunctions_become_attributes_and_quality(pair, target):
    said = meshlab_filter.compute_laplacian_eigenfunctions(pair, functions=6, show=2)
    assert said["eigenvalues"].shape == (6,)
    assert said["eigenvalues"][0] == pytest.approx(0, abs=1e-6)
    assert (np.diff(said["eigenvalues"]) > 0).all()
    mesh = pair.current_mesh()
    second = mesh.vertex_custom_scalar_attribute_array("eigenfunction_2")
    np.testing.assert_array_equal(mesh.vertex_scalar_array(), second)
    assert np.ptp(mesh.vertex_custom_scalar_attribute_array("eigenfunction_0")) < 1e-3 * np.ptp(second)
    assert not pair.mesh(0).vertex_scalar_array().any()
    before = everything(pair)
    with pytest.raises(ValueError, match="already has an attribute 'eigenfunction_0'"):
        meshlab_filter.compute_laplacian_eigenfunctions(pair)
    assert everything(pair) == before


def test_point_cloud_eigenfunctions_equal_those_of_the_surface():
    made = creature(0.08, TARGET_POSE)
    said, quality = [], []
    for mesh in (made.mesh(), pymeshlab.Mesh(made.vertices)):
        ms = pymeshlab.MeshSet()
        ms.add_mesh(mesh)
        said.append(meshlab_filter.compute_laplacian_eigenfunctions(ms, functions=6)["eigenvalues"])
        quality.append(ms.current_mesh().vertex_scalar_array())
    np.testing.assert_allclose(said[1][1:], said[0][1:], rtol=0.03)
    assert abs(np.corrcoef(*quality)[0, 1]) > 0.99


def test_conform_gives_target_the_shape_of_source(found, source, target):
    copied = copy_of(found[0])
    conformed = meshlab_filter.apply_conform_by_zoomout(copied, correspondence="correspondence")
    mesh = copied.mesh(conformed["mesh_id"])
    assert mesh.label() == "target_conformed"
    np.testing.assert_array_equal(mesh.face_matrix(), target.faces)
    true = np.argmin(np.linalg.norm(source.rest[None] - target.rest[:, None], axis=2), axis=1)
    off = np.linalg.norm(mesh.vertex_matrix() - source.vertices[true], axis=1) / SIZE
    before = np.linalg.norm(target.vertices - source.vertices[true], axis=1) / SIZE
    assert np.mean(off) < 0.2 * np.mean(before)
    np.testing.assert_array_equal(copied.mesh(1).vertex_matrix(), target.vertices)


def test_normals_turn_with_the_surface(found, target):
    """The pose rotates the limbs: transferred normals are the target's own, not the source's."""
    copied = copy_of(found[0])
    turn = np.array([[0, -2.0, 0, 1], [2, 0, 0, 1 / 3], [0, 0, 2, 0], [0, 0, 0, 1]])
    away = pymeshlab.Mesh((target.vertices - turn[:3, 3]) @ np.linalg.inv(turn[:3, :3]).T, target.faces)
    copied.add_mesh(away, "turned")
    copied.apply_filter("set_matrix", transformmatrix=turn, freeze=False)
    copied.apply_filter("compute_normal_per_vertex")
    own = copied.current_mesh().vertex_normal_matrix()
    turned = copied.current_mesh_id()
    report = meshlab_filter.transfer_attributes_by_zoomout(copied, targetmesh=turned, normaltransfer=True)
    assert report["transferred"] == ["vertex_normal"]
    normals = copied.mesh(report["mesh_id"]).vertex_normal_matrix()
    cosine = (normals * own).sum(axis=1) / np.linalg.norm(normals, axis=1) / np.linalg.norm(own, axis=1)
    assert np.median(cosine) > 0.97


@pytest.mark.slow
def test_symmetry_distinguishes_left_from_right():
    """An ellipsoid with a head, whose left is +y."""
    ms = pymeshlab.MeshSet()
    ms.create_sphere(subdiv=4)
    ms.apply_filter("compute_coord_by_function", x="x*2+0.6*exp(0-8*((x-0.7)^2+z^2))*z", y="y*1.1", z="z*0.7+0.5*x*x")
    said = meshlab_filter.compute_symmetry_by_zoomout(ms, left="y", detail="fast", colorsides=True)
    mesh = ms.current_mesh()
    place = mesh.vertex_matrix()
    assert said["candidates"][0]["reverses_orientation"]
    clear = np.abs(place[:, 1]) > 0.2
    assert np.mean((said["side"] > 0)[clear] == (place[:, 1] > 0)[clear]) > 0.98
    np.testing.assert_array_equal(mesh.vertex_scalar_array(), said["side"])
    red, _, blue, _ = mesh.vertex_color_matrix().T
    np.testing.assert_array_equal(red > blue, said["side"] > 0)
    np.testing.assert_array_equal(red < blue, said["side"] < 0)
    image = np.column_stack([mesh.vertex_custom_scalar_attribute_array(f"symmetry_{axis}") for axis in "xyz"])
    assert np.linalg.norm(image - place * [1, -1, 1], axis=1).mean() < 0.1
    with pytest.raises(ValueError, match="already has an attribute 'symmetry_triangle'"):
        meshlab_filter.compute_symmetry_by_zoomout(ms)
    other = meshlab_filter.compute_symmetry_by_zoomout(ms, left="-y", detail="fast", name="other")
    np.testing.assert_array_equal(other["side"], -said["side"])
    np.testing.assert_array_equal(mesh.vertex_custom_scalar_attribute_array("other_side"), other["side"])
    before = everything(ms)
    with pytest.raises(ValueError, match="no candidate 99"):
        meshlab_filter.compute_symmetry_by_zoomout(ms, candidate=99, detail="fast", name="third")
    assert everything(ms) == before
