# SPDX-License-Identifier: GPL-3.0-or-later
"""One source to many targets: the files to write, and the outcome of each."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from zoomout_core.mesh.memory import NO_MEMORY
from zoomout_core.mesh.surface import MeshError
from zoomout_core.runtime.outputs import atomic_write, check_output
from zoomout_core.runtime.progress import portion, renaming

REPORT = "report.json"
# Exit codes: nothing was written, and only a part was. Click's own for a command that it does not understand is 2.
FAILED, PARTLY = 1, 3


@dataclass(frozen=True)
class Job:
    """A target, and the file to write for it."""

    target: Path
    output: Path


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a job.

    Attributes:
        job: the target and its file.
        report: figures for the JSON report; empty if it failed.
        lines: the same in sentences, the most important one first.
        error: why it failed, a sentence; empty if it did not.
    """

    job: Job
    report: dict[str, Any]
    lines: Sequence[str] = ()
    error: str = ""


def is_folder(output: str) -> bool:
    """Whether an output is a folder: one that is there, or a name that ends as no file does."""
    return Path(output).is_dir() or not Path(output).suffix


def plan(
    source: str,
    targets: Sequence[str],
    output: str,
    ending: str,
    endings: Collection[str],
    check_format: Callable[[Path], None],
    in_place: bool = False,
) -> list[Job]:
    """The jobs of a transfer, once it is clear that their files can be written.

    Args:
        source: a mesh file.
        targets: mesh files, or folders of them, in which the source is passed over.
        output: a file, for a single target; or a folder, in which each file is named after its target.
        ending: of the files in a folder, such as `.ply`.
        endings: of the files in a folder of targets that are meshes; others are passed over.
        check_format: raises a MeshError for a file of a format that cannot be written.
        in_place: whether a file may take the place of one that is read.

    Raises:
        MeshError: a folder holds no meshes, several targets were given a file to share, or a file would take the place
            of another.
        OutputError: a folder does not exist or cannot be written to, or a file would take the place of an input.
    """
    paths = [path for target in targets for path in meshes_of(Path(target), endings, Path(source))]
    place = Path(output)
    if not is_folder(output):
        check_format(place)
        if len(paths) > 1:
            raise MeshError(f"{output} is one file for {len(paths)} targets: give a folder.")
        check_output(place, [source, *paths], in_place)
        return [Job(paths[0], place)]
    if not place.is_dir():
        check_output(place)  # it is made when there is something to put there
    for path in (Path(source), *paths):
        if path.resolve().parent == place.resolve() and not in_place:
            raise MeshError(
                f"{path} is in {output}, where the output could overwrite it: choose another folder, or pass "
                "--in-place."
            )
    jobs = [Job(path, place / f"{path.stem}{ending}") for path in paths]
    first: dict[str, Path] = {}
    for job in jobs:
        other = first.setdefault(job.output.name.casefold(), job.target)
        if other is not job.target:
            raise MeshError(f"{other} and {job.target} would both be written to {job.output}: rename one of them.")
        if place.is_dir():
            check_output(job.output, [source, *paths], in_place)
    return jobs


def meshes_of(given: Path, endings: Collection[str], source: Path | None = None) -> list[Path]:
    """The files that a user names: a file itself, or the meshes in a folder, except the source.

    Raises:
        MeshError: a folder holds none.
    """
    if not given.is_dir():
        return [given]
    files = sorted(path for path in given.iterdir() if path.suffix.lower() in endings)
    found = [path for path in files if source is None or path.resolve() != source.resolve()]
    if not found:
        raise MeshError(f"The folder {given} contains no {'other ' if source else ''}meshes: check the path.")
    return found


def run_jobs(jobs: Sequence[Job], run_of: Callable[[Job], tuple[dict[str, Any], list[str]]]) -> list[Outcome]:
    """Do jobs one after the other; one that fails leaves the others alone.

    Args:
        jobs: as of `plan`.
        run_of: does a job, and returns the report and the lines of its outcome.
    """
    outcomes = []
    for number, job in enumerate(jobs):
        place = f"{number + 1}/{len(jobs)} " if len(jobs) > 1 else ""
        with portion(number / len(jobs), (number + 1) / len(jobs)), renaming(place.__add__):
            outcomes.append(_outcome(job, run_of))
    return outcomes


def _outcome(job: Job, run_of: Callable[[Job], tuple[dict[str, Any], list[str]]]) -> Outcome:
    try:
        return Outcome(job, *run_of(job))
    except (ValueError, OSError) as error:
        return Outcome(job, {}, error=str(error))
    except MemoryError:
        return Outcome(job, {}, error=NO_MEMORY)


def figures_of(source: str, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """What became of each target, as JSON can hold it."""
    rows = [
        {"target": str(one.job.target), "output": str(one.job.output)}
        | ({"error": one.error} if one.error else one.report)
        for one in outcomes
    ]
    return {"source": source, "targets": rows}


def write_report(source: str, outcomes: Sequence[Outcome], folder: Path) -> None:
    """Write what became of each target to `report.json` in a folder.

    Raises:
        OutputError: it cannot be written.
    """
    folder.mkdir(exist_ok=True)
    with atomic_write(folder / REPORT) as part:
        part.write_text(f"{json.dumps(figures_of(source, outcomes), indent=1)}\n", encoding="utf-8")


def say_outcomes(outcomes: Sequence[Outcome], output: str) -> None:
    """Say what became of each target, and end with the matching exit code.

    Raises:
        ClickException: the only target failed.
    """
    if not is_folder(output):
        (only,) = outcomes
        if only.error:
            raise click.ClickException(only.error)
        for line in (*only.lines, f"Written to {only.job.output}"):
            click.echo(line)
        return
    for outcome in outcomes:
        if outcome.error:
            click.echo(f"{outcome.job.target}: failed. {outcome.error}", err=True)
            continue
        first, *others = outcome.lines
        click.echo(f"{outcome.job.target}: {first}")
        for line in others:
            click.echo(f"  {line}")
    failed = sum(bool(outcome.error) for outcome in outcomes)
    click.echo(
        f"{len(outcomes) - failed} of {len(outcomes)} targets written to {output}; {REPORT} lists the result of each."
    )
    end_with_code(outcomes)


def end_with_code(outcomes: Sequence[Outcome]) -> None:
    """End the process where a target failed: 1 if all did, 3 if some."""
    failed = sum(bool(outcome.error) for outcome in outcomes)
    if failed:
        sys.exit(FAILED if failed == len(outcomes) else PARTLY)
