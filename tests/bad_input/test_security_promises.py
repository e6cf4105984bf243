# SPDX-License-Identifier: GPL-3.0-or-later
"""The promises of SECURITY.md that no other file tests."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from creatures import creature

import zoomout_core as zo
from zoomout_core.collection.pair_map import PairRecord
from zoomout_core.collection.shapes import ShapeSummary
from zoomout_core.map_files import keep_map
from zoomout_core.maps.known_match import KnownMatch
from zoomout_core.matching.preparation.disk_cache import ShapeFolder
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats import blender_files
from zoomout_core.mesh.formats.blender_files import PROGRAM

REPOSITORY = Path(zo.__file__).parents[1]
PACKAGES = ("zoomout_core", "meshlab_filter", "blender_addon")
SURFACE = creature(100).surface
PROMISE = re.compile(r"^\d+\. \*\*.*", re.MULTILINE)
TEST = re.compile(r"`(?:bad_input/)?(test_\w+\.py)`")


def test_each_promise_names_its_tests() -> None:
    promises = PROMISE.findall((REPOSITORY / "SECURITY.md").read_text(encoding="utf-8"))
    assert len(promises) > 5
    for promise in promises:
        assert TEST.search(promise), promise
        for name in TEST.findall(promise):
            assert (REPOSITORY / "tests" / "bad_input" / name).is_file(), name


# --- a file is data ------------------------------------------------------------------------------------------

RUNNING = {"eval", "exec", "__import__"}
UNPICKLING = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve", "joblib", "yaml", "runpy", "code"}


@pytest.mark.parametrize("package", PACKAGES)
def test_code_never_evaluates_or_unpickles_text(package: str) -> None:
    read = 0
    for path in sorted((REPOSITORY / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            read += 1
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in RUNNING, f"{path}:{node.lineno}"
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = [alias.name for alias in node.names]
                modules = {name.partition(".")[0] for name in [*names, getattr(node, "module", None) or ""]}
                assert not modules & UNPICKLING or getattr(node, "level", 0), f"{path}:{node.lineno}"
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                assert isinstance(node.value, ast.Constant), path
                assert node.value.value is False, path
    assert read > 1000


class Bomb:
    """Writes a file when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self._mark = mark

    def __reduce__(self) -> tuple[Callable[..., object], tuple[object, ...]]:
        return Path.touch, (self._mark,)


READERS: dict[str, Callable[[Path], object]] = {
    "a map": lambda path: zo.SurfaceMap.load(path, SURFACE),
    "a result": lambda path: zo.load_result(path),
    "a known match": lambda path: KnownMatch.load(path, SURFACE, SURFACE),
    "a record of a collection": PairRecord.load,
    "a shape of a collection": ShapeSummary.load,
}
NAMES = (
    *("triangle", "barycentric", "vertex", "confidence", "key", "samples", "points", "distances", "eigenvalues"),
    *("tree", "record", "certainty", "functional_map"),
)


def test_a_pickle_runs_where_it_is_allowed(tmp_path: Path) -> None:
    """Otherwise the next tests could not fail."""
    np.savez(tmp_path / "a.npz", key=np.array([Bomb(tmp_path / "mark")], dtype=object))
    _ = np.load(tmp_path / "a.npz", allow_pickle=True)["key"]
    assert (tmp_path / "mark").exists()


@pytest.mark.parametrize("name", READERS)
def test_pickle_in_a_file_does_not_run(name: str, tmp_path: Path) -> None:
    bombs = np.array([Bomb(tmp_path / "mark")], dtype=object)
    np.savez(tmp_path / "a.npz", **dict.fromkeys(NAMES, bombs))
    with pytest.raises(ValueError, match=r"\S"):
        READERS[name](tmp_path / "a.npz")
    assert not (tmp_path / "mark").exists()


def test_pickle_in_the_cache_does_not_run(tmp_path: Path) -> None:
    folder, key = ShapeFolder(tmp_path / "cache"), b"0" * 8
    path = folder._path(key)
    path.parent.mkdir(parents=True)
    np.savez(path, **dict.fromkeys(NAMES, np.array([Bomb(tmp_path / "mark")], dtype=object)))
    assert folder.load(key, SURFACE.working) is None
    assert not (tmp_path / "mark").exists()


# --- scripts in a .blend -------------------------------------------------------------------------------------


def test_scripts_in_a_blend_do_not_run(tmp_path: Path) -> None:
    bpy = pytest.importorskip("bpy")
    mark, blend = tmp_path / "mark", tmp_path / "scripted.blend"
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=6)
    text = bpy.data.texts.new("start.py")
    text.from_string(f"open({str(mark)!r}, 'w').close()")
    text.use_module = True
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert not mark.exists()
    blender_files.write_surface(blend, tmp_path / "made.ply")
    assert (tmp_path / "made.ply").exists()
    assert not mark.exists()
    bpy.ops.wm.open_mainfile(filepath=str(blend), use_scripts=True)
    assert mark.exists()  # otherwise this test could not fail
    bpy.ops.wm.read_factory_settings(use_empty=True)


# --- no connections ------------------------------------------------------------------------------------------

OFFLINE = """
import sys
def watch(event, arguments):
    if event in ("socket.connect", "socket.bind", "socket.getaddrinfo", "socket.sendto", "urllib.Request"):
        print("network:", event, arguments, flush=True)
        raise SystemExit(99)
sys.addaudithook(watch)
from zoomout_core.__main__ import main
if __name__ == "__main__":
    for command in {commands!r}:
        sys.argv = ["zoomout", *command]
        try:
            main()
        except SystemExit as end:
            if end.code:
                raise
"""
COMMANDS = (
    ("info", "source.ply"),
    ("match", "source.ply", "target.ply", "-o", "map.npz", "--detail", "fast", "--initial", "proximity"),
    ("collection", "source.ply", "target.ply", "-o", "out", "--workers", "1", "--detail", "fast"),
    ("sample", "samples"),
)


@pytest.mark.slow
def test_commands_open_no_connection(meshes: tuple[Path, Path]) -> None:
    command = [sys.executable, "-c", OFFLINE.format(commands=COMMANDS)]
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    ran = subprocess.run(command, cwd=meshes[0].parent, env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert all((meshes[0].parent / made).exists() for made in ("map.npz", "out", "samples"))


def test_a_connection_would_be_noticed() -> None:
    code = OFFLINE.partition("from zoomout_core")[0] + "import socket\nsocket.create_connection(('127.0.0.1', 9))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 99


# --- results are the user's ----------------------------------------------------------------------------------


@pytest.mark.skipif(os.name != "posix", reason="permissions are others there")
def test_temporary_folders_are_private_to_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said, program = tmp_path / "said", tmp_path / "blender"
    program.write_text(f"#!/bin/sh\nls -ld . > '{said}'\n")
    program.chmod(0o755)
    monkeypatch.setenv(PROGRAM, str(program))
    with pytest.raises(MeshError, match="no result"):
        blender_files.write_surface(tmp_path / "a.blend", tmp_path / "a.ply")
    assert said.read_text().startswith("drwx------")


@pytest.mark.skipif(os.name != "posix", reason="permissions are others there")
def test_folder_of_kept_map_is_private_to_the_user(tmp_path: Path) -> None:
    kept: list[Path] = []

    def save(path: Path) -> None:
        if path.parent == tmp_path:
            raise OSError
        kept.append(path)

    with pytest.raises(MeshError, match="The map was kept"), keep_map(save, tmp_path / "out.glb"):
        raise ValueError("It is broken.")
    assert kept[0].parent.stat().st_mode & 0o777 == 0o700
    kept[0].parent.rmdir()
