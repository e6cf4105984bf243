"""The command `blender --command zoomout`, for pipelines: matching, transferring and symmetry without a window.

blender --background FILE.blend --command zoomout transfer --source Hero --target Scan --save OUT.blend
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy

import zoomout_core as zo

from . import arguments, pairs, symmetry
from .arguments import NAME

# What the process ends with: argparse's 2 is for a command line that cannot be understood.
DONE, FAILED = 0, 1
RUN = {"match": pairs.match, "transfer": pairs.transfer, "wrap": pairs.wrap, "symmetry": symmetry.run}

_handle: Any = None


def register() -> None:
    """Make the command known to Blender."""
    global _handle
    _handle = bpy.utils.register_cli_command(NAME, main)


def unregister() -> None:
    """Take it away again."""
    bpy.utils.unregister_cli_command(_handle)


def main(command_line: Sequence[str]) -> int:
    """Run the command on the file that is open.

    Args:
        command_line: what follows the command's name.

    Returns:
        0 if all was done, 1 if some or all was not, 2 if the arguments cannot be understood.
    """
    try:
        options = arguments.parse(command_line)
    except SystemExit as ended:  # after --help, or with the usage on the terminal
        return int(ended.code or 0)
    command, done = options.command, "objects" if options.command == "symmetry" else "targets"
    report: dict[str, Any] = {"command": command, **({} if done == "objects" else {"source": options.source}), done: {}}
    try:
        _check_paths(options)
        report[done] = RUN[command](bpy.context, options)
        failed = [f"'{name}': {entry['error']}" for name, entry in report[done].items() if "error" in entry]
        if options.save and _is_complete(command, len(failed), len(report[done])):
            bpy.ops.wm.save_as_mainfile(filepath=str(Path(options.save).resolve()), copy=True)
            report["saved"] = options.save
    except (ValueError, RuntimeError) as error:  # the latter are Blender's own, as of a disk that is full
        report["error"] = str(error)
        failed = [report["error"]]
    if options.report:
        try:
            Path(options.report).write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            failed.append(f"The report could not be written: {error}.")
    for name, entry in report[done].items():
        print(
            f"zoomout: {command} {'of' if done == 'objects' else 'to'} '{name}' "
            f"{'failed' if 'error' in entry else 'done'}"
        )
    for reason in failed:
        print(f"zoomout: {reason}", file=sys.stderr)
    return FAILED if failed else DONE


def _check_paths(options: argparse.Namespace) -> None:
    """Raise a MeshError if the results could not be written."""
    for path in (Path(given).resolve() for given in (options.save, options.report) if given):
        if not path.parent.is_dir():
            raise zo.MeshError(f"There is no folder {path.parent}: create it, or write elsewhere.")
        if path.is_dir():  # Blender would save there all the same, and move the folder out of the way
            raise zo.MeshError(f"{path} is a folder: name a file in it.")


def _is_complete(command: str, failed: int, entries: int) -> bool:
    """Whether what was done is whole: a target that failed is as it was, an object of several changes may not be."""
    return failed < entries if command != "symmetry" else not failed
