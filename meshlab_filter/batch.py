"""Transfer from one mesh file to many, through a MeshSet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from meshlab_filter.files import FORMATS, TextureFiles, load_mesh, new_mesh_set, save_beside, texture_files
from meshlab_filter.filters import transfer_attributes_by_zoomout
from zoomout_core.batch import Job, Outcome, outcomes_steps
from zoomout_core.runtime.stepping import Steps

if TYPE_CHECKING:
    from pymeshlab import MeshSet

# A vertex of less confidence than this is counted as one to look at.
LOW = 0.5


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
    return (yield from outcomes_steps(jobs, lambda job: _job_steps(ms, source_id, job, inputs, write, parameters)))


def _job_steps(
    ms: MeshSet,
    source_id: int,
    job: Job,
    inputs: TextureFiles,
    write: Callable[[Path, TextureFiles], None],
    parameters: dict[str, Any],
) -> Steps[tuple[dict[str, Any], list[str]]]:
    try:
        return (yield from _transferred_steps(ms, source_id, job, inputs, write, parameters))
    finally:
        _keep_only(ms, source_id)


def _transferred_steps(
    ms: MeshSet,
    source_id: int,
    job: Job,
    inputs: TextureFiles,
    write: Callable[[Path, TextureFiles], None],
    parameters: dict[str, Any],
) -> Steps[tuple[dict[str, Any], list[str]]]:
    target_id = load_mesh(ms, job.target)
    inputs = inputs | texture_files(ms.mesh(target_id), job.target)
    report = yield from transfer_attributes_by_zoomout.row.run(
        ms, sourcemesh=source_id, targetmesh=target_id, **parameters
    )
    job.output.parent.mkdir(exist_ok=True)
    write(job.output, inputs)
    return _figures(report), _lines(report, job.output.suffix.lower())


def _keep_only(ms: MeshSet, mesh_id: int) -> None:
    """Delete all meshes but one."""
    for mesh in [mesh.id() for mesh in ms]:
        if mesh != mesh_id:
            ms.set_current_mesh(mesh)
            ms.delete_current_mesh()
    ms.set_current_mesh(mesh_id)


def _figures(report: dict[str, Any]) -> dict[str, Any]:
    """What of a transfer a program may want to sort by."""
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


def _lines(report: dict[str, Any], ending: str) -> list[str]:
    """What a user should know about a transfer to a file of some ending, a sentence a line."""
    confidence = report["confidence"]
    lines = [
        f"Transferred: {', '.join(report['transferred'])}.",
        f"Right with a probability of {report['certainty']:.0%}, by its lead over the other candidates.",
        f"Mean confidence {confidence.mean():.2f}; {(confidence < LOW).mean():.1%} of the vertices are below {LOW}.",
        f"Without a partner: {report['share_without_partner']:.1%} of the target's area, "
        f"{report['source_share_without_partner']:.1%} of the source's.",
        f"{len(report['candidates'])} correspondences were found; where sides are swapped, try --candidate 1.",
        *report["notes"],
    ]
    lost = [name for name in report["transferred"] if name not in FORMATS[ending]]
    if lost:
        lines.append(f"{ending[1:].upper()} cannot hold {' and '.join(lost)}: write PLY to keep them.")
    return lines
