# SPDX-License-Identifier: GPL-3.0-or-later
"""`blender --command zoomout`: outputs that are inputs, and outputs that cannot be written."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy
import pytest
from interfaces import Limit, contents

import blender_addon
from blender_addon import cli


@pytest.fixture(autouse=True)
def scene(meshes: tuple[Path, Path], tmp_path: Path) -> Iterator[None]:
    """The two meshes in a saved file that is open."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for name, path in zip(("Source", "Target"), meshes, strict=True):
        bpy.ops.wm.ply_import(filepath=str(path))
        bpy.context.object.name = name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "open.blend"))
    blender_addon.register()
    yield
    blender_addon.unregister()


def match(*more: object) -> int:
    pair = ("--source", "Source", "--target", "Target", "--initial", "nearest")
    return cli.main(["match", *pair, *map(str, more)])


@pytest.mark.parametrize("option", ["--save", "--report"])
def test_open_file_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str) -> None:
    before = contents(tmp_path)
    assert match(option, tmp_path / "open.blend") == 1
    assert "open.blend is an input, and would be overwritten" in capsys.readouterr().err
    assert contents(tmp_path) == before


def test_two_outputs_cannot_share_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert match("--save", tmp_path / "a.blend", "--report", tmp_path / "a.blend") == 1
    assert "--save and --report both name" in capsys.readouterr().err


def test_in_place_overwrites_the_open_file(tmp_path: Path) -> None:
    before = contents(tmp_path)
    assert match("--save", tmp_path / "open.blend", "--in-place") == 0
    after = contents(tmp_path)
    assert set(after) == set(before)
    assert after["open.blend"] != before["open.blend"]


def test_full_disk_keeps_the_existing_file(
    tmp_path: Path, size_limit: Limit, capsys: pytest.CaptureFixture[str]
) -> None:
    out, report = tmp_path / "out.blend", tmp_path / "report.json"
    out.write_text("before")
    before = contents(tmp_path)
    with size_limit(16384):
        assert match("--save", out, "--report", report) == 1
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("zoomout: ")]
    assert "out.blend could not be written" in line
    assert '"saved"' not in report.read_text()
    report.unlink()
    assert contents(tmp_path) == before
