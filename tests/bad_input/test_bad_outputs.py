# SPDX-License-Identifier: GPL-3.0-or-later
"""Outputs that cannot be written, or that are inputs: existing files are kept, and a sentence gives the reason."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from interfaces import Limit, add_colors, assert_refused, contents, run

from zoomout_core.cli import main as zoomout
from zoomout_core.runtime.outputs import ABANDONED, OutputError, atomic_write, atomic_write_together, check_output

# --- written whole or not at all ----------------------------------------------------------------------------


def test_failed_write_keeps_the_existing_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("before")
    with pytest.raises(RuntimeError), atomic_write(path) as part:  # noqa: PT012
        part.write_text("half")
        raise RuntimeError
    assert contents(tmp_path) == {"a.txt": b"before"}
    kept = r"a\.txt could not be written \(.*\), and the existing file was kept"
    with pytest.raises(OutputError, match=kept), atomic_write(path):
        pass  # like a library that fails silently
    assert contents(tmp_path) == {"a.txt": b"before"}
    new = r"b\.txt could not be written \([^)]*\): check disk space"
    with pytest.raises(OutputError, match=new), atomic_write(tmp_path / "b.txt"):
        pass


def test_silently_truncated_write_is_noticed(tmp_path: Path, size_limit: Limit) -> None:
    path = tmp_path / "a.txt"
    path.write_text("before")
    with size_limit(4096), pytest.raises(OutputError, match="File too large"), atomic_write(path) as part:
        part.write_bytes(b"x" * 4096)  # all that a library that ignores errors gets onto the disk
    assert contents(tmp_path) == {"a.txt": b"before"}
    with size_limit(4096), pytest.raises(OutputError), atomic_write_together(path) as whole:  # noqa: PT012
        whole.with_name("texture.png").write_bytes(b"x" * 4096)
        whole.write_text("after")
    assert contents(tmp_path) == {"a.txt": b"before"}


def test_killed_write_keeps_file_and_its_remains_are_removed_later(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("before")
    code = f"""
import os, signal
from zoomout_core.runtime.outputs import atomic_write
with atomic_write({str(path)!r}) as part:
    part.write_text("half")
    os.kill(os.getpid(), signal.{"SIGKILL" if hasattr(signal, "SIGKILL") else "SIGTERM"})
"""
    subprocess.run([sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    assert path.read_text() == "before"
    (remains,) = set(tmp_path.iterdir()) - {path}
    with atomic_write(path) as part:
        part.write_text("after")
    assert remains.exists()  # it might be another process's
    os.utime(remains, (remains.stat().st_mtime - 2 * ABANDONED,) * 2)
    with atomic_write(tmp_path / "b.txt") as part:
        part.write_text("other")
    assert contents(tmp_path) == {"a.txt": b"after", "b.txt": b"other"}


def test_links_permissions_and_long_names_stay(tmp_path: Path) -> None:
    path, link = tmp_path / ("n" * 250 + ".txt"), tmp_path / "link.txt"
    path.write_text("before")
    path.chmod(0o640)
    link.symlink_to(path)
    with atomic_write(link) as part:
        part.write_text("after")
    assert link.is_symlink()
    assert path.read_text() == "after"
    assert path.stat().st_mode & 0o777 == 0o640


def test_device_is_written_directly() -> None:
    with atomic_write(os.devnull) as part:
        assert str(part) == os.devnull


# --- outputs that are inputs --------------------------------------------------------------------------------


def test_an_input_is_recognised_by_any_name(tmp_path: Path) -> None:
    path, hard, soft = (tmp_path / name for name in ("a.ply", "hard.ply", "soft.ply"))
    path.touch()
    hard.hardlink_to(path)
    soft.symlink_to(path)
    for other in (path, hard, soft, tmp_path / "." / "a.ply"):
        with pytest.raises(OutputError, match="is an input, and would be overwritten"):
            check_output(other, [tmp_path / "missing", path])
        check_output(other, [path], in_place=True)


def test_match_does_not_overwrite_its_initial_map(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "map.npz"
    assert run(zoomout, "match", *meshes, "-o", path, "--initial", "nearest").exit_code == 0
    before = contents(tmp_path)
    for option in ("--initial", "--earlier-map"):
        assert_refused(
            run(zoomout, "match", *meshes, "-o", path, option, path), "map.npz is an input, and would be overwritten"
        )
    assert contents(tmp_path) == before
    again = run(zoomout, "match", *meshes, "-o", path, "--detail", "fast", "--initial", path, "--in-place")
    assert again.exit_code == 0, again.output


def test_full_disk_keeps_the_existing_map(meshes: tuple[Path, Path], tmp_path: Path, size_limit: Limit) -> None:
    path = tmp_path / "map.npz"
    np.savez(path, vertex=np.arange(3))
    before = contents(tmp_path)
    with size_limit(2048):
        ran = run(zoomout, "match", *meshes, "-o", path, "--initial", "nearest")
    assert_refused(ran, "map.npz could not be written (File too large)")
    assert contents(tmp_path) == before


def test_unwritable_folder_is_refused_before_match(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    if os.name != "posix" or os.geteuid() == 0:
        pytest.skip("permissions do not hold this user back")
    folder = tmp_path / "locked"
    folder.mkdir(0o555)
    assert_refused(run(zoomout, "match", *meshes, "-o", folder / "map.npz"), "locked cannot be written to")


@pytest.mark.parametrize("name", ["character.glb", "scan.ply", "truth.txt"])
def test_samples_replace_no_file_of_the_folder(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("mine")
    assert_refused(run(zoomout, "sample", tmp_path), f"{tmp_path / name} exists: remove it, or choose another folder.")
    assert contents(tmp_path) == {name: b"mine"}


@pytest.mark.parametrize(
    ("name", "fault"), [("x" * 300 + ".npz", "is too long for a file"), ("a\0b.npz", "null character")]
)
def test_a_name_that_no_file_can_have_is_refused(name: str, fault: str, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=fault):
        check_output(tmp_path / name)
    with pytest.raises(OutputError, match=fault), atomic_write(tmp_path / name):
        pass


@pytest.mark.parametrize("output", ["a_file", "/dev/null"])
def test_file_in_place_of_an_output_folder_is_refused_before_match(
    output: str, meshes: tuple[Path, Path], tmp_path: Path
) -> None:
    add_colors(meshes[0])
    (tmp_path / "a_file").touch()
    assert_refused(run(zoomout, "transfer", *meshes, "-o", tmp_path / output), "is a file: give a folder, or")


def test_too_long_name_of_an_output_is_one_sentence(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    add_colors(meshes[0])
    assert_refused(run(zoomout, "transfer", *meshes, "-o", tmp_path / f"{'x' * 300}.glb"), "is too long for a file")


def test_empty_name_of_an_output_is_named(meshes: tuple[Path, Path]) -> None:
    ran = run(zoomout, "transfer", *meshes, "-o", "")
    assert (ran.exit_code, "'--output': it is empty: give a path" in ran.output) == (2, True)


def test_full_disk_in_a_trial_is_not_a_fault_of_the_file(
    meshes: tuple[Path, Path], tmp_path: Path, size_limit: Limit
) -> None:
    add_colors(meshes[0])
    with size_limit(1000):
        ran = run(zoomout, "transfer", *meshes, "-o", tmp_path / "out.glb")
    assert_refused(ran, "check disk space and permissions, or choose another place")
    assert "correct the file" not in ran.output


def test_file_in_place_of_a_folder_of_levels_is_refused(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "a_file").touch()
    assert_refused(run(zoomout, "lods", meshes[0], "-o", tmp_path / "a_file"), "is a file: give a folder, or")
