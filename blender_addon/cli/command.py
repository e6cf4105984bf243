# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the command on the open file, print the outcome, and write the report."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import bpy

import zoomout_core as zo
from zoomout_core.assets.files import inputs_of
from zoomout_core.matching.report.verdict import select_notes
from zoomout_core.mesh.formats.blender_files import split_asset
from zoomout_core.messages import message_of, note_figures, note_lines
from zoomout_core.runtime.outputs import atomic_write, check_output

from ..scene.files import check_writable_format, save_scene
from . import arguments, files, pairs, symmetry

# Exit codes of the process; argparse uses 2 for an invalid command line.
DONE, FAILED = 0, 1
RUN = {
    "match": pairs.match,
    "transfer": pairs.transfer,
    "wrap": pairs.wrap,
    "dress": pairs.dress,
    "symmetry": symmetry.run,
    "carry": files.carry,
    "faces": files.faces,
    "surface": files.surface,
    "assets": files.assets,
    "library": files.library,
    "outfits": files.outfits,
}
# Commands that read two files.
OF_FILES = ("carry", "faces")
# Commands without a source and targets, and the objects that they work on.
WITHOUT_PAIRS = {
    "symmetry": "objects",
    "surface": "objects",
    "assets": "assets",
    "library": "folders",
    "outfits": "objects",
}
# Commands that write their files themselves.
WRITING = ("surface", "outfits")


def run(command_line: Sequence[str]) -> int:
    """`cli.main`, without the handling of interrupts."""
    try:
        options = arguments.parse(command_line)
        _check_paths(options)
    except SystemExit as ended:  # after --help, or with the usage on the terminal
        return int(ended.code or 0)
    except (ValueError, OSError) as error:  # nothing was done or written
        print(f"zoomout: {message_of(error)}", file=sys.stderr)
        return FAILED
    command, done = options.command, WITHOUT_PAIRS.get(options.command, "targets")
    report: dict[str, Any] = {"command": command, **({"source": options.source} if done == "targets" else {}), done: {}}
    try:
        report[done] = RUN[command](bpy.context, options)
        failed = [f"'{name}': {entry['error']}" for name, entry in report[done].items() if "error" in entry]
        if getattr(options, "save", "") and _is_complete(command, len(failed), len(report[done])):
            if command not in WRITING:
                save_scene(options.save, [] if options.in_place else _inputs(options))
            report["saved"] = options.save
    except (ValueError, OSError, RuntimeError) as error:  # Blender raises the last, such as on a full disk
        report["error"] = message_of(error)
        failed = [report["error"]]
    report[done] = {name: _with_warnings(entry) for name, entry in report[done].items()}
    if options.report:
        try:
            with atomic_write(options.report) as part:
                part.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            failed.append(message_of(error))
    _print(command, "to" if done == "targets" else "of", report[done])
    for reason in failed:
        print(f"zoomout: {reason}", file=sys.stderr)
    return FAILED if failed else DONE


def _print(command: str, preposition: str, entries: Mapping[str, dict[str, Any]]) -> None:
    """Print the outcome of a command for each object, by its name."""
    for name, entry in entries.items():
        print(f"zoomout: {command} {preposition} '{name}' {'failed' if 'error' in entry else 'done'}")
        for line in _lines(entry):
            print(f"zoomout:   {line}")


def _with_warnings(entry: dict[str, Any]) -> dict[str, Any]:
    """A report that lists the warnings among its notes, if it has notes."""
    return entry | note_figures(entry["notes"]) if "notes" in entry else entry


def _lines(entry: Mapping[str, Any]) -> list[str]:
    """The lines of a report for the user: the verdict, completed and skipped work, and notes."""
    verdict = zo.Verdict(**entry["verdict"]) if entry.get("verdict") else None
    skipped = [f"{name}: skipped, {reason}" for name, reason in entry.get("skipped", {}).items()]
    left_out = entry.get("left_out", {}).values()
    notes = note_lines(select_notes(entry.get("notes", ()), verdict))
    return [*([verdict.line] if verdict else []), *entry.get("done", ()), *skipped, *left_out, *notes]


def _check_paths(options: argparse.Namespace) -> None:
    """Raise a MeshError or OutputError if results cannot be written, or would overwrite one another or their inputs."""
    named = {name: path for name in ("save", "report", "sheet") if (path := getattr(options, name, None))}
    for (one, path), (other, second) in combinations(named.items(), 2):
        if Path(path).resolve() == Path(second).resolve():
            raise zo.MeshError(f"--{one} and --{other} both name {path}: give them files of their own.")
    for path in named.values():
        check_output(path, _inputs(options), options.in_place)
    if named.get("save") and options.command not in WRITING:
        check_writable_format(options.save)


def _inputs(options: argparse.Namespace) -> list[str | Path]:
    """The files that a command reads, and those that the open file and the two files of some commands name."""
    named = (getattr(options, name, "") for name in ("map_file", "map", "file"))
    files = [split_asset(Path(options.source))[0], options.target] if options.command in OF_FILES else []
    return [*filter(None, [bpy.data.filepath, *named, *bpy.utils.blend_paths(absolute=True)]), *inputs_of(*files)]


def _is_complete(command: str, failed: int, entries: int) -> bool:
    """Whether the file can be saved: a failed target is unchanged, but a failed object may be changed in part."""
    return failed < entries if command != "symmetry" else not failed
