# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths that no command can use are refused by every command in one sentence, and nothing is written."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from pathlib import Path

import click
import pytest
from interfaces import assert_refused, contents, run

from meshlab_filter.commands import main as meshlab
from zoomout_core import __main__ as entry
from zoomout_core.cli import main as zoomout
from zoomout_core.cli.group import CommandGroup
from zoomout_core.command_options import FilePath
from zoomout_core.global_options import quiet_option
from zoomout_core.mesh.formats.opening import existing
from zoomout_core.messages import message_of
from zoomout_core.runtime.outputs import OutputError, atomic_write

LONG = "x" * 300


def commands() -> Iterable[tuple[str, click.Group, str]]:
    for group in (zoomout, meshlab):
        for name in group.list_commands(click.Context(group)):
            yield f"{group.name} {name}", group, name


def paths_of(group: click.Group, name: str) -> list[click.Parameter]:
    command = group.get_command(click.Context(group), name)
    assert command is not None
    return [each for each in command.params if isinstance(each.type, click.Path)]


@pytest.mark.parametrize(("group", "name"), [row[1:] for row in commands()], ids=[row[0] for row in commands()])
def test_empty_paths_are_refused(
    group: click.Group, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Click would turn an empty path, such as an unset variable of a shell, into the working folder."""
    monkeypatch.chdir(tmp_path)
    for parameter in paths_of(group, name):
        with pytest.raises(click.ClickException, match="is empty: give"):
            parameter.type.convert("", parameter, None)
        assert isinstance(parameter.type, FilePath)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "arguments",
    [
        ("library", "{long}"),
        ("find", "{long}.ply", "--library", "."),
        ("find", "a.ply", "--library", "{long}"),
        ("outfits", "{long}.glb", "a.glb", "-o", "out"),
        ("outfits", "a.glb", "b.glb", "-o", "{long}"),
        ("update", "{long}.glb", "b.glb", "c.glb", "-o", "d.glb"),
        ("landmarks", "a.ply", "{long}.csv", "c.ply", "-o", "d.csv"),
        ("collection", "a.ply", "{long}.ply", "-o", "out"),
        ("collection", "a.ply", "b.ply", "-o", "{long}"),
        ("sample", "{long}"),
        ("info", "{long}.glb"),
    ],
    ids=" ".join,
)
def test_names_that_are_too_long_are_refused(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a.ply", "b.ply", "c.ply", "a.glb", "b.glb", "c.glb"):
        (tmp_path / name).write_text("")
    before = contents(tmp_path)
    assert_refused(run(zoomout, *(each.format(long=LONG) for each in arguments)), "oo long")
    assert contents(tmp_path) == before


def test_errors_of_the_system_become_sentences(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="Errno") as error:
        (tmp_path / LONG).stat()
    said = message_of(error.value)
    assert said.startswith(str(tmp_path))
    assert said.endswith("could not be used (File name too long): check the path and its permissions.")
    assert len(message_of(OSError(36, "Too long", "y" * 5000))) < 400
    assert message_of(OSError(28, "No space left")).startswith("A file could not be read or written (No space left)")
    assert message_of(OutputError("It is full: empty it.")) == "It is full: empty it."
    assert message_of(ValueError("It is odd: make it even.")) == "It is odd: make it even."


def test_an_error_about_a_file_is_not_taken_for_one_of_the_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The entry point reports other system errors as those of standard output."""

    @click.command()
    def fails() -> None:
        (tmp_path / "gone").read_bytes()

    group = CommandGroup("group", summaries={})
    group.add_command(quiet_option(fails))
    monkeypatch.setattr(entry, "import_module", lambda _: type("Module", (), {"main": group}))
    monkeypatch.setattr(entry, "drop_output", lambda: None)
    monkeypatch.setattr(sys, "argv", ["zoomout", "fails"])
    with pytest.raises(SystemExit, match=r"gone could not be used \(No such file"):
        entry._run("zoomout_core.cli", "zoomout")


@pytest.mark.parametrize("command", ["outfits", "find", "collection"])
@pytest.mark.parametrize("place", ["", "report.json", "report.html", "maps", "targets", "dressed"])
def test_results_are_refused_before_work_where_something_else_is_in_their_place(
    command: str, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    replaced = {"outfits": {"maps", "dressed"}, "find": {"targets"}, "collection": {"maps"}}[command]
    reports = {"", "report.json", "report.html"}
    if place not in replaced | reports:
        return
    out = tmp_path / "out"
    if place.startswith("report"):
        (out / place).mkdir(parents=True)
    else:
        out.mkdir(exist_ok=True) if place else None
        (out / place if place else out).write_text("mine")
    for name in ("a.glb", "b.glb"):
        (tmp_path / name).write_text("")
    arguments = {
        "outfits": ("outfits", "a.glb", "b.glb", "-o", "out"),
        "find": ("find", "a.glb", "--library", ".", "-o", "out"),
        "collection": ("collection", "a.glb", "b.glb", "-o", "out"),
    }[command]
    before = contents(tmp_path)
    kind = "is a folder: give the name" if place.startswith("report") else "is a file: name a folder"
    assert_refused(run(zoomout, *arguments), kind)
    assert contents(tmp_path) == before


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes")
def test_pipes_and_broken_links_are_no_folders_for_results(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    assert_refused(run(zoomout, "sample", tmp_path / "pipe"), "is a file: name a folder")
    assert_refused(run(zoomout, "sample", tmp_path / "link"), "is a link that leads nowhere: name a folder")


def test_a_default_cache_that_cannot_be_searched_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A service may have the home folder of another user."""
    really = os.stat

    def stat(path: str, **options: object) -> os.stat_result:
        if "locked" in os.fspath(path).split(os.sep)[-2:]:
            raise PermissionError(13, "Permission denied", path)
        return really(path, **options)

    monkeypatch.setattr(os, "stat", stat)
    cache = tmp_path / "locked" / "zoomout"
    ran = run(zoomout, "match", tmp_path / "a.ply", tmp_path / "b.ply", "-o", tmp_path / "m.npz", "--cache", cache)
    assert_refused(ran, "a.ply")  # the work has begun


def test_existing_names_a_file_that_is_too_long(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="too long"):
        existing(tmp_path / LONG)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_full_device_is_named() -> None:
    sentence = r"^/dev/full could not be written \(No space left on device\): check"
    with pytest.raises(OutputError, match=sentence), atomic_write("/dev/full") as part:
        part.write_text("report")
