# SPDX-License-Identifier: GPL-3.0-or-later
"""The command for pipelines: its files, reports and exit codes."""

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from creatures import creature
from rigged import pose_target, source_and_rig
from scenes import (
    activate,
    add_uv_map,
    decimate,
    ellipsoid,
    from_pydata,
    set_weights,
    snapshot_file,
    weight_array,
    weights,
)

import zoomout_core as zo
from blender_addon import cli
from blender_addon.cli import command
from blender_addon.cli.arguments import parse
from blender_addon.cli.property_arguments import as_in_sidebar
from blender_addon.properties.match import MatchOptions
from blender_addon.properties.transfer import BindChoice, BindOptions, BlendOptions
from blender_addon.properties.wrap import WrapOptions
from blender_addon.storage import stored_match, stored_symmetry


@pytest.fixture
def pair():
    source = ellipsoid("Source", 4)
    add_uv_map(source.data, "UVMap")
    set_weights(source, "Bone", np.ones(len(source.data.vertices)))
    target = decimate("Target")
    target.location.x = 3
    bpy.context.view_layer.update()
    activate(source)  # selections mean nothing here
    return source, target


def run(*arguments):
    return cli.main([str(argument) for argument in arguments])


def test_a_transfer_is_saved_and_reported(pair, tmp_path, capsys):
    out, path = tmp_path / "out.blend", tmp_path / "report.json"
    arguments = ("--source", "Source", "--target", "Target", "--k-final", 30, "--save", out, "--report", path)
    assert run("transfer", *arguments, "--data", "uv_maps", "vertex_groups") == 0
    report = json.loads(path.read_text())
    assert report["targets"]["Target"]["written"]["uv_maps"] == ["UVMap"]
    assert (report["command"], report["source"], report["saved"]) == ("transfer", "Source", str(out))
    assert "error" not in report
    assert "zoomout: transfer to 'Target' done" in capsys.readouterr().out
    bpy.ops.wm.open_mainfile(filepath=str(out))
    target = bpy.data.objects["Target"]
    assert target.data.uv_layers.keys() == ["UVMap"]
    assert target.vertex_groups.keys() == ["Bone"]


def test_match_is_reported_with_confidence_and_certainty(pair, tmp_path):
    path = tmp_path / "report.json"
    assert run("match", "--source", "Source", "--target", "Target", "--k-final", 30, "--report", path) == 0
    entry = json.loads(path.read_text())["targets"]["Target"]
    kept = stored_match.description(pair[1].data)
    assert (entry["vertices"], entry["low_confidence"]) == (kept["vertices"], kept["low_confidence"])
    assert 0 < entry["mean_confidence"] <= 1
    assert 0 < entry["certainty"] <= 1


def test_failed_target_is_reported_and_others_are_saved(pair, tmp_path, capsys):
    out, path = tmp_path / "out.blend", tmp_path / "report.json"
    targets = ("--target", "Target", "--target", "Nobody")
    assert run("match", "--source", "Source", *targets, "--k-final", 30, "--save", out, "--report", path) == 1
    report = json.loads(path.read_text())
    sentence = "There is no object 'Nobody' in the scene: choose another one."
    assert report["targets"]["Nobody"] == {"error": sentence}
    assert report["targets"]["Target"]["vertices"] == len(pair[1].data.vertices)
    assert out.exists()
    assert f"zoomout: 'Nobody': {sentence}" in capsys.readouterr().err


def test_where_nothing_was_done_nothing_is_saved(pair, tmp_path):
    before, out = snapshot_file(), tmp_path / "out.blend"
    assert run("transfer", "--source", "Nobody", "--target", "Target", "--save", out) == 1
    assert not out.exists()
    assert snapshot_file() == before


@pytest.mark.parametrize("option", ["--save", "--report"])
def test_folder_is_refused_as_an_output_file(pair, tmp_path, capsys, option):
    before = snapshot_file()
    kept = tmp_path / "kept"
    kept.mkdir()
    assert run("match", "--source", "Source", "--target", "Target", option, kept) == 1
    assert f"{kept} is a folder: give the name of a file in it." in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]  # Blender would have moved it
    assert snapshot_file() == before


def test_unwritable_report_is_one_sentence(pair, tmp_path, capsys, monkeypatch):
    def full(*_, **__):
        raise OSError("No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    arguments = ("--source", "Source", "--target", "Target", "--k-final", 30, "--report", tmp_path / "report.json")
    assert run("match", *arguments) == 1
    assert "report.json could not be written (No space left on device)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (("--save", "/no/such/folder/out.blend"), "There is no folder /no/such/folder"),
        (("--group-names", "nonsense"), "'nonsense' is not such a pair"),
        (("--initial", "file"), "choose a map.npz"),
        (("--initial", "landmarks"), "Matching from landmarks needs at least one"),
    ],
)
def test_failure_is_one_sentence_with_exit_status_1(pair, capsys, more, sentence):
    assert run("transfer", "--source", "Source", "--target", "Target", *more) == 1
    assert sentence in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments", [(), ("dance",), ("match",), ("symmetry",), ("match", "--source", "Source", "--target")]
)
def test_invalid_command_line_prints_usage_with_exit_status_2(arguments, capsys):
    assert run(*arguments) == 2
    assert "usage: blender --background FILE.blend --command zoomout" in capsys.readouterr().err


@pytest.mark.parametrize("start", ["auto", "landmarks", "proximity", "nearest", "same_order", "file"])
def test_defaults_equal_those_of_the_sidebar(start):
    options = parse(["transfer", "--source", "A", "--target", "B", "--initial", start])
    settings = bpy.context.scene.zoomout
    settings.initial = start.upper()
    assert MatchOptions.match_options(as_in_sidebar(options, MatchOptions)) == pytest.approx(settings.match_options())
    ours, theirs = (BlendOptions.settings(given) for given in (as_in_sidebar(options, BlendOptions), settings))
    assert ours.fill_below == pytest.approx(theirs.fill_below)
    assert {**vars(ours), "fill_below": 0} == {**vars(theirs), "fill_below": 0}


def test_every_option_of_the_sidebar_can_be_given():
    line = (
        "--initial nearest --detail fine --k-final 90 --map-file m.npz --exact-landmarks --no-landmarks --no-names "
        "--same-up --no-upright --from-last --max-distance 0.2 --max-angle 90 --either-side --fill-below 0.3 "
        "--mode missing --without-partner keep "
        "--factor 0.5 --mask-group Mask --limit 4 --flip-names --group-names a=b --turning flow "
        "--bind --binding keep_shape --replace-binding"
    )
    options = parse(["transfer", "--source", "A", "--target", "B", *line.split()])
    for group in (MatchOptions, BlendOptions, BindChoice, BindOptions):
        given = as_in_sidebar(options, group)
        for name, option in group.__annotations__.items():
            assert getattr(given, name) != option.keywords.get("default", ""), name
    assert MatchOptions.match_options(as_in_sidebar(options, MatchOptions))["max_angle"] == 90


def test_a_target_is_bound_on_demand(tmp_path):
    source, armature = source_and_rig()
    target, _ = pose_target(source, armature)
    path = tmp_path / "report.json"
    both = "--source", "Source", "--target", "Target", "--data", "vertex_groups"
    assert run("transfer", *both, "--report", path) == 0
    assert json.loads(path.read_text())["targets"]["Target"]["bound"] is None
    assert run("transfer", *both, "--bind", "--binding", "rest_pose", "--report", path) == 0
    assert json.loads(path.read_text())["targets"]["Target"]["bound"] == {"armature": "Rig", "shape": "rest_pose"}
    assert target.parent == armature
    assert run("transfer", *both, "--bind") == 1
    assert run("transfer", *both, "--bind", "--replace-binding", "--binding", "keep_shape", "--report", path) == 0
    assert json.loads(path.read_text())["targets"]["Target"]["bound"]["shape"] == "keep_shape"


def test_a_target_is_wrapped(pair, tmp_path, capsys):
    path, both = tmp_path / "report.json", ("--source", "Source", "--target", "Target", "--k-final", 30)
    line = "--wrap-smoothness 0.7 --wrap-detail 0.9 --wrap-result mesh --no-wrap-landmarks --no-wrap-subdivided"
    assert run("wrap", *both, *line.split(), "--report", path) == 0
    entry = json.loads(path.read_text())["targets"]["Target"]
    assert entry["object"] == "Target"
    assert zo.Verdict(**entry["verdict"]).line in capsys.readouterr().out
    assert run("wrap", *both, "--wrap-mask", "None") == 1
    assert "no vertex group 'None'" in capsys.readouterr().err
    assert run("wrap", *both, "--target", "Other", "--wrap-reverse") == 1
    assert "one target" in capsys.readouterr().err
    assert run("wrap", "--source", "Source") == 2
    options = parse(["wrap", "--source", "A", "--target", "B"])
    assert WrapOptions.wrap_options(as_in_sidebar(options, WrapOptions)) == pytest.approx(
        bpy.context.scene.zoomout.wrap_options()
    )


def test_a_target_is_dressed(pair, tmp_path, capsys):
    path, both = tmp_path / "report.json", ("--source", "Source", "--target", "Target", "--k-final", 30)
    hat = ellipsoid("Hat", 2, (0.2, 0.2, 0.2))
    hats = bpy.data.collections.new("Hats")
    bpy.context.scene.collection.children.link(hats)
    hats.objects.link(hat)
    for chosen in (("--thing", "Hat"), ("--collection", "Hats")):
        assert run("dress", *both, *chosen, "--dress-manner", "rigid", "--report", path) == 0
        entry = json.loads(path.read_text())["targets"]["Target"]
        assert entry["objects"] == {"Hat": "Hat on Target"}
        assert zo.Verdict(**entry["verdict"]).line in capsys.readouterr().out
    assert run("dress", *both, "--thing", "None") == 1
    assert "no object 'None'" in capsys.readouterr().err
    assert run("dress", *both) == 2


def test_reasons_why_objects_were_left_out_are_printed():
    assert command._lines({"left_out": {"Hat": "'Hat' has no vertices."}, "notes": []}) == ["'Hat' has no vertices."]


@pytest.mark.slow
def test_collections_are_matched_part_by_part(pair, tmp_path):
    for name, obj in zip(("Hero", "Scan"), pair, strict=True):
        collection = bpy.data.collections.new(name)
        bpy.context.scene.collection.children.link(collection)
        collection.objects.link(obj)
    path, both = tmp_path / "report.json", ("--source-collection", "Hero", "--target-collection", "Scan")
    assert run("match", *both, "--detail", "fast", "--report", path) == 0
    report = json.loads(path.read_text())
    assert report["source"] == "Hero"
    assert report["targets"]["Target"]["source"] == "Source"
    assert run("transfer", *both, "--detail", "fast", "--data", "vertex_groups", "--report", path) == 0
    assert json.loads(path.read_text())["targets"]["Target"]["written"]["vertex_groups"] == ["Bone"]
    assert run("match", "--source-collection", "Nobody", "--target-collection", "Scan", "--report", path) == 1
    assert "no collection 'Nobody'" in json.loads(path.read_text())["error"]


@pytest.fixture
def body():
    """A posed creature with weights on its left side."""
    made = creature(1500, seed=1, bend=0.9)
    obj = from_pydata("Body", made.surface.vertices.tolist(), made.surface.triangles.tolist())
    set_weights(obj, "Arm.L", np.clip(made.directions[:, 0], 0, 1))
    return obj


def test_symmetry_is_detected_applied_saved_and_reported(body, tmp_path, capsys):
    out, path = tmp_path / "out.blend", tmp_path / "report.json"
    actions = ("--check", "weights", "--save", out, "--report", path)
    assert run("symmetry", "--object", "Body", *actions) == 0
    before = json.loads(path.read_text())["objects"]["Body"]
    assert before["candidates"][before["used"] - 1]["name"] == "Reflection"
    assert run("symmetry", "--object", "Body", "--name-sides", "--symmetrise-weights", *actions) == 0
    after = json.loads(path.read_text())["objects"]["Body"]
    assert len(after["done"]) == 2  # the symmetry is that of before
    assert before["asymmetry"]["weights"]["mean"] > 10 * after["asymmetry"]["weights"]["mean"]
    printed = capsys.readouterr().out
    assert "zoomout: symmetry of 'Body' done" in printed
    assert all(sentence in printed for sentence in after["done"])
    bpy.ops.wm.open_mainfile(filepath=str(out))
    body = bpy.data.objects["Body"]
    assert list(weights(body)) == ["Arm.L", "Side.L", "Side.R", "Side Middle", "Arm.R"]
    assert weight_array(body, "Side.L")[weight_array(body, "Arm.L") > 0.5].min() == 1


@pytest.mark.slow
def test_symmetry_is_detected_again_on_request_or_after_edits(body):
    assert run("symmetry", "--object", "Body", "--swap-sides") == 0
    swapped = stored_symmetry.read(body).distance
    assert run("symmetry", "--object", "Body") == 0
    np.testing.assert_array_equal(stored_symmetry.read(body).distance, swapped)
    assert run("symmetry", "--object", "Body", "--detect-again") == 0
    np.testing.assert_array_equal(stored_symmetry.read(body).distance, -swapped)
    body.data.vertices[0].co.x += 0.01
    assert run("symmetry", "--object", "Body") == 0
    stored_symmetry.read(body)


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (("--use", 99), "'Body' has only one symmetry: choose a lower number"),
        (("--mirror-shape-keys", "Smile"), "'Body' has no shape key 'Smile'"),
        (("--mirror-attributes", "uv_maps"), "none of the data to mirror"),
        (("--object", "Nobody"), "There is no object 'Nobody' in the scene"),
    ],
)
def test_failed_symmetry_command_saves_nothing(body, tmp_path, capsys, more, sentence):
    out, path = tmp_path / "out.blend", tmp_path / "report.json"
    assert run("symmetry", "--object", "Body", *more, "--save", out, "--report", path) == 1
    assert sentence in capsys.readouterr().err
    assert not out.exists()
    errors = [entry["error"] for entry in json.loads(path.read_text())["objects"].values() if "error" in entry]
    assert len(errors) == 1


def test_report_lists_candidates_if_the_choice_fails(body, tmp_path):
    path = tmp_path / "report.json"
    assert run("symmetry", "--object", "Body", "--use", 99, "--report", path) == 1
    entry = json.loads(path.read_text())["objects"]["Body"]
    assert "choose a lower number" in entry["error"]
    assert entry["candidates"][entry["used"] - 1]["name"] == "Reflection"


@pytest.mark.parametrize(
    ("more", "complaint"),
    [
        (("--factor", "3"), "3 is more than 1"),
        (("--k-final", "-1"), "-1 is less than 0"),
        (("--target-collection", "Scan"), "or --source-collection and --target-collection"),
        (("--detail", "coarse"), "invalid choice: 'coarse'"),
    ],
)
def test_invalid_value_is_refused_with_exit_status_2(more, complaint, capsys):
    assert run("transfer", "--source", "Source", "--target", "Target", *more) == 2
    assert complaint in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "mentioned"), [((), "symmetry"), (("transfer",), "--mask-group"), (("symmetry",), "--name-sides")]
)
def test_help_mentions_commands_and_options(command, mentioned, capsys):
    assert run(*command, "--help") == 0
    assert mentioned in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments",
    [
        ("match", "--source", "A", "--target", "B", "--save", ""),
        ("match", "--source", "A", "--target", "B", "--report", ""),
        ("carry", "", "b.ply"),
        ("carry", "a.ply", ""),
        ("carry", "a.ply", "b.ply", "--map", ""),
        ("surface", "", "--save", "a.ply"),
        ("assets", "a.blend", "--folder", ""),
        ("library", ""),
        ("library", "a", "--index", ""),
        ("outfits", "", "a.glb", "-o", "out"),
        ("outfits", "a.glb", "", "-o", "out"),
        ("outfits", "a.glb", "b.glb", "-o", ""),
    ],
)
def test_empty_paths_are_refused(arguments, tmp_path, monkeypatch, capsys):
    """An unset variable of a shell would stand for the working folder, or for no output."""
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    assert "it is empty: give a path" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", ["nan", "inf"])
def test_numbers_that_are_not_finite_are_refused(number, capsys):
    assert run("symmetry", "--object", "A", "--middle-width", number) == 2
    assert f"{number} is not a finite number" in capsys.readouterr().err


def test_files_that_cannot_be_opened_are_described(tmp_path, capsys):
    (tmp_path / "a.ply").mkdir()
    assert run("surface", tmp_path / "a.ply", "--save", tmp_path / "out.ply") == 1
    assert "is a folder: give a file" in capsys.readouterr().err
