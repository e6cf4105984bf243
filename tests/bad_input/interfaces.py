# SPDX-License-Identifier: GPL-3.0-or-later
"""Helpers of the tests of bad input: a command's output, and the content of a folder."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import trimesh
from click.testing import CliRunner, Result

# Limits the size of files in bytes, as a full disk does.
Limit = Callable[[int], AbstractContextManager[None]]


def run(command: Any, *arguments: str | Path) -> Result:
    """Run a command in this process."""
    return CliRunner().invoke(command, [str(argument) for argument in arguments])


def contents(folder: Path) -> dict[str, bytes]:
    """The content of all files in a folder and its subfolders."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def add_colors(path: Path) -> None:
    """Give a mesh file colours that can be transferred."""
    mesh = trimesh.load(path, process=False)
    mesh.visual.vertex_colors = [[1, 2, 3, 255]] * len(mesh.vertices)
    mesh.export(path)


def assert_refused(ran: Result, sentence: str) -> None:
    """Assert that a command ended with a sentence and not with a traceback."""
    assert ran.exit_code == 1, ran.output
    (line,) = [line for line in ran.output.splitlines() if line.startswith("Error:")]
    assert sentence in line, line
