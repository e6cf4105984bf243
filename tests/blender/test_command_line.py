"""The command for pipelines: what it writes, reports and ends with."""

import json

import bpy
import numpy as np
import pytest
from scenes import activate, add_uv_map, decimated, ellipsoid, set_weights, snapshot_file

from blender_addon import cli, stored_match


@pytest.fixture
def pair():
    source = ellipsoid("Source", 4)
    add_uv_map(source.data, "UVMap")
    set_weights(source, "Bone", np.ones(len(source.data.vertices)))
    target = decimated("Target")
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


def test_a_match_is_reported_with_how_far_to_trust_it(pair, tmp_path):
    path = tmp_path / "report.json"
    assert run("match", "--source", "Source", "--target", "Target", "--k-final", 30, "--report", path) == 0
    entry = json.loads(path.read_text())["targets"]["Target"]
    kept = stored_match.description(pair[1].data)
    assert (entry["vertices"], entry["low_confidence"]) == (kept["vertices"], kept["low_confidence"])
    assert 0 < entry["mean_confidence"] <= 1
    assert 0 < entry["certainty"] <= 1


def test_a_target_that_fails_is_reported_and_the_others_are_done_and_saved(pair, tmp_path, capsys):
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


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (("--save", "/no/such/folder/out.blend"), "There is no folder /no/such/folder"),
        (("--group-names", "nonsense"), "'nonsense' is no pair"),
        (("--initial", "file"), "choose a map.npz"),
        (("--initial", "landmarks"), "A start from landmarks needs one or more"),
    ],
)
def test_what_cannot_be_done_is_one_sentence_and_exit_status_1(pair, capsys, more, sentence):
    assert run("transfer", "--source", "Source", "--target", "Target", *more) == 1
    assert sentence in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [(), ("dance",), ("match",), ("match", "--source", "Source", "--target")])
def test_a_command_line_that_cannot_be_understood_ends_with_the_usage_and_exit_status_2(arguments, capsys):
    assert run(*arguments) == 2
    assert "usage: blender --background FILE.blend --command zoomout" in capsys.readouterr().err


@pytest.mark.parametrize(("command", "mentioned"), [((), "transfer"), (("transfer",), "--mask-group")])
def test_help_says_what_there_is(command, mentioned, capsys):
    assert run(*command, "--help") == 0
    assert mentioned in capsys.readouterr().out
