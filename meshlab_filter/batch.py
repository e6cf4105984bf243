# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer from one mesh file to many, through a MeshSet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zoomout_core as zo
from meshlab_filter.files import FORMATS, load_mesh, new_mesh_set, save_beside, texture_files
from meshlab_filter.filters import transfer_attributes_by_zoomout
from meshlab_filter.filters.matches import remember_matches
from meshlab_filter.mesh_data import read_shape
from zoomout_core.assets.files import inputs_of
from zoomout_core.assets.part_names import parts_of_file
from zoomout_core.batch import Job, Outcome, run_jobs
from zoomout_core.map_files import keep_map, save_match
from zoomout_core.matching.report.verdict import GREEN, LOW_CONFIDENCE, check_verdict, select_notes
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.messages import note_figures, note_lines
from zoomout_core.runtime.outputs import make_folder

if TYPE_CHECKING:
    from pymeshlab import MeshSet


def transfer_files(
    source: str, jobs: Sequence[Job], in_place: bool = False, force: bool = False, **parameters: Any
) -> list[Outcome]:
    """Transfer from a mesh file to each target in turn; one that fails does not stop the others.

    Args:
        source: a mesh file.
        jobs: the result of `planned`.
        in_place: whether textures may replace input files.
        force: write targets even if the match is probably wrong.
        parameters: parameters of the filter `transfer_attributes_by_zoomout`.

    Raises:
        MeshError: the source cannot be read.
        ImportError: pymeshlab is not installed.
    """
    ms = new_mesh_set()
    source_id = load_mesh(ms, source)
    parts = parts_of_file(source, as_surface(read_shape(ms, source_id)))
    inputs = texture_files(ms.mesh(source_id), source)
    brought: dict[str, bytes] = {}
    kept = inputs_of(source, *(job.target for job in jobs))

    def transfer_one(job: Job, figures: dict[str, Any]) -> list[str]:
        try:
            target_id = load_mesh(ms, job.target)
            textures = inputs | texture_files(ms.mesh(target_id), job.target)
            found: list[zo.MatchResult] = []
            with _keeping_map(found, job.output), remember_matches(found, parts):
                report = transfer_attributes_by_zoomout(ms, sourcemesh=source_id, targetmesh=target_id, **parameters)
            figures |= _figures(report)
            check_verdict(zo.Verdict(**report["verdict"]), force)
            with _keeping_map(found, job.output):
                make_folder(job.output.parent)
                save_beside(ms, job.output, textures, brought, in_place, kept)
            figures |= {"transferred": report["transferred"]}
            return _lines(report, job.output.suffix.lower())
        finally:
            _keep_only(ms, source_id)

    return run_jobs(jobs, transfer_one)


@contextmanager
def _keeping_map(found: Sequence[zo.MatchResult], output: Path) -> Iterator[None]:
    """A context of work that keeps the map of the last match, if there was any before it failed, see `keep_map`."""
    try:
        yield
    except Exception:
        if not found:
            raise
        with keep_map(partial(save_match, found[-1]), output):
            raise


def _keep_only(ms: MeshSet, mesh_id: int) -> None:
    """Delete all meshes but one."""
    for mesh in [mesh.id() for mesh in ms]:
        if mesh != mesh_id:
            ms.set_current_mesh(mesh)
            ms.delete_current_mesh()
    ms.set_current_mesh(mesh_id)


def _figures(report: dict[str, Any]) -> dict[str, Any]:
    """The figures of a match that a program may sort by."""
    return {
        "verdict": report["verdict"],
        "certainty": float(report["certainty"]),
        "mean_confidence": float(report["confidence"].mean()),
        "low_confidence": float((report["confidence"] < LOW_CONFIDENCE).mean()),
        "share_without_partner": report["share_without_partner"],
        "source_share_without_partner": report["source_share_without_partner"],
        "parts": report["parts"],
        "candidates": len(report["candidates"]),
        **note_figures(report["notes"]),
    }


def _lines(report: dict[str, Any], ending: str) -> list[str]:
    """Sentences for the user about a transfer to a file with some extension, one on each line."""
    confidence, verdict = report["confidence"], zo.Verdict(**report["verdict"])
    lines = [
        f"Transferred: {', '.join(report['transferred'])}.",
        verdict.line,
        f"Mean confidence {confidence.mean():.2f}; {(confidence < LOW_CONFIDENCE).mean():.1%} of the vertices are "
        f"doubtful (below {LOW_CONFIDENCE}).",
        f"Without a partner: {report['share_without_partner']:.1%} of the target's area, "
        f"{report['source_share_without_partner']:.1%} of the source's.",
        *note_lines(select_notes(report["notes"], verdict)),
    ]
    if verdict.level != GREEN and len(report["candidates"]) > 1:
        lines.append(f"{len(report['candidates'])} correspondences were found: try --candidate 1.")
    lost = [name for name in report["transferred"] if name not in FORMATS[ending]]
    if lost:
        lines.append(f"{ending[1:].upper()} files cannot store {' and '.join(lost)}: write PLY to keep them.")
    return lines
