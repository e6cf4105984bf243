"""Transfer from one mesh file to many: what is to be written where, and what became of each."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from meshlab_filter.files import (
    SURFACES,
    TextureFiles,
    check_format,
    load_mesh,
    new_mesh_set,
    save_beside,
    texture_files,
)
from meshlab_filter.filters import transfer_attributes_by_zoomout
from zoomout_core.mesh.surface import MeshError
from zoomout_core.runtime.outputs import check_output, written_whole
from zoomout_core.runtime.stepping import Progress, Steps

if TYPE_CHECKING:
    from pymeshlab import MeshSet

REPORT = "report.json"
# A vertex of less confidence than this is counted as one to look at.
LOW = 0.5


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
        report: what the filter says; nothing if it failed.
        error: why it failed, a sentence; empty if it did not.
    """

    job: Job
    report: dict[str, Any]
    error: str = ""


def is_folder(output: str) -> bool:
    """Whether an output is a folder: one that is there, or a name that ends as no file does."""
    return Path(output).is_dir() or not Path(output).suffix


def planned(source: str, targets: Sequence[str], output: str, ending: str, in_place: bool = False) -> list[Job]:
    """The jobs of a transfer, once it is clear that their files can be written.

    Args:
        source: a mesh file.
        targets: mesh files, or folders of them, in which the source is passed over.
        output: a file, for a single target; or a folder, in which each file is named after its target.
        ending: of the files in a folder, such as `.ply`.
        in_place: whether a file may take the place of one that is read.

    Raises:
        MeshError: a folder holds no meshes, several targets were given a file to share, or a file would take the place
            of another.
        OutputError: a folder does not exist or cannot be written to, or a file would take the place of an input.
    """
    paths = [path for target in targets for path in _meshes_of(Path(target), Path(source))]
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
                f"{path} is in {output}, where files and textures might take its place: give another folder, or "
                "--in-place."
            )
    jobs = [Job(path, place / f"{path.stem}{ending}") for path in paths]
    first: dict[str, Path] = {}
    for job in jobs:
        other = first.setdefault(job.output.name.casefold(), job.target)
        if other is not job.target:
            raise MeshError(f"{other} and {job.target} would both become {job.output}: rename one of them.")
        if place.is_dir():
            check_output(job.output, [source, *paths], in_place)
    return jobs


def _meshes_of(target: Path, source: Path) -> list[Path]:
    """A target, or if it is a folder the meshes in it but the source."""
    if not target.is_dir():
        return [target]
    files = sorted(path for path in target.iterdir() if path.suffix.lower() in SURFACES)
    found = [path for path in files if path.resolve() != source.resolve()]
    if not found:
        raise MeshError(f"The folder {target} holds no meshes to transfer to: check its name.")
    return found


def transfer_steps(source: str, jobs: Sequence[Job], in_place: bool = False, **parameters: Any) -> Steps[list[Outcome]]:
    """Transfer from a mesh file to each target, one after the other; one that fails leaves the others alone.

    Args:
        source: a mesh file.
        jobs: as of `planned`.
        in_place: whether textures may take the place of those that are read.
        parameters: of the filter `transfer_attributes_by_zoomout`.

    Raises:
        MeshError: the source cannot be read.
        ImportError: pymeshlab is not installed.
    """
    ms = new_mesh_set()
    source_id = load_mesh(ms, source)
    inputs = texture_files(ms.mesh(source_id), source)
    write = partial(save_beside, ms, brought={}, in_place=in_place)
    outcomes = []
    for number, job in enumerate(jobs):
        place = f"{number + 1}/{len(jobs)} " if len(jobs) > 1 else ""
        steps = _job_steps(ms, source_id, job, inputs, write, parameters)
        try:
            while True:
                progress = next(steps)
                yield Progress((number + progress.fraction) / len(jobs), place + progress.stage)
        except StopIteration as finished:
            outcomes.append(Outcome(job, finished.value))
        except (ValueError, OSError) as error:
            outcomes.append(Outcome(job, {}, str(error)))
        except MemoryError:
            outcomes.append(
                Outcome(job, {}, "There is not enough memory for it: simplify it, or give a lower --detail.")
            )
        _keep_only(ms, source_id)
    return outcomes


def _job_steps(
    ms: MeshSet,
    source_id: int,
    job: Job,
    inputs: TextureFiles,
    write: Callable[[Path, TextureFiles], None],
    parameters: dict[str, Any],
) -> Steps[dict[str, Any]]:
    target_id = load_mesh(ms, job.target)
    inputs = inputs | texture_files(ms.mesh(target_id), job.target)
    report = yield from transfer_attributes_by_zoomout.row.run(
        ms, sourcemesh=source_id, targetmesh=target_id, **parameters
    )
    job.output.parent.mkdir(exist_ok=True)
    write(job.output, inputs)
    return report


def _keep_only(ms: MeshSet, mesh_id: int) -> None:
    """Delete all meshes but one."""
    for mesh in [mesh.id() for mesh in ms]:
        if mesh != mesh_id:
            ms.set_current_mesh(mesh)
            ms.delete_current_mesh()
    ms.set_current_mesh(mesh_id)


def write_report(source: str, outcomes: Sequence[Outcome], folder: Path) -> None:
    """Write what became of each target to `report.json` in a folder.

    Raises:
        OutputError: it cannot be written.
    """
    rows = [{"target": str(one.job.target), "output": str(one.job.output), **_figures(one)} for one in outcomes]
    folder.mkdir(exist_ok=True)
    text = json.dumps({"source": source, "targets": rows}, indent=1)
    with written_whole(folder / REPORT) as part:
        part.write_text(f"{text}\n", encoding="utf-8")


def _figures(outcome: Outcome) -> dict[str, Any]:
    """What of an outcome a program may want to sort by."""
    if outcome.error:
        return {"error": outcome.error}
    report = outcome.report
    return {
        "certainty": float(report["certainty"]),
        "mean_confidence": float(report["confidence"].mean()),
        "low_confidence": float((report["confidence"] < LOW).mean()),
        "share_without_partner": report["share_without_partner"],
        "source_share_without_partner": report["source_share_without_partner"],
        "candidates": len(report["candidates"]),
        "transferred": report["transferred"],
        "notes": report["notes"],
    }
