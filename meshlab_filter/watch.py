# SPDX-License-Identifier: GPL-3.0-or-later
"""Watch a folder: process each file that a program such as MeshLab saves there, and write the results next to it.

A file is processed once it and all files that it refers to are unchanged between two checks; so none is read while it
is being written. Files with newer results are left alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import sleep
from typing import TypeAlias

from meshlab_filter.batch import transfer_files
from meshlab_filter.files import SURFACES, new_mesh_set, save_beside
from meshlab_filter.project import (
    PROJECT,
    ProjectMesh,
    files_of,
    is_project,
    load_inputs,
    read_project,
    write_project,
)
from meshlab_filter.script import run_script
from zoomout_core.assets.files import inputs_of
from zoomout_core.batch import Job
from zoomout_core.mesh.errors import MeshError
from zoomout_core.messages import note_lines
from zoomout_core.runtime.outputs import PART, is_same_file

# Suffix of the names of results, before the extension; such files are skipped.
RESULT = "_zoomout"

# The state of a file that was not looked at yet.
UNSEEN = ((-1, -1),)
# Sizes and modification times of files; None for a missing one.
State: TypeAlias = "tuple[tuple[int, int], ...] | None"


@dataclass(frozen=True)
class Watch:
    """The settings of a watched folder.

    Attributes:
        folder: the watched folder.
        source: the mesh whose attributes every saved mesh receives; if None, only projects are processed, whose
            first mesh is the source of the others.
        script: a script to run on every mesh and project instead.
        detail: the filters' parameter.
    """

    folder: Path
    source: Path | None = None
    script: Path | None = None
    detail: str = "balanced"

    def inputs(self) -> list[Path]:
        """The files in the folder to be processed, sorted by name."""
        files = [path for path in sorted(self.folder.iterdir()) if not _is_result(path) and not PART.search(path.name)]
        projects = [path for path in files if is_project(path)]
        if self.source is None and self.script is None:
            return projects
        known = [self.source, *(file for path in projects for file in _mesh_names(path))]
        return projects + [
            path
            for path in files
            if path.suffix.lower() in SURFACES and not any(is_same_file(path, one) for one in known if one is not None)
        ]

    def outputs(self, path: Path) -> list[Path]:
        """The output files of an input."""
        if not is_project(path) or self.script is not None:
            return [_result(path, path.stem, ".ply")]
        targets = [mesh.path for mesh in read_project(path)[1:]]
        return [*(_result(path, target.stem, ".ply") for target in targets), _result(path, path.stem, PROJECT)]

    def process(self, path: Path) -> list[str]:
        """Process an input, and return a message about it.

        Raises:
            MeshError: the input cannot be processed.
            OSError: a file cannot be read or written.
        """
        if self.script is not None:
            return _run_script(self.script, path, *self.outputs(path))
        if is_project(path):
            return self._process_project(path)
        assert self.source is not None  # otherwise a single mesh is not an input
        return _transfer(self.source, [Job(path, *self.outputs(path))], self.detail)

    def _process_project(self, path: Path) -> list[str]:
        """Transfer from the first mesh of a project to the others, and write a project with the results."""
        source, *targets = read_project(path)
        *outputs, project = self.outputs(path)
        if not targets:
            raise MeshError(
                f"The project {path.name} has only one mesh: save a project with a source, followed by its targets."
            )
        if len({output.name.casefold() for output in outputs}) < len(outputs):
            raise MeshError(f"Two targets of the project {path.name} have the same name: rename one of them.")
        jobs = [Job(target.path, output) for target, output in zip(targets, outputs, strict=True)]
        lines = _transfer(source.path, jobs, self.detail)
        shown = [source]
        for target, output in zip(targets, outputs, strict=True):
            made = output.exists()  # it coincides with its target, which would hide it
            shown.append(replace(target, visible=target.visible and not made))
            shown += [ProjectMesh(output.stem, output, target.transform)] if made else []
        write_project(project, shown)
        return lines


def watch(work: Watch, process: Callable[[Path], None], interval: float, once: bool = False) -> Iterator[None]:
    """Check a folder repeatedly, and process the files that were saved there; yields after each check.

    Args:
        work: the settings.
        process: processes an input with `Watch.process`, and reports the result.
        interval: seconds between two checks.
        once: end as soon as nothing is left to process.
    """
    last: dict[Path, State] = {}
    finished: dict[Path, State] = {}
    while True:
        waiting = False
        for path in work.inputs():
            state = _state(work, path)
            # A file that names missing ones may be complete later, but not if this is the only check: it is refused.
            if (state is None and not once) or finished.get(path, UNSEEN) == state or _is_newer(work, path):
                continue
            waiting = True
            if last.get(path, UNSEEN) == state:
                process(path)
                finished[path] = state  # the state before the work: a file saved meanwhile is processed again
            last[path] = state
        yield
        if once and not waiting:
            return
        sleep(interval)


def _transfer(source: Path, jobs: list[Job], detail: str) -> list[str]:
    outcomes = transfer_files(str(source), jobs, detail=detail)
    failed = [one for one in outcomes if one.error]
    if len(failed) == len(outcomes):
        raise MeshError(" ".join(one.error for one in failed))
    lines = [f"{one.job.target.name}: failed. {one.error}" for one in failed]
    return lines + [f"{one.job.output.name}: {line}" for one in outcomes if not one.error for line in one.lines]


def _run_script(script: Path, path: Path, output: Path) -> list[str]:
    ms = new_mesh_set()
    textures = load_inputs(ms, path)
    reports = run_script(ms, script)
    if ms.mesh_number() == 0:
        raise MeshError("The script leaves no mesh to write: keep at least one.")
    save_beside(ms, output, textures, {}, kept=inputs_of(*files_of(path)))
    return [f"{output.name}: {note}" for report in reports for note in note_lines(report.get("notes", ()))]


def _result(path: Path, stem: str, ending: str) -> Path:
    return path.with_name(f"{stem}{RESULT}{ending}")


def _is_result(path: Path) -> bool:
    return path.stem.endswith(RESULT)


def _mesh_names(project: Path) -> list[Path]:
    """The meshes of a project; empty while it cannot be read."""
    try:
        return files_of(project)[1:]
    except (ValueError, OSError):
        return []


def _state(work: Watch, path: Path) -> State:
    """The state of an input and of all files that it depends on."""
    try:
        files = [path, *_mesh_names(path), *(each for each in (work.source, work.script) if each is not None)]
        return tuple((found.st_size, found.st_mtime_ns) for found in map(os.stat, files))
    except OSError:  # it is being replaced
        return None


def _is_newer(work: Watch, path: Path) -> bool:
    """Whether the results of an input exist and are newer than their inputs."""
    try:
        made = [output.stat().st_mtime_ns for output in work.outputs(path)]
    except (ValueError, OSError):
        return False
    state = _state(work, path)
    return state is not None and min(made) >= max(changed for _, changed in state)
