# SPDX-License-Identifier: GPL-3.0-or-later
"""Filter scripts: saved by MeshLab, written by hand, and invalid."""

from pathlib import Path

import numpy as np
import pymeshlab
import pytest
from click.testing import CliRunner
from creature import SOURCE_POSE, TARGET_POSE, creature

from meshlab_filter.commands import main
from meshlab_filter.script import read_script, run_script
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.ply_files import ply_columns

pytestmark = pytest.mark.usefixtures("remember_matches")

HEAD = "<!DOCTYPE FilterScript>\n<FilterScript>\n"  # so that a filter begins in line 3
SIZE = 14.2**0.5


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    """Files of a source whose vertex quality is the rest position's x, and of a target."""
    folder = tmp_path_factory.mktemp("meshes")
    source, target = creature(0.12, SOURCE_POSE), creature(0.14, TARGET_POSE)
    for name, mesh in (("source", source.mesh(v_scalar_array=source.rest[:, 0])), ("target", target.mesh())):
        ms = pymeshlab.MeshSet()
        ms.add_mesh(mesh)
        ms.save_current_mesh(str(folder / f"{name}.ply"))
    return folder / "source.ply", folder / "target.ply"


def loaded(meshes):
    ms = pymeshlab.MeshSet()
    for path in meshes:
        ms.load_new_mesh(str(path))
    return ms


def script(folder, body):
    path = folder / "script.mlx"
    path.write_text(f"{HEAD}{body}\n</FilterScript>\n")
    return path


def param(name, rich, value):
    return f'  <Param name="{name}" type="{rich}" value="{value}"/>\n'


def test_script_saved_by_meshlab_repeats_its_filters(meshes, tmp_path):
    """Absolute percentages, enumerations, whole numbers, switches, expressions and line breaks in tooltips."""
    made = loaded(meshes)
    made.apply_filter("meshing_surface_subdivision_midpoint", iterations=1, threshold=pymeshlab.PercentageValue(3))
    made.apply_filter("compute_scalar_by_function_per_vertex", q="x<0 ? 1 : y")
    made.apply_filter("compute_scalar_by_discrete_curvature_per_vertex", curvaturetype="Gaussian Curvature")
    made.apply_filter("meshing_decimation_quadric_edge_collapse", targetfacenum=900, preservetopology=True)
    made.apply_filter("transfer_attributes_per_vertex", sourcemesh=0, targetmesh=1, qualitytransfer=True)
    made.save_filter_script(str(tmp_path / "saved.mlx"))
    ms = loaded(meshes)
    reports = run_script(ms, tmp_path / "saved.mlx")
    assert len(reports) == 5
    np.testing.assert_allclose(ms.current_mesh().vertex_matrix(), made.current_mesh().vertex_matrix(), atol=1e-6)
    np.testing.assert_array_equal(ms.current_mesh().face_matrix(), made.current_mesh().face_matrix())
    np.testing.assert_allclose(ms.mesh(1).vertex_scalar_array(), made.mesh(1).vertex_scalar_array(), atol=1e-6)


DESKTOP = Path(__file__).with_name("desktop.mlx")


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_script_of_desktop_meshlab_runs_unchanged(meshes, tmp_path, ending):
    """Every kind of parameter with its description and tooltip, and line ends of Linux and Windows."""
    path = tmp_path / "desktop.mlx"
    path.write_text(DESKTOP.read_text(encoding="utf-8"), encoding="utf-8", newline=ending)
    made = loaded(meshes[1:])
    made.apply_filter("meshing_remove_duplicate_vertices")
    made.apply_filter("meshing_remove_unreferenced_vertices")
    made.apply_filter("meshing_merge_close_vertices", threshold=pymeshlab.PureValue(0.0005))
    made.apply_filter("meshing_close_holes", maxholesize=30)
    made.apply_filter(
        "meshing_decimation_quadric_edge_collapse", targetfacenum=1200, preserveboundary=True, preservenormal=True
    )
    made.apply_filter("compute_scalar_by_discrete_curvature_per_vertex", curvaturetype="Gaussian Curvature")
    made.apply_filter("set_color_per_vertex", color1=pymeshlab.Color(255, 0, 10, 255))
    made.apply_filter("apply_color_brightness_contrast_gamma_per_vertex", brightness=20)
    ran = CliRunner().invoke(main, ["run", str(path), str(meshes[1]), "-o", str(tmp_path / "out.ply")])
    assert ran.exit_code == 0, ran.output
    ms = pymeshlab.MeshSet()
    ms.load_new_mesh(str(tmp_path / "out.ply"))
    mesh = ms.current_mesh()
    assert mesh.face_number() == made.current_mesh().face_number() <= 1200
    np.testing.assert_allclose(mesh.vertex_matrix(), made.current_mesh().vertex_matrix(), atol=1e-6)
    np.testing.assert_allclose(mesh.vertex_scalar_array(), made.current_mesh().vertex_scalar_array(), rtol=1e-5)
    np.testing.assert_allclose(mesh.vertex_color_matrix(), made.current_mesh().vertex_color_matrix(), atol=0.002)
    assert mesh.vertex_color_matrix()[:, 0].min() == 1


def test_percentages_are_relative_to_the_mesh(meshes, tmp_path):
    """For filters named as in the menus and as in Python, and for this project's."""
    made = loaded(meshes[1:])
    made.apply_filter("meshing_surface_subdivision_midpoint", iterations=1, threshold=pymeshlab.PercentageValue(3))
    for name, iterations, threshold in (
        ("Subdivision Surfaces: Midpoint", "Iterations", "Threshold"),
        ("meshing_surface_subdivision_midpoint", "iterations", "threshold"),
    ):
        lines = param(iterations, "RichInt", 1) + param(threshold, "RichAbsPerc", "3%")
        path = script(tmp_path, f'<filter name="{name}">\n{lines}</filter>')
        ms = loaded(meshes[1:])
        run_script(ms, path)
        assert ms.current_mesh().vertex_number() == made.current_mesh().vertex_number()
    own = '<filter name="compute_scalar_by_correspondence_error">\n' + param("selectabove", "RichAbsPerc", "2%")
    (call,) = read_script(script(tmp_path, own + "</filter>"))
    assert isinstance(call.values["selectabove"], pymeshlab.PercentageValue)
    assert call.values["selectabove"].value() == 2


MIXED = (
    '<filter name="compute_correspondence_by_zoomout">\n'
    + param("sourcemesh", "RichMesh", 0)
    + param("targetmesh", "RichMesh", 1)
    + param("detail", "RichEnum", 0)
    + param("seed", "RichInt", 3)
    + '</filter>\n<filter name="transfer_attributes_by_zoomout">\n'
    + param("colortransfer", "RichBool", "false")
    + param("correspondence", "RichString", "correspondence")
    + '</filter>\n<filter name="compute_scalar_by_correspondence_error">\n'
    + param("selectabove", "RichAbsPerc", 0.5)
    + '</filter>\n<filter name="Per Vertex Quality Function">\n'
    + param("q", "RichString", "q * 2")
    + '</filter>\n<filter name="meshing_surface_subdivision_midpoint">\n'
    + param("iterations", "RichInt", 1)
    + param("threshold", "RichAbsPerc", 0)
    + "</filter>"
)


@pytest.mark.slow
def test_scripts_mix_filters_of_meshlab_and_zoomout(meshes, tmp_path):
    output = tmp_path / "out.ply"
    ran = CliRunner().invoke(main, ["run", str(script(tmp_path, MIXED)), *map(str, meshes), "-o", str(output)])
    assert ran.exit_code == 0, ran.output
    assert "Line 9, transfer_attributes_by_zoomout: Layer 'source.ply' has no texcoord." in ran.output
    target = creature(0.14, TARGET_POSE)
    vertex = ply_columns(output.read_bytes())["vertex"]
    assert len(vertex["quality"]) > 3 * len(target.rest)
    error = np.abs(vertex["quality"][: len(target.rest)] / 2 - target.rest[:, 0]) / SIZE
    assert error.mean() < 0.03
    assert vertex["correspondence_confidence"].max() <= 1


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ('<filter name="Sphere">', "Line 4 of .* is not valid XML"),
        ('<xmlfilter name="Sphere"/>', "Line 3 of .*expected a filter, but found a xmlfilter"),
        ("<filter/>", "Line 3 of .*the filter has no name"),
        ('<filter name="Nothing"/>', "Line 3 of .*there is no filter 'Nothing' in MeshLab or this project"),
        (
            '<filter name="Sphere">\n' + param("subdiv", "RichInt", "many") + "</filter>",
            "Line 4 of .*'subdiv' is 'many': give a whole number",
        ),
        (
            '<filter name="Sphere">\n' + param("radius", "RichLong", 1) + "</filter>",
            "Line 4 of .*unknown type RichLong",
        ),
        ('<filter name="Sphere">\n <Param name="radius" type="RichFloat"/></filter>', "Line 4 of .*has no value"),
        (
            '<filter name="Vertex Attribute Transfer">\n' + param("SourceMesh", "RichMesh", 5) + "</filter>",
            "Line 3 of .*no mesh 5: the MeshSet has the meshes 0, 1",
        ),
        (
            '<filter name="Delete ALL Faces"/>\n<filter name="Simplification: Quadric Edge Collapse Decimation"/>',
            "Line 4 of .*could not apply 'Simplification: Quadric Edge Collapse Decimation'",
        ),
        (
            '<filter name="transfer_attributes_by_zoomout">\n\n' + param("colour", "RichBool", "true") + "</filter>",
            "Line 5 of .*has no parameter 'colour': it has sourcemesh",
        ),
        (
            '<filter name="transfer_attributes_by_zoomout">\n' + param("initial", "RichEnum", 7) + "</filter>",
            "Line 4 of .*'initial' is '7': give auto or",
        ),
        (
            '<filter name="transfer_attributes_by_zoomout">\n' + param("seed", "RichInt", -1) + "</filter>",
            "Line 4 of .*'seed' is '-1': give a whole number that is not negative",
        ),
        (
            '<filter name="transfer_attributes_by_zoomout">\n' + param("targetmesh", "RichMesh", 9) + "</filter>",
            "Line 3 of .*no mesh 9: the MeshSet has the meshes 0, 1",
        ),
        ('<filter name="transfer_attribute_by_zoomout"/>', "is 'transfer_attributes_by_zoomout' meant"),
        ('<filter name="something_entirely_different"/>', "Line 3 of .*no filter 'something_entirely_different'"),
        (
            '<filter name="transfer_attributes_by_zoomout">\n' + param("seed", "RichFloat", 7) + "</filter>",
            "Line 4 of .*'seed' has the type RichFloat: give it as RichInt",
        ),
        (
            '<filter name="compute_scalar_by_correspondence_error">\n'
            + param("targetmesh", "RichMesh", 1)
            + "</filter>",
            "Line 3 of .*has no correspondence",
        ),
    ],
)
def test_script_errors_name_the_line(meshes, tmp_path, body, sentence):
    path = script(tmp_path, body)
    with pytest.raises(ValueError, match=sentence) as refusal:
        run_script(loaded(meshes), path)
    assert "\n" not in str(refusal.value)


def test_a_wrong_line_is_found_before_the_first_filter_runs(meshes, tmp_path):
    body = '<filter name="Delete ALL Faces"/>\n<filter name="compute_color_by_correspondence">\n'
    misspelt = script(tmp_path, '<filter name="Delete ALL Faces"/>\n<filter name="meshing_close_hole"/>')
    with pytest.raises(ValueError, match=r"Line 4 of .*no filter 'meshing_close_hole': is 'meshing_close_holes' meant"):
        read_script(misspelt)
    path = script(tmp_path, body + param("sourcemesh", "RichMesh", "first") + "</filter>")
    with pytest.raises(ValueError, match=r"Line 5 of .*'sourcemesh' is 'first'"):
        read_script(path)
    output = tmp_path / "out.ply"
    ran = CliRunner().invoke(main, ["run", str(path), *map(str, meshes), "-o", str(output)])
    assert ran.exit_code == 1
    (line,) = [line for line in ran.output.splitlines() if line.startswith("Error:")]
    assert "Line 5" in line
    assert not output.exists()


def test_script_that_leaves_no_mesh_is_refused(meshes, tmp_path):
    path = script(tmp_path, '<filter name="delete_current_mesh"/>\n' * 3)
    with pytest.raises(ValueError, match=r"Line 5 of .*no mesh left"):
        run_script(loaded(meshes), path)
    path = script(tmp_path, '<filter name="delete_current_mesh"/>\n' * 2)
    ran = CliRunner().invoke(main, ["run", str(path), *map(str, meshes), "-o", str(tmp_path / "a.ply")])
    assert ran.exit_code == 1
    assert "Error: The script leaves no mesh to write" in ran.output


def test_missing_output_folder_is_reported(meshes, tmp_path):
    path = script(tmp_path, "")
    ran = CliRunner().invoke(main, ["run", str(path), *map(str, meshes), "-o", str(tmp_path / "nowhere" / "a.ply")])
    assert ran.exit_code == 1
    assert "no folder" in ran.output


@pytest.mark.parametrize(
    ("name", "parameter"),
    [
        ("meshing_decimation_quadric_edge_collapse", "targetfacenum"),
        ("Simplification: Quadric Edge Collapse Decimation", "TargetFaceNum"),
    ],
)
def test_negative_counts_in_scripts_are_refused_before_meshlab_crashes_on_them(meshes, tmp_path, name, parameter):
    path = script(tmp_path, f'<filter name="{name}">\n{param(parameter, "RichInt", -5)}</filter>')
    with pytest.raises(MeshError, match=f"'{parameter}' is -5: give a whole number that is not negative"):
        run_script(loaded(meshes[1:]), path)


@pytest.mark.parametrize("output", ["out.xyzzy", "out"])
def test_an_unknown_format_is_named_with_the_output(meshes, tmp_path, output):
    path = script(tmp_path, '<filter name="meshing_invert_face_orientation"/>')
    ran = CliRunner().invoke(main, ["run", str(path), str(meshes[1]), "-o", str(tmp_path / output)])
    assert ran.exit_code == 1
    assert f"MeshLab cannot write the format of {tmp_path / output}: choose another, such as .ply." in ran.output
