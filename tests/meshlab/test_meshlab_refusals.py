# SPDX-License-Identifier: GPL-3.0-or-later
"""Filters refuse bad input in a sentence that says what to do, without changing the MeshSet."""

import numpy as np
import pymeshlab
import pytest
from creature import SOURCE_POSE, TARGET_POSE, creature, write_textured_obj
from mesh_set_state import everything

import meshlab_filter
import zoomout_core as zo
from meshlab_filter import apply_filter
from meshlab_filter.catalogue import CATALOGUE
from meshlab_filter.parameters import CHOICE, COUNT, DATA, LENGTH, MESH, NAMES, SWITCH, TEXT
from zoomout_core.matching.presets import DETAIL
from zoomout_core.mesh.errors import MeshError

pytestmark = pytest.mark.usefixtures("remember_matches")

BY_PAIR = [name for name, row in CATALOGUE.items() if row.parameters[0].name == "sourcemesh"]
OF_CURRENT = [name for name in CATALOGUE if name not in BY_PAIR]
BY_STORED = ["compute_color_by_correspondence", "compute_scalar_by_correspondence_error"]
# Values that are not of a parameter's type.
WRONG = {
    MESH: (0.5, True, "0"),
    COUNT: (-1, 0.5, True),
    SWITCH: (1, "true"),
    TEXT: (5, None),
    NAMES: (3, [3]),
    CHOICE: ("magic", 0),
    LENGTH: (3, "3%"),
    DATA: (True, 5.0),
}


@pytest.fixture(scope="module")
def shapes():
    return creature(0.12, SOURCE_POSE), creature(0.14, TARGET_POSE)


@pytest.fixture
def pair(shapes):
    """Meshes 0 and 1 without any attributes but a scalar of the source."""
    source, target = shapes
    ms = pymeshlab.MeshSet()
    ms.add_mesh(source.mesh(v_scalar_array=source.rest[:, 0]), "source")
    ms.add_mesh(target.mesh(), "target")
    return ms


@pytest.fixture
def odd(pair):
    """The pair, points as mesh 2, a mesh without vertices as mesh 3, and a single triangle as mesh 4."""
    pair.add_mesh(pymeshlab.Mesh(np.eye(3)), "points")
    pair.add_mesh(pymeshlab.Mesh(np.eye(3), np.array([[0, 1, 2]])), "empty")
    pair.apply_filter("set_selection_all")
    pair.apply_filter("meshing_remove_selected_vertices_and_faces")
    pair.add_mesh(pymeshlab.Mesh(np.eye(3), np.array([[0, 1, 2]])), "triangle")
    return pair


def check_refusal(ms, sentence, name, /, **parameters):
    before = everything(ms)
    with pytest.raises((ValueError, OSError), match=sentence) as refusal:
        apply_filter(ms, name, **parameters)
    assert "\n" not in str(refusal.value)
    assert everything(ms) == before
    return refusal.value


@pytest.mark.parametrize(
    ("name", "parameters", "sentence"),
    [
        ("nothing", {}, "no filter 'nothing'"),
        ("transfer_attributes_per_vertex", {"sourcemesh": 9}, "no mesh 9: the MeshSet has the meshes 0, 1"),
        ("create_sphere", {"radios": 1}, "radios"),
        ("create_sphere", {"radius": "wide"}, "create_sphere does not accept"),
        ("transfer_attributes_by_zoomout", {"colours": True}, "no parameter 'colours'"),
        ("transfer_attributes_by_zoomout", {"colortransfer": 1}, "'colortransfer' is 1: give true or false"),
        ("transfer_attributes_by_zoomout", {"sourcemesh": 0.5}, "'sourcemesh' is 0.5: give the id"),
        ("transfer_attributes_by_zoomout", {"initial": "magic"}, "give auto or landmarks or"),
        ("transfer_attributes_by_zoomout", {"qualitytransfer": False}, "none of the attributes"),
        ("compute_scalar_by_correspondence_error", {"selectabove": 3}, "give a PercentageValue"),
        ("compute_laplacian_eigenfunctions", {"functions": 5, "show": 5}, "from 0 to 4"),
        ("compute_laplacian_eigenfunctions", {"functions": 10**6, "show": 1}, "vertices"),
        ("compute_laplacian_eigenfunctions", {"name": "a b"}, "letters, digits"),
        ("compute_correspondence_by_zoomout", {"landmarks": "nowhere.txt", "initial": "landmarks"}, "nowhere.txt"),
    ],
)
def test_invalid_filter_calls_are_refused_and_change_nothing(pair, name, parameters, sentence):
    check_refusal(pair, sentence, name, **parameters)


@pytest.mark.parametrize(
    ("name", "parameter"), [(name, parameter) for name, row in CATALOGUE.items() for parameter in row.parameters]
)
def test_wrong_parameter_type_is_refused_by_name(pair, name, parameter):
    for value in WRONG[parameter.type]:
        check_refusal(pair, f"The filter {name}: '{parameter.name}' is .*: give ", name, **{parameter.name: value})


@pytest.mark.parametrize("name", BY_PAIR)
@pytest.mark.parametrize("side", ["sourcemesh", "targetmesh"])
@pytest.mark.parametrize(
    ("mesh_id", "sentence"),
    [
        (7, "no mesh 7: the MeshSet has the meshes 0, 1, 2, 3, 4"),
        (-1, "no mesh -1"),
        (2, "'points': .*3 points is too small"),
        (3, "'empty': It is empty"),
    ],
)
def test_wrong_ids_three_points_and_empty_meshes_are_refused(odd, name, side, mesh_id, sentence):
    assert isinstance(check_refusal(odd, sentence, name, **{side: mesh_id}), MeshError)


@pytest.mark.parametrize("name", OF_CURRENT)
def test_current_mesh_filters_refuse_too_small_meshes(odd, name):
    check_refusal(pymeshlab.MeshSet(), "The MeshSet is empty: load a mesh", name)
    for mesh_id, sentence in ((2, "'points'"), (3, "'empty'"), (4, "vertices")):
        odd.set_current_mesh(mesh_id)
        check_refusal(odd, sentence, name)


@pytest.mark.parametrize("name", [name for name in CATALOGUE if name not in BY_STORED])
def test_collinear_points_are_refused(pair, name):
    """On a line."""
    pair.add_mesh(pymeshlab.Mesh(np.outer(np.arange(50.0), [1, 2, 3])), "line")
    check_refusal(pair, "'line'.*line", name, **({"targetmesh": 2} if name in BY_PAIR else {}))


def test_face_data_is_not_transferred_to_points(pair, shapes):
    source, target = shapes
    pair.add_mesh(source.mesh(f_scalar_array=np.arange(len(source.faces), dtype=float)), "by face")
    pair.add_mesh(pymeshlab.Mesh(target.vertices), "points")
    sentence = "'points' has no faces to receive face_scalar of 'by face'"
    check_refusal(pair, sentence, "transfer_attributes_by_zoomout", sourcemesh=2, targetmesh=3)


@pytest.mark.parametrize("name", BY_PAIR)
def test_a_mesh_is_not_its_own_source(pair, name):
    check_refusal(pair, "A mesh cannot be its own source", name, sourcemesh=0, targetmesh=0)


def test_missing_mesh_error_lists_loaded_meshes(pair):
    pair.set_current_mesh(1)
    pair.delete_current_mesh()
    check_refusal(
        pair, "There is no mesh 1: the MeshSet has only mesh 0. Load it first", "transfer_attributes_by_zoomout"
    )
    for _ in range(20):
        pair.add_mesh(pymeshlab.Mesh(np.eye(3)))
    listed = "the MeshSet has the meshes 0, 2, 3, 4, 5, 6, 7, …, 21"
    check_refusal(pair, f"There is no mesh 1: {listed}", "transfer_attributes_by_zoomout")
    check_refusal(pymeshlab.MeshSet(), "There is no mesh 0: the MeshSet is empty", "transfer_attributes_by_zoomout")


@pytest.mark.parametrize("name", BY_STORED)
def test_missing_correspondence_is_refused(pair, name):
    check_refusal(pair, "has no correspondence 'correspondence': find it with", name)


def test_target_with_nan_vertex_is_refused_before_matching(pair, shapes):
    _, target = shapes
    vertices = np.vstack([target.vertices, [[np.nan, 0, 0]]])
    pair.add_mesh(pymeshlab.Mesh(vertices, target.faces), "holed")
    for name in ("transfer_attributes_by_zoomout", "apply_conform_by_zoomout"):
        check_refusal(pair, "'holed' has 1 vertex that is not finite", name, targetmesh=2)


@pytest.mark.parametrize("name", CATALOGUE)
def test_failure_during_work_changes_nothing(pair, shapes, name, tmp_path, monkeypatch):
    """All functions of the core fail."""
    if name == "transfer_texture_by_zoomout":
        pair = textured(tmp_path, *shapes)
    if name in BY_STORED:
        meshlab_filter.compute_correspondence_by_zoomout(pair, detail="fast")

    def give_up(*_arguments, **_options):
        raise MeshError("The core gives up.")

    for function in ("match", "detect_symmetry", "eigenbasis", "conform"):
        monkeypatch.setattr(zo, function, give_up)
    monkeypatch.setattr("zoomout_core.maps.surface_map.SurfaceMap.interpolate", give_up)
    check_refusal(pair, "The core gives up", name)


def textured(folder, source, target):
    """A source with two textures as mesh 0, and as mesh 1 a target with texture coordinates."""
    write_textured_obj(folder, source)
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(folder / "creature.obj"))
    uv = target.rest[target.faces.ravel(), :2] / 5 + 0.5
    ms.add_mesh(target.mesh(w_tex_coords_matrix=uv), "target")
    return ms


def test_impossible_bake_is_refused_before_matching(shapes, tmp_path):
    source, target = shapes
    ms = textured(tmp_path, source, target)
    ms.add_mesh(source.mesh(), "bare")
    ms.add_mesh(ms.mesh(0), "without images")  # pymeshlab does not copy them
    ms.load_new_mesh(str(tmp_path / "creature.obj"))
    name = "transfer_texture_by_zoomout"
    check_refusal(ms, "'bare' has no texture to bake", name, sourcemesh=2)
    check_refusal(ms, "'bare' has no texture coordinates to bake to", name, targetmesh=2)
    check_refusal(ms, "no image for front.bmp and back.png", name, sourcemesh=3)
    check_refusal(ms, "has 2 textures, but only one image can be baked", name, targetmesh=4)
    check_refusal(ms, "'textw' is 0: give a whole number from 1", name, textw=0)
    check_refusal(ms, "'texth' is 1000000000: give", name, texth=10**9)


def test_texture_coordinates_that_are_missing_are_named(pair):
    name = "transfer_attributes_by_zoomout"
    check_refusal(pair, "none of the attributes", name, colortransfer=False, qualitytransfer=False)
    report = apply_filter(pair, name, detail="fast")
    assert report["transferred"] == ["vertex_scalar"]
    assert "Layer 'source' has no texcoord." in report["notes"]


def test_matching_parameters_reach_the_core(pair, tmp_path, monkeypatch):
    asked = []

    def listen(*_surfaces, **arguments):
        asked.append(arguments)
        raise MeshError("Heard.")

    monkeypatch.setattr(zo, "match", listen)
    (tmp_path / "pairs.txt").write_text("1 2\n3 4\n")
    np.savez(tmp_path / "map.npz", vertex=np.arange(5))
    in_files = {"landmarks": str(tmp_path / "pairs.txt"), "initial_map": str(tmp_path / "map.npz"), "common_axes": "-z"}
    in_arrays = {"landmarks": ([1, 3], [2, 4]), "initial_map": np.arange(5), "common_axes": [[0, 0, -1]]}
    for data in (in_files, in_arrays):
        options = {
            "initial": "landmarks",
            "exact_landmarks": True,
            "upright": False,
            "partial": "off",
            "detail": "fine",
            "seed": 7,
            **data,
        }
        check_refusal(pair, "Heard", "compute_correspondence_by_zoomout", **options)
    for arguments in asked:
        np.testing.assert_array_equal(arguments.pop("landmarks"), [[1, 3], [2, 4]])
        np.testing.assert_array_equal(arguments.pop("initial_map"), np.arange(5))
        np.testing.assert_array_equal(arguments.pop("common_axes"), [[0, 0, -1]])
        given = {"initial": "landmarks", "exact_landmarks": True, "upright": False, "partial": "off", "seed": 7}
        assert arguments == given | DETAIL["fine"]


def test_candidate_parameter_selects_another_correspondence(pair):
    best = meshlab_filter.compute_correspondence_by_zoomout(pair, detail="fast")
    second = meshlab_filter.compute_correspondence_by_zoomout(pair, detail="fast", candidate=1, name="second")
    assert best["candidates"][0]["total"] == second["candidates"][0]["total"]
    assert np.mean(best["triangle"] != second["triangle"]) > 0.5


@pytest.mark.parametrize("given", [None, 3, zo], ids=str)
@pytest.mark.parametrize("name", ["compute_symmetry_by_zoomout", "meshing_remove_duplicate_faces"])
def test_something_else_than_a_mesh_set_is_refused(name, given):
    with pytest.raises(TypeError, match=r"^The meshes are a \w+: give a pymeshlab.MeshSet\.$"):
        apply_filter(given, name)


@pytest.mark.parametrize("name", ["compute_symmetry_by_zoomout", "meshing_remove_duplicate_faces"])
def test_callback_that_cannot_be_called_is_refused(pair, name):
    with pytest.raises(TypeError, match=r"^callback is 3: give a function that takes a fraction and a text\.$"):
        apply_filter(pair, name, callback=3)


@pytest.mark.parametrize("name", ["meshing_decimation_quadric_edge_collapse", "generate_sampling_montecarlo"])
def test_negative_counts_are_refused_before_meshlab_crashes_on_them(pair, name):
    parameter = {"meshing_decimation_quadric_edge_collapse": "targetfacenum"}.get(name, "samplenum")
    check_refusal(pair, f"'{parameter}' is -5: give a whole number that is not negative", name, **{parameter: -5})
