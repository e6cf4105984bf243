# SPDX-License-Identifier: GPL-3.0-or-later
"""`make setup` shows the project's own messages; pip's output goes to a log, whose end is shown on failure."""

from __future__ import annotations

import sys
from importlib.metadata import distributions
from pathlib import Path
from threading import Thread

import bootstrap
import pytest

from zoomout_core.mesh.formats.blender_files import ENTRY_POINTS

DOWNLOAD = "  Downloading bpy-5.0.1-cp311-cp311-manylinux_2_28_x86_64.whl (375.2 MB)"


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The root of a project whose `.venv` has no Python."""
    folder = tmp_path / ".venv"
    (folder / "lib" / "python3.11" / "site-packages").mkdir(parents=True)
    monkeypatch.setattr(bootstrap, "ROOT", tmp_path)
    monkeypatch.setattr(bootstrap, "LOG", tmp_path / "build" / "setup.log")
    monkeypatch.setattr(bootstrap, "ENVIRONMENT", folder)
    monkeypatch.setattr(bootstrap, "ENVIRONMENT_PYTHON", folder / "python")
    monkeypatch.setattr(bootstrap, "STAMP", folder / "setup-stamp")
    return tmp_path


def write_python(root: Path, script: str) -> None:
    """Write a shell script in place of the Python of `.venv`."""
    python = root / ".venv" / "python"
    python.write_text(f"#!/bin/sh\n{script}\n")
    python.chmod(0o755)


def test_pip_output_goes_to_log_and_large_downloads_are_shown(
    environment: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    lines = ["Collecting bpy==5.0.1", DOWNLOAD, "Installing collected packages: numpy, bpy, zoomout-core"]
    write_python(environment, "\n".join(f"echo '{line}'" for line in lines))
    bootstrap.install_project("dev", "Blender")
    shown, errors = capfd.readouterr()
    assert shown.splitlines() == [
        "setup: installing Blender... (log: build/setup.log)",
        "setup: downloading bpy 5.0.1 (375 MB)",
        "setup: unpacking 3 packages",
    ]
    assert not errors
    command, *output = bootstrap.LOG.read_text().splitlines()
    assert command.startswith("$ ")
    assert command.endswith("--editable .[dev]")
    assert "--no-compile" in command.split()
    assert output == lines


def test_building_the_extension_needs_neither_hosts_nor_the_core(
    environment: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_python(environment, "echo 3 11")
    (environment / "pyproject.toml").touch()
    asked = []
    monkeypatch.setattr(bootstrap, "provide_system_packages", lambda needs_venv, hosts: asked.append(hosts))
    monkeypatch.setattr(bootstrap, "run_logged", lambda command: pytest.fail(f"ran {command}"))
    bootstrap.set_up("extension")
    assert asked == [False]
    assert bootstrap.STAMP.read_text() == bootstrap.finished_stamp("")


def test_the_extension_beside_the_core_is_found_by_its_entry_points(environment: Path) -> None:
    write_python(environment, "true")
    bootstrap.install_project("dev", "Blender")
    (packages,) = environment.glob(".venv/lib/python3*/site-packages")
    (found,) = distributions(path=[str(packages)])
    modules = {entry.name: entry.module for entry in found.entry_points if entry.group == ENTRY_POINTS}
    assert modules == {"main": "blender_addon", "demo": "blender_addon.demo"}


def test_a_failure_of_pip_shows_the_end_of_the_log(environment: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_python(environment, "for i in $(seq 50); do echo line $i; done; echo 'ERROR: no network' >&2; exit 1")
    with pytest.raises(SystemExit) as ended:
        bootstrap.install_project("dev", "Blender")
    *tail, reason = str(ended.value).splitlines()
    assert tail == [*(f"    line {number}" for number in range(32, 51)), "    ERROR: no network"]
    assert reason.startswith("setup: pip could not install the project: ")
    assert reason.endswith("The whole log: build/setup.log")
    assert capfd.readouterr() == ("setup: installing Blender... (log: build/setup.log)\n", "")
    assert not bootstrap.STAMP.exists()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (DOWNLOAD, "downloading bpy 5.0.1 (375 MB)"),
        (
            "Downloading https://files.example.org/a/pymeshlab-2025.7-cp311-cp311-manylinux_2_35_x86_64.whl (98 MB)",
            "downloading pymeshlab 2025.7 (98 MB)",
        ),
        ("  Downloading numpy-1.26.4-cp311-cp311-manylinux_2_17_x86_64.whl (18.3 MB)", None),
        ("  Downloading click-8.1.8-py3-none-any.whl (98 kB)", None),
        ("Installing collected packages: zoomout-core", None),
    ],
)
def test_steps_that_can_take_minutes_are_shown(line: str, message: str | None) -> None:
    assert bootstrap.progress_message(line) == message


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no flock")
def test_a_second_setup_waits_for_the_first(
    environment: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bootstrap, "LOCK", environment / "build" / "setup.lock")
    order = []

    def second() -> None:
        with bootstrap.lock():
            order.append("second")

    waiting = Thread(target=second)
    with bootstrap.lock():
        waiting.start()
        while "waiting for another make" not in capfd.readouterr().out:
            assert waiting.is_alive()
        order.append("first")
    waiting.join()
    assert order == ["first", "second"]


@pytest.mark.parametrize(
    ("present", "wanted", "installed"),
    [
        (None, "docs", "docs"),
        ("all", "docs", "all and docs"),
        ("docs", "all", "all and docs"),
        ("docs", "core", None),
        ("all and docs", "docs", None),
        ("release", "all", None),
    ],
)
def test_setup_adds_extras_and_keeps_installed_ones(
    environment: Path, monkeypatch: pytest.MonkeyPatch, present: str | None, wanted: str, installed: str | None
) -> None:
    (environment / "pyproject.toml").touch()
    seen: list[str] = []
    for name in ("provide_system_packages", "create_environment"):
        monkeypatch.setattr(bootstrap, name, lambda **_: None)
    monkeypatch.setattr(bootstrap, "environment_is_usable", lambda: True)
    monkeypatch.setattr(bootstrap, "install_project", lambda extra, _: seen.append(extra))
    monkeypatch.setattr(bootstrap, "check_hosts", lambda: seen.append("hosts"))
    if present is not None:
        bootstrap.STAMP.write_text(bootstrap.finished_stamp(bootstrap.EXTRAS[present][0]))
    bootstrap.set_up(wanted)
    hosts = [] if installed in (None, "docs") else ["hosts"]
    assert seen == ([] if installed is None else [bootstrap.EXTRAS[installed][0], *hosts])
