# SPDX-License-Identifier: GPL-3.0-or-later
"""Every entry point detects folders without write permission before the work begins."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import bpy
import pytest
from interfaces import assert_refused, run

import blender_addon
from blender_addon import cli
from meshlab_filter.commands import main as meshlab
from zoomout_core.cli import main as zoomout
from zoomout_core.runtime import progress

Pair = tuple[Path, Path]
INTERFACES: dict[str, Callable[[Pair, Path], tuple[Any, ...]]] = {
    "zoomout match": lambda pair, folder: (zoomout, "match", *pair, "-o", folder / "map.npz"),
    "zoomout transfer onto several": lambda pair, folder: (
        *(zoomout, "transfer", *pair, pair[0].with_name("copy.ply"), "-o", folder),
    ),
    "zoomout transfer": lambda pair, folder: (zoomout, "transfer", *pair, "-o", folder / "made.ply"),
    "zoomout symmetry": lambda pair, folder: (zoomout, "symmetry", pair[0], "-o", folder / "symmetry.npz"),
    "meshlab_filter transfer": lambda pair, folder: (meshlab, "transfer", *pair, "-o", folder / "made.ply"),
    "meshlab_filter transfer onto several": lambda pair, folder: (
        *(meshlab, "transfer", pair[0], pair[1], pair[0].with_name("copy.ply"), "-o", folder),
    ),
}


@pytest.fixture
def locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that cannot be written to, not even by root."""
    folder, really = tmp_path / "locked", os.access
    folder.mkdir()
    monkeypatch.setattr(
        os, "access", lambda path, mode: not (Path(path) == folder and mode & os.W_OK) and really(path, mode)
    )
    return folder


@pytest.fixture(autouse=True)
def idle(monkeypatch: pytest.MonkeyPatch) -> None:
    """No work is done."""

    def begun(*_: object, **__: object) -> None:
        raise AssertionError("the work has begun")

    monkeypatch.setattr(progress, "_report", ContextVar("report", default=begun))


@pytest.mark.parametrize("interface", INTERFACES)
def test_unwritable_folder_is_reported_before_work(interface: str, meshes: Pair, locked: Path) -> None:
    (meshes[0].with_name("copy.ply")).write_bytes(meshes[1].read_bytes())
    assert_refused(run(*INTERFACES[interface](meshes, locked)), "locked is not writable: change its permissions")
    assert not list(locked.iterdir())


@pytest.mark.parametrize("option", ["--save", "--report"])
def test_blender_reports_unwritable_folder(
    option: str, meshes: Pair, locked: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for path in meshes:
        bpy.ops.wm.ply_import(filepath=str(path))
    with blender_addon.registered():
        ended = cli.main(["match", "--source", "source", "--target", "target", option, str(locked / "out")])
    assert ended == 1
    assert "locked is not writable" in capsys.readouterr().err
