# SPDX-License-Identifier: GPL-3.0-or-later
"""All that can be checked is checked before the match; a later failure keeps the map, and names its file."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from interfaces import Limit, add_colors, assert_refused, contents, run

import zoomout_core as zo
from zoomout_core import map_files as maps
from zoomout_core.cli import (
    collection_command,
    landmarks_command,
    match_command,
    symmetry_command,
    transfer_command,
)
from zoomout_core.cli import main as zoomout
from zoomout_core.messages import NO_MEMORY
from zoomout_core.runtime.array_files import write_arrays
from zoomout_core.runtime.outputs import OutputError, atomic_write, check_output

pytestmark = pytest.mark.usefixtures("remember_matches")

POSIX = pytest.mark.skipif(os.name != "posix", reason="files and terminals are others there")
FAST = ("--initial", "proximity", "--detail", "fast")


@pytest.fixture
def no_match(monkeypatch: pytest.MonkeyPatch) -> None:
    """Matching is an error of the test."""

    def match(*_: object, **__: object) -> None:
        raise AssertionError("It was matched.")

    monkeypatch.setattr(transfer_command, "match", match)
    monkeypatch.setattr(match_command, "match_shapes", match)
    monkeypatch.setattr(match_command, "match_by_proximity", match)
    monkeypatch.setattr(symmetry_command, "detect_symmetry", match)
    monkeypatch.setattr(collection_command, "match_collection", match)


def colored(path: Path, **document: Any) -> Path:
    """A glTF file with a colour and a material, whose document is changed."""
    surface = zo.read_surface(path)
    count = len(surface.vertices)
    colors = zo.Attribute("color 0", zo.Domain.POINT, zo.Kind.COLOR, np.ones((count, 4)))
    made = path.with_suffix(".gltf")
    zo.write_asset(zo.Asset(surface, (colors,)), made)
    read = json.loads(made.read_text(encoding="utf-8"))
    read["materials"] = [{"name": "Skin", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1]}}]
    for mesh in read["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
    made.write_text(json.dumps(read | document), encoding="utf-8")
    return made


# --- before the match ----------------------------------------------------------------------------------------

DOCUMENTS: dict[str, dict[str, Any]] = {
    "a scene that is missing": {"scene": 7},
    "a scene below the first": {"scene": -9},
    "a colour of one number": {"materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1]}}]},
    "a colour of words": {"materials": [{"pbrMetallicRoughness": {"baseColorFactor": ["red", 0, 0, 1]}}]},
    "a texture that is missing": {"materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 99}}}]},
    "images of numbers": {"images": [5], "textures": [{"source": 0}]},
}


@pytest.mark.usefixtures("no_match")
@pytest.mark.parametrize("ending", ["glb", "obj"])
@pytest.mark.parametrize("name", DOCUMENTS)
def test_broken_source_is_refused_before_match(name: str, ending: str, meshes: tuple[Path, Path]) -> None:
    source = colored(meshes[0], **DOCUMENTS[name])
    ran = run(zoomout, "transfer", source, meshes[1], "-o", source.with_name(f"out.{ending}"), "--force", *FAST)
    assert_refused(ran, "could not be read (")


@pytest.mark.usefixtures("no_match")
@pytest.mark.parametrize("kinds", ["uv", "shape-keys", "weights"])
def test_missing_source_data_is_refused_before_match(kinds: str, meshes: tuple[Path, Path], tmp_path: Path) -> None:
    ran = run(zoomout, "transfer", *meshes, "-o", tmp_path / "out.glb", "--kinds", kinds)
    assert_refused(ran, "The source has no")
    template = ("--template", meshes[0], "--transfer", "--kinds", kinds, "--workers", "1")
    assert_refused(run(zoomout, "collection", *meshes, "-o", tmp_path / "all", *template), "The source has no")


COMMANDS: dict[str, Callable[[Path, Path, Path], tuple[str | Path, ...]]] = {
    "match": lambda one, other, folder: ("match", one, other, "-o", folder / "out.npz"),
    "match nearest": lambda one, other, folder: (
        "match",
        one,
        other,
        "-o",
        folder / "out.npz",
        "--initial",
        "nearest",
    ),
    "symmetry": lambda one, _, folder: ("symmetry", one, "-o", folder / "out.npz"),
    "transfer": lambda one, other, folder: ("transfer", one, other, "-o", folder / "out.ply"),
    "transfer to a folder": lambda one, other, folder: ("transfer", one, other, "-o", folder / "out"),
    "collection": lambda one, other, folder: ("collection", one, other, "-o", folder / "out", "--workers", "1"),
}


@pytest.mark.usefixtures("no_match")
@pytest.mark.parametrize("limit", [0])
@pytest.mark.parametrize("name", COMMANDS)
def test_full_disk_is_reported_before_match(
    name: str, limit: int, meshes: tuple[Path, Path], tmp_path: Path, size_limit: Limit
) -> None:
    colored(meshes[0])
    folder = tmp_path / "results"
    folder.mkdir()
    with size_limit(limit):
        ran = run(zoomout, *COMMANDS[name](*meshes, folder))
    assert_refused(ran, "could not be written (File too large)")
    assert not contents(folder)


@POSIX
@pytest.mark.usefixtures("no_match")
@pytest.mark.parametrize("name", COMMANDS)
def test_output_link_to_itself_is_refused(name: str, meshes: tuple[Path, Path], tmp_path: Path) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    for output in ("out", "out.npz", "out.ply"):
        (folder / output).symlink_to(folder / output)
    assert_refused(run(zoomout, *COMMANDS[name](*meshes, folder)), "is a link that leads back to itself")


@POSIX
def test_input_link_to_itself_is_reported(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "loop.ply").symlink_to(folder / "loop.ply")
    (folder / "target.ply").write_bytes(meshes[1].read_bytes())
    source = colored(meshes[0])
    ran = run(zoomout, "transfer", source, folder, "-o", tmp_path / "out", "--force", *FAST)
    assert ran.exit_code == 3, ran.output
    assert "There is no file" in ran.output
    ran = run(zoomout, "collection", folder, meshes[0], "-o", tmp_path / "all", "--workers", "1", "--detail", "fast")
    assert ran.exit_code == 3, ran.output
    assert (tmp_path / "all" / "report.html").exists()


@pytest.mark.usefixtures("no_match")
def test_folder_in_place_of_report_is_refused(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    for name in ("transfer to a folder", "collection"):
        folder = tmp_path / name
        (folder / "out" / "report.json").mkdir(parents=True)
        assert_refused(run(zoomout, *COMMANDS[name](*meshes, folder)), "report.json is a folder")


# --- after the match -----------------------------------------------------------------------------------------

FAILURES: dict[str, tuple[Exception, str]] = {
    "a sentence": (zo.MeshError("The joints are broken."), "The joints are broken. The map was kept in "),
    "a full disk": (OutputError("It could not be written."), "It could not be written. The map was kept"),
    "memory": (MemoryError(), NO_MEMORY),
    "a mistake of ours": (IndexError("list index\nout of range"), "(IndexError: list index out of range). The map"),
    "letters": (UnicodeEncodeError("ascii", "人", 0, 1, "ordinal not in range"), "'ascii' codec can't encode"),
}


@pytest.mark.slow(but=2)
@pytest.mark.parametrize("name", FAILURES)
def test_a_transfer_that_fails_keeps_the_map(
    name: str, meshes: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    error, sentence = FAILURES[name]

    def fail(*_: object, **__: object) -> None:
        raise error

    source, other = colored(meshes[0]), tmp_path / "out_map.npz"
    other.write_bytes(b"the user's own")
    monkeypatch.setattr(transfer_command, "transfer_asset", fail)
    ran = run(zoomout, "transfer", source, meshes[1], "-o", tmp_path / "out.glb", "--force", *FAST)
    assert_refused(ran, sentence)
    kept = tmp_path / "out_map1.npz"
    assert f"The map was kept in {kept} (--initial starts from it)." in ran.output
    assert other.read_bytes() == b"the user's own"
    monkeypatch.undo()
    again = ("--initial", kept, "--detail", "fast", "--force")
    ran = run(zoomout, "transfer", source, meshes[1], "-o", tmp_path / "out.glb", *again)
    assert ran.exit_code == 0, ran.output


@pytest.mark.parametrize("stage", ["transfer_landmarks", "write_landmark_file"])
def test_failed_landmark_transfer_keeps_the_map(
    stage: str, meshes: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OutputError("The disk is full.")

    monkeypatch.setattr(landmarks_command, stage, fail)
    (tmp_path / "l.csv").write_text("1\n20\n")
    arguments = (meshes[0], tmp_path / "l.csv", meshes[1], "-o", tmp_path / "out.csv", "--force", *FAST)
    ran = run(zoomout, "landmarks", *arguments)
    assert_refused(ran, f"The disk is full. The map was kept in {tmp_path / 'out_map.npz'} (--initial starts from it).")
    assert zo.SurfaceMap.load(tmp_path / "out_map.npz", zo.read_surface(meshes[0]))


@pytest.mark.parametrize("stage", ["_merge", "save_beside"])
def test_a_transfer_of_meshlab_that_fails_keeps_the_map(
    stage: str, meshes: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pymeshlab")
    commands, batch = import_module("meshlab_filter.commands"), import_module("meshlab_filter.batch")
    transfer = import_module("meshlab_filter.filters.transfer")

    def fail(*_: object) -> None:
        raise KeyError("joints")

    monkeypatch.setattr(transfer if stage == "_merge" else batch, stage, fail)
    add_colors(source := meshes[0])
    ran = run(commands.main, "transfer", source, meshes[1], "-o", tmp_path / "out.ply", "--force", *FAST)
    assert_refused(ran, f"The map was kept in {tmp_path / 'out_map.npz'} (--initial starts from it).")
    assert zo.SurfaceMap.load(tmp_path / "out_map.npz", zo.read_surface(source))


def test_failed_target_does_not_stop_the_others(
    meshes: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    transfer_asset = transfer_command.transfer_asset
    failing = iter([True, False])

    def fail(*arguments: Any, **options: Any) -> Any:
        if next(failing):
            raise KeyError("joints")
        return transfer_asset(*arguments, **options)

    monkeypatch.setattr(transfer_command, "transfer_asset", fail)
    source, out = colored(meshes[0]), tmp_path / "out"
    ran = run(zoomout, "transfer", source, *meshes, "-o", out, "--force", *FAST)
    assert ran.exit_code == 3, ran.output
    assert {path.name for path in out.iterdir()} == {"source_map.npz", "target.glb", "report.json"}


def test_a_map_that_cannot_be_written_is_kept_elsewhere(
    meshes: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere, out = tmp_path / "temporary", tmp_path / "out"
    elsewhere.mkdir()
    out.mkdir()

    def save(result: zo.MatchResult, path: Path) -> None:
        if path.parent == out:
            raise OutputError("The disk is full.")
        maps.save_match(result, path)

    monkeypatch.setattr(match_command, "save_match", save)
    monkeypatch.setattr(maps, "mkdtemp", lambda prefix: str(elsewhere))
    ran = run(zoomout, "match", *meshes, "-o", out / "map.npz", *FAST)
    assert_refused(ran, f"The disk is full. The map was kept in {elsewhere / 'map_map.npz'} (")
    assert zo.SurfaceMap.load(elsewhere / "map_map.npz", zo.read_surface(meshes[0]))
    monkeypatch.setattr(maps, "mkdtemp", lambda prefix: str(out))
    assert_refused(run(zoomout, "match", *meshes, "-o", out / "map.npz", *FAST), "The disk is full.")


def test_unwritable_symmetry_is_kept_elsewhere(
    meshes: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save = symmetry_command._save

    def fail(symmetry: zo.Symmetry, path: Path) -> None:
        if path.name == "out.npz":
            raise OutputError("The disk is full.")
        save(symmetry, path)

    monkeypatch.setattr(symmetry_command, "_save", fail)
    ran = run(zoomout, "symmetry", meshes[0], "-o", tmp_path / "out.npz", "--detail", "fast")
    assert_refused(ran, f"The disk is full. The map was kept in {tmp_path / 'out_map.npz'}.")
    assert "side" in np.load(tmp_path / "out_map.npz")


def test_a_collection_whose_report_fails_names_its_maps(
    meshes: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OutputError("report.json could not be written.")

    monkeypatch.setattr(collection_command, "write_reports", fail)
    out = tmp_path / "out"
    ran = run(zoomout, "collection", *meshes, "-o", out, "--workers", "1", "--detail", "fast", "--no-pictures")
    assert_refused(ran, f"could not be written. The maps are in {out / 'maps'}: run the command again")
    assert list((out / "maps").rglob("*.npz"))


@pytest.mark.slow(but=1)
@pytest.mark.skipif(sys.platform != "linux", reason="names are Unicode elsewhere")
@pytest.mark.parametrize("name", [b"caf\xe9.ply", b"\xff\xfe.ply", "人 ü.ply".encode()])
def test_file_name_in_any_encoding_is_accepted(name: bytes, meshes: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(name)
    path.write_bytes(meshes[0].read_bytes())
    out = tmp_path / "out"
    options = ("--template", path, "--transfer", "--workers", "1", "--detail", "fast")
    colored(meshes[0])
    ran = run(zoomout, "collection", meshes[1], path, "-o", out, *options[:2], *options[3:])
    assert ran.exit_code == 0, ran.output
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    shown = name.removesuffix(b".ply").decode("utf-8", "backslashreplace")
    assert set(report["shapes"]) == {"target", shown}
    assert shown in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_failed_name_in_any_encoding_is_in_the_report(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    broken = tmp_path / os.fsdecode(b"broken\xe9.ply") if sys.platform == "linux" else tmp_path / "broken.ply"
    broken.write_bytes(b"ply")
    out = tmp_path / "out"
    line, environment = command("collection", *meshes, broken, "-o", out, "--workers", "1", "--detail", "fast")
    ran = subprocess.run(line, env=environment, capture_output=True)
    assert ran.returncode == 3, ran.stderr
    assert b"broken" in ran.stdout
    assert "broken" in (out / "report.html").read_text(encoding="utf-8")


# --- where the report is printed -----------------------------------------------------------------------------


def command(*arguments: str | Path, **variables: str) -> tuple[list[str], dict[str, str]]:
    return [sys.executable, "-m", "zoomout_core", *map(str, arguments)], os.environ | variables


@POSIX
@pytest.mark.parametrize("place", ["/dev/full", "a closed one"])
def test_report_that_cannot_be_printed_keeps_outputs(place: str, meshes: tuple[Path, Path], tmp_path: Path) -> None:
    line, environment = command("match", *meshes, "-o", tmp_path / "map.npz", "--initial", "nearest")
    if place == "/dev/full" and not Path(place).exists():
        pytest.skip("there is none")
    redirected = f'exec "$@" >{place if place == "/dev/full" else "&-"}'
    ran = subprocess.run(["sh", "-c", redirected, "sh", *line], env=environment, stderr=subprocess.PIPE, text=True)
    assert zo.SurfaceMap.load(tmp_path / "map.npz", zo.read_surface(meshes[0]))
    assert "Traceback" not in ran.stderr
    assert "Exception ignored" not in ran.stderr
    if place == "/dev/full":
        assert ran.returncode == 1
        assert "could not be printed (No space left on device), but all output files are complete" in ran.stderr


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("encoding", ["cp1252", "ascii", "latin-1", "cp437"])
def test_terminal_encoding_does_not_fail_a_match(encoding: str, meshes: tuple[Path, Path], tmp_path: Path) -> None:
    output = tmp_path / "人.npz"
    line, environment = command("match", *meshes, "-o", output, "--initial", "nearest", PYTHONIOENCODING=encoding)
    ran = subprocess.run(line, env=environment, capture_output=True)
    assert ran.returncode == 0, ran.stderr
    assert output.exists()
    assert rb"\u4eba.npz" in ran.stdout or "人.npz".encode() in ran.stdout  # click prints UTF-8 instead of ASCII


@pytest.mark.slow
@POSIX
def test_material_name_outside_locale_is_written(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    source = tmp_path / "source.obj"
    lines = meshes_as_obj(meshes[0])
    source.write_text("\n".join(["mtllib skin.mtl", "usemtl Haut 人", *lines, ""]), encoding="utf-8")
    (tmp_path / "skin.mtl").write_text("newmtl Haut 人\nKd 1 0 0\n", encoding="utf-8")
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    line, environment = command("transfer", source, meshes[1], "-o", tmp_path / "out.obj", "--force", *FAST, **plain)
    ran = subprocess.run(line, env=environment, capture_output=True)
    assert ran.returncode == 0, ran.stderr
    assert "newmtl Haut 人" in (tmp_path / "out.mtl").read_text(encoding="utf-8")
    assert "usemtl Haut 人" in (tmp_path / "out.obj").read_text(encoding="utf-8")


def meshes_as_obj(path: Path) -> list[str]:
    surface = zo.read_surface(path)
    vertices = [f"v {x} {y} {z}" for x, y, z in surface.vertices]
    return [*vertices, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in surface.triangles)]


# --- files of arrays -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("compressed", [True, False])
def test_a_disk_that_becomes_full_is_one_error(
    compressed: bool, tmp_path: Path, size_limit: Limit, monkeypatch: pytest.MonkeyPatch
) -> None:
    unraisable: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", unraisable.append)
    arrays = {"numbers": np.random.default_rng(0).random(10_000)}
    with size_limit(2048), pytest.raises(OutputError, match="File too large"), atomic_write(tmp_path / "a.npz") as part:
        write_arrays(part, arrays, compressed)
    assert not unraisable
    assert not contents(tmp_path)
    write_arrays(tmp_path / "a.npz", arrays, compressed)
    np.testing.assert_array_equal(np.load(tmp_path / "a.npz")["numbers"], arrays["numbers"])


def test_output_check_leaves_no_files(tmp_path: Path) -> None:
    check_output(tmp_path / "a.npz")
    check_output(os.devnull)
    assert not contents(tmp_path)
