# SPDX-License-Identifier: GPL-3.0-or-later
"""One source to many targets: the files to write, and the outcome of each."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeAlias

import click

from zoomout_core.command_options import progress_bar, tell
from zoomout_core.matching.report.verdict import RefusedMatchError
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.folders import meshes_of
from zoomout_core.messages import NO_MEMORY, message_of
from zoomout_core.runtime.outputs import OutputError, check_no_input, check_output, write_whole
from zoomout_core.runtime.progress import portion, renaming

REPORT = "report.json"
# Exit codes if nothing was written, and if only a part was. Click uses 2 for invalid commands.
FAILED, PARTLY = 1, 3


class Status(StrEnum):
    """How the job of a target ended."""

    WRITTEN = "written"
    REFUSED = "refused"  # its match is probably wrong
    ERROR = "failed"


@dataclass(frozen=True)
class Job:
    """A target, and the file to write for it."""

    target: Path
    output: Path


# Runs a job, and returns sentences about its outcome. Figures that it knows go into the dictionary as it goes on, so
# that those of a job that fails are kept.
Run: TypeAlias = Callable[[Job, dict[str, Any]], list[str]]


@dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of a job.

    Attributes:
        job: the target and its file.
        status: how it ended.
        report: figures for the JSON report; those that were known if it failed.
        lines: the same in sentences, the most important one first.
        error: a sentence that says why nothing was written; empty if the file was.
    """

    job: Job
    status: Status
    report: dict[str, Any]
    lines: Sequence[str] = ()
    error: str = ""


def is_folder(output: str) -> bool:
    """Whether an output is a folder: an existing one, or a name without a file extension."""
    return os.path.isdir(output) or not Path(output).suffix  # pathlib's raises an error for a name that is too long


def check_folder(output: str | os.PathLike[str]) -> None:
    """Raise an OutputError if a file is in the place of an output folder."""
    if os.path.exists(output) and not os.path.isdir(output):
        raise OutputError(f"{output} is a file: give a folder, or a file with an extension.")


def plan(
    source: str,
    targets: Sequence[str],
    output: str,
    ending: str,
    endings: Collection[str],
    check_format: Callable[[Path], object],
    in_place: bool = False,
) -> list[Job]:
    """Plan the jobs of a transfer, after checking that their files can be written.

    Args:
        source: a mesh file.
        targets: mesh files, or folders of them, in which the source is skipped.
        output: a file, for a single target; or a folder, in which each file is named after its target.
        ending: extension of the files in an output folder, such as `.ply`.
        endings: extensions of meshes in a folder of targets; other files are skipped.
        check_format: raises a MeshError for a format that cannot be written.
        in_place: whether a file may replace an input.

    Raises:
        MeshError: a folder contains no meshes, several targets have a single output file, or a file would replace
            another output.
        OutputError: a folder does not exist or cannot be written to, or a file would replace an input.
    """
    named = [path for target in targets for path in meshes_of(Path(target), endings, Path(source))]
    once: dict[str, Path] = {}  # a file that is named twice is one target
    for path in named:
        once.setdefault(os.path.realpath(path), path)
    paths = list(once.values())
    place = Path(output)
    if not is_folder(output):
        check_format(place)
        if len(paths) > 1:
            raise MeshError(f"{output} is one file for {len(paths)} targets: give a folder.")
        check_output(place, [source, *paths], in_place)
        return [Job(paths[0], place)]
    if not os.path.isdir(place):
        check_folder(place)
        check_output(place)  # created when there is something to write
    for path in (Path(source), *paths):
        if os.path.dirname(os.path.realpath(path)) == os.path.realpath(place) and not in_place:
            raise MeshError(
                f"{path} is in {output}, where the output could overwrite it: choose another folder, or pass "
                "--in-place."
            )
    jobs = [Job(path, place / f"{path.stem}{ending}") for path in paths]
    first: dict[str, Path] = {}
    if place.is_dir():
        check_output(place / REPORT)
    for job in jobs:
        other = first.setdefault(job.output.name.casefold(), job.target)
        if other is not job.target:
            raise MeshError(f"{other} and {job.target} would both be written to {job.output}: rename one of them.")
        if place.is_dir():
            check_output(job.output, [source, *paths], in_place)
    return jobs


def check_inputs_stay(jobs: Sequence[Job], output: str, inputs: Iterable[str | os.PathLike[str]]) -> None:
    """Check, before the work begins, that neither the files of jobs nor the report beside them replace an input.

    Raises:
        OutputError: one would.
    """
    inputs = tuple(inputs)
    for path in (*(job.output for job in jobs), *([Path(output) / REPORT] if is_folder(output) else [])):
        check_no_input(path, inputs)


def run_jobs(jobs: Sequence[Job], run: Run) -> list[Outcome]:
    """Run jobs from `plan` one after the other; a failure does not affect the others."""
    outcomes = []
    for number, job in enumerate(jobs):
        place = f"{number + 1}/{len(jobs)} " if len(jobs) > 1 else ""
        with portion(number / len(jobs), (number + 1) / len(jobs)), renaming(place.__add__):
            outcomes.append(_outcome(job, run))
    return outcomes


def _outcome(job: Job, run: Run) -> Outcome:
    report: dict[str, Any] = {}
    try:
        return Outcome(job, Status.WRITTEN, report, run(job, report))
    except RefusedMatchError as error:
        return Outcome(job, Status.REFUSED, report, error=str(error))
    except (ValueError, OSError) as error:
        return Outcome(job, Status.ERROR, report, error=message_of(error))
    except MemoryError:
        return Outcome(job, Status.ERROR, report, error=NO_MEMORY)


def run_batch(
    source: str, jobs: Sequence[Job], run: Run, options: Mapping[str, Any], output: str
) -> tuple[list[Outcome], dict[str, Any]]:
    """Run a command's jobs beside a progress bar, and write the report to an output folder.

    Returns:
        The outcomes, and the report of `figures_of` from the source's file and the command's options by name.

    Raises:
        OutputError: the report cannot be written.
    """
    with progress_bar() as bar:
        outcomes = run_jobs(jobs, run)
        if all(outcome.error for outcome in outcomes):
            bar.close()
    figures = figures_of(source, outcomes, options)
    if is_folder(output):
        write_report(figures, Path(output))
    return outcomes, figures


def figures_of(source: str, outcomes: Sequence[Outcome], options: Mapping[str, Any]) -> dict[str, Any]:
    """The outcome of each target, in values that JSON can store.

    Args:
        source: the source's file.
        outcomes: the outcome of each target.
        options: the options of the command, by name.
    """
    rows = []
    for outcome in outcomes:
        row: dict[str, Any] = {"target": str(outcome.job.target), "status": outcome.status}
        row |= {"error": outcome.error} if outcome.error else {"output": str(outcome.job.output)}
        rows.append(row | outcome.report)
    return {
        "version": version("zoomout-core"),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "source": source,
        "options": dict(options),
        "targets": rows,
    }


def write_report(figures: Mapping[str, Any], folder: Path) -> None:
    """Write the figures of `figures_of` to `report.json` in a folder.

    Raises:
        OutputError: it cannot be written.
    """
    write_whole(folder / REPORT, f"{json.dumps(figures, indent=1)}\n".encode())


def report_outcomes(outcomes: Sequence[Outcome], figures: Mapping[str, Any], output: str, as_json: bool) -> None:
    """Print the figures as JSON, or the outcomes in sentences, and end with the matching exit code.

    Raises:
        ClickException: the only target failed, and the outcomes are printed in sentences.
    """
    if as_json:
        click.echo(json.dumps(figures, indent=1))
        _end_with_code(outcomes)
    else:
        say_outcomes(outcomes, output)


def say_outcomes(outcomes: Sequence[Outcome], output: str) -> None:
    """Print the outcome of each target, and end with the matching exit code.

    Raises:
        ClickException: the only target failed.
    """
    if not is_folder(output):
        (only,) = outcomes
        if only.error:
            raise click.ClickException(only.error)
        for line in (*only.lines, f"Written to {only.job.output}"):
            tell(line)
        return
    for outcome in outcomes:
        if outcome.error:
            click.echo(f"{outcome.job.target}: {outcome.status}. {outcome.error}", err=True)
            continue
        first, *others = outcome.lines
        tell(f"{outcome.job.target}: {first}")
        for line in others:
            tell(f"  {line}")
    failed = sum(bool(outcome.error) for outcome in outcomes)
    tell(f"{len(outcomes) - failed} of {len(outcomes)} targets written to {output}; {REPORT} lists the result of each.")
    _end_with_code(outcomes)


def _end_with_code(outcomes: Sequence[Outcome]) -> None:
    """End the process if targets failed: with code 1 if all did, 3 if some."""
    failed = sum(bool(outcome.error) for outcome in outcomes)
    if failed:
        sys.exit(FAILED if failed == len(outcomes) else PARTLY)
