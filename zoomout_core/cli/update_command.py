# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout update`: transfer changes of a source to files made from it, without a match."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click

from zoomout_core.assets.asset import Asset
from zoomout_core.assets.files import (
    GLTF,
    check_compression,
    check_format,
    check_siblings,
    inputs_of,
    read_asset,
    write_asset,
)
from zoomout_core.assets.transfer_asset import KINDS
from zoomout_core.assets.update_asset import changed_kinds, update_asset
from zoomout_core.batch import Job, check_inputs_stay, is_folder, plan, report_outcomes, run_batch
from zoomout_core.cli.report import json_option
from zoomout_core.command_options import FilePath, compress_option, folders_option, in_place_option, refusals
from zoomout_core.mesh.errors import MeshError
from zoomout_core.messages import note_figures, note_lines
from zoomout_core.runtime.outputs import make_folder


@click.command()
@click.argument("old", metavar="OLD", type=FilePath())
@click.argument("new", metavar="NEW", type=FilePath())
@click.argument("derived", metavar="DERIVED...", nargs=-1, required=True, type=FilePath())
@click.option(
    "-o",
    "--output",
    required=True,
    type=FilePath(),
    help="The file to write for a single DERIVED file (glb, gltf, vrm); or a folder, for any number.",
)
@in_place_option
@compress_option
@folders_option
@json_option
def update(
    old: str,
    new: str,
    derived: tuple[str, ...],
    output: str,
    in_place: bool,
    compression: str | None,
    folders: tuple[str, ...],
    as_json: bool,
) -> None:
    """Transfer changes of a source to files made from it.

    OLD is the source of `zoomout transfer --keep-map`, NEW the same shape with repainted weights, new or changed morph
    targets, other texture coordinates, colours or materials, and DERIVED are the files that were written. Only what
    differs between OLD and NEW is transferred, along the map that each file stores; all else stays, with edits of its
    own. Vertices may be split or ordered differently in NEW.
    """
    with refusals():
        jobs = _plan(new, derived, output, in_place)
        files = [old, new, *(str(job.target) for job in jobs)]
        inputs = [] if in_place else inputs_of(*files, folders=folders)
        check_inputs_stay(jobs, output, inputs)
        for job in jobs:
            check_siblings(job.output, inputs)
            check_compression(job.output, compression)
        before, now = read_asset(old, folders), read_asset(new, folders)
        changed = changed_kinds(before, now, KINDS)
        if not changed:
            raise MeshError(f"{new} has the same data as {old} where their shapes agree: there is nothing to update.")
        run = partial(_run_job, before, now, folders, inputs, compression)
        outcomes, figures = run_batch(new, jobs, run, {"old": old, "compress": compression, "folders": folders}, output)
    report_outcomes(outcomes, {**figures, "changed": changed}, output, as_json)


def _plan(new: str, derived: Sequence[str], output: str, in_place: bool) -> list[Job]:
    """Plan the outputs, which keep the formats of the files."""
    jobs = plan(new, derived, output, ".glb", GLTF, check_format, in_place)
    if not is_folder(output):
        return jobs
    return [replace(job, output=job.output.with_suffix(job.target.suffix)) for job in jobs]


def _run_job(
    before: Asset,
    now: Asset,
    folders: Sequence[str],
    inputs: Sequence[Path],
    compression: str | None,
    job: Job,
    report: dict[str, Any],
) -> list[str]:
    """Update one file; returns the lines of its outcome, and fills in its report."""
    derived = read_asset(job.target, folders)
    try:
        made = update_asset(before, now, derived)
    except MeshError as error:
        raise MeshError("{name}: {reason}", name=str(job.target), reason=error) from error
    make_folder(job.output.parent)
    left_out = write_asset(made.asset, job.output, inputs, compression)
    report |= {"transferred": list(made.received), **note_figures([*derived.notes, *made.notes, *left_out])}
    done = f"Updated: {', '.join(made.received)}." if made.received else "Nothing of its data has changed."
    return [done, *note_lines(report["notes"])]
