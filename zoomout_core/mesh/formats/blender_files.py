# SPDX-License-Identifier: GPL-3.0-or-later
"""Read .blend, .fbx and other files through Blender, in a child process.

The process runs a command of this project's extension (`blender --command zoomout`), which writes its results to files.
It starts in an empty folder, see `runtime.child_process`.
An extension that is installed beside the core in a Python with `bpy` registers entry points in the group
`ENTRY_POINTS`, so that the core does not depend on its modules.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from zoomout_core.mesh.errors import MeshError
from zoomout_core.runtime.child_process import child_environment
from zoomout_core.runtime.progress import advance, stage

# Formats that only Blender reads, and others that it imports.
BLEND = ".blend"
ENDINGS = (BLEND, ".fbx")
IMPORTED = (".glb", ".gltf", ".obj", ".ply", ".stl")
# Whether to read the meshes of a file with modifiers applied, or as they are; see the extension's `surface --help`.
SOURCE, TARGET = "source", "target"
# The environment variable that names the program.
PROGRAM = "ZOOMOUT_BLENDER"
# Seconds that Blender may take for one command, and between two checks whether it has ended.
MAX_SECONDS, PATIENCE = 3600.0, 0.05
# The extension's entry points: `main`, the module that `python -m` runs, and `demo`, a module with `run` and `summary`.
ENTRY_POINTS = "zoomout.extension"
SAID = "zoomout: "
NO_BLENDER = (
    "Reading and writing .blend and .fbx files requires Blender: install Blender 4.2 or newer with the extension "
    f"ZoomOut Transfer, and put it on the PATH or set {PROGRAM} to it; or convert the file to glTF."
)


def extension_module(name: str) -> EntryPoint | None:
    """The module that an installed extension registers under a name; None without an extension or Blender (`bpy`)."""
    registered = entry_points(group=ENTRY_POINTS, name=name)
    return next(iter(registered), None) if find_spec("bpy") else None


def blender_command(program: str | None = None) -> list[str]:
    """The beginning of a command line of the extension.

    Args:
        program: Blender's program; by default the first of these: the one in the environment variable, the extension
            registered in this Python, the program on the path.

    Raises:
        MeshError: Blender is missing.
    """
    named = program or os.environ.get(PROGRAM)
    found = shutil.which(named or "blender")
    if found and not os.path.isabs(found) and found != named:
        found = None  # Windows looks for programs in the working folder first
    if named and found is None:
        raise MeshError(f"There is no program {named}: give the path of Blender 4.2 or newer.")
    if not named and (extension := extension_module("main")):
        return [sys.executable, "-m", extension.module]
    if found is None:
        raise MeshError(NO_BLENDER)
    return [os.path.abspath(found), "--background", "--disable-autoexec", "--command", "zoomout"]


def run_blender(arguments: Sequence[str], program: str | None = None) -> dict[str, Any]:
    """Run a command of the extension, with arguments except `--report` and with absolute paths, and return its report.

    Raises:
        MeshError: Blender is missing or failed; the message is Blender's.
        ChildProcessError: Blender was killed.
    """
    command, began = blender_command(program), monotonic()
    with tempfile.TemporaryDirectory(prefix="zoomout-") as folder:
        report, output = Path(folder) / "report.json", Path(folder) / "output.txt"
        with output.open("wb") as log, stage("Running Blender"):
            process = subprocess.Popen(
                [*command, *arguments, "--report", str(report)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=_environment(),
                cwd=folder,
            )
            try:
                while process.poll() is None:
                    if monotonic() - began > MAX_SECONDS:
                        raise MeshError(
                            f"Blender took more than {MAX_SECONDS / 60:.0f} minutes: give it a smaller file."
                        )
                    advance(0.0)
                    sleep(PATIENCE)
            finally:
                if process.poll() is None:
                    process.kill()
                process.wait()
        if process.returncode < 0:  # a retry may succeed
            raise ChildProcessError(
                f"Blender was terminated by signal {-process.returncode}: it may need more memory than is available."
            )
        found = json.loads(report.read_text(encoding="utf-8")) if report.is_file() else {}
        if "error" in found or not found:
            raise MeshError(found.get("error") or _last_words(output, command[0], process.returncode))
        return dict(found)


def write_surface(path: Path, output: Path, role: str = TARGET, program: str | None = None) -> None:
    """Write the visible meshes of a file that Blender reads as one surface, a PLY file.

    The role is `SOURCE` or `TARGET`.

    Raises:
        MeshError: Blender is missing or cannot read the file, or the file has no visible mesh.
    """
    run_blender(["surface", str(path.absolute()), "--role", role, "--save", str(output.absolute())], program)


def write_assets(path: Path, folder: Path, program: str | None = None) -> dict[str, Path | str]:
    """Write each asset of a file that Blender reads as one surface, a PLY file in a folder, with its modifiers.

    Assets are the collections and mesh objects that are marked for Blender's Asset Browser. If most of a file is not
    marked, all of its visible meshes are another asset, with an empty name.

    Returns:
        The PLY file of each asset, or a sentence that says why it has none, by names such as `Collection/Hero`.

    Raises:
        MeshError: Blender is missing or cannot read the file, or the file has no visible mesh.
    """
    report = run_blender(["assets", str(path.absolute()), "--folder", str(folder.absolute())], program)
    return {name: each.get("error") or folder / each["file"] for name, each in report["assets"].items()}


def split_asset(path: Path) -> tuple[Path, str]:
    """Split a path of an asset, as Blender writes it (`FILE.blend/Collection/Hero`), into the file and the asset in it.

    The asset is empty if the path names a file.
    """
    for parent in path.parents:
        if parent.suffix.lower() == BLEND and parent.is_file():
            return parent, path.relative_to(parent).as_posix()
    return path, ""


def _environment() -> dict[str, str]:
    """The environment variables of this process, with the extension's folder on Python's path."""
    extension = extension_module("main")
    spec = find_spec(extension.module) if extension else None
    return child_environment(Path(each).resolve().parent for each in (spec and spec.submodule_search_locations) or ())


def _last_words(output: Path, program: str, status: int) -> str:
    """Why Blender failed: a sentence of the extension, or the last lines of its output."""
    lines = [line.strip() for line in output.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    own = [line.removeprefix(SAID) for line in lines if line.startswith(SAID)]
    if own:
        return own[-1]
    last = f", saying: {lines[-1].rstrip('.')}" if lines else ""
    return (
        f"{program} exited with status {status} and no result{last}: check that it is Blender 4.2 or newer, with the "
        "extension ZoomOut Transfer installed and enabled."
    )
