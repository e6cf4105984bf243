# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout match`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from zoomout_core.assets.part_names import parts_of_file
from zoomout_core.cli.report import json_option, match_figures, match_lines, match_notes, say
from zoomout_core.command_options import (
    NEAREST,
    FilePath,
    OptionError,
    files_of_options,
    in_place_option,
    match_options,
    progress_bar,
    refusals,
    start_arguments,
    table_options,
)
from zoomout_core.evaluation import flipped_share
from zoomout_core.map_files import check_map_output, keep_map, save_match
from zoomout_core.matching import option_table
from zoomout_core.matching.option_table import OPTIONS, Interface, select_options
from zoomout_core.matching.pipeline import match as match_shapes
from zoomout_core.matching.proximity import ProximityMatch, match_by_proximity
from zoomout_core.matching.report.verdict import select_notes
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.formats.files import read_shape
from zoomout_core.mesh.named_parts import NamedParts
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.messages import note_figures, note_lines
from zoomout_core.runtime.array_files import write_arrays
from zoomout_core.runtime.outputs import atomic_write
from zoomout_core.runtime.progress import Outlines, Progress, listening


@click.command()
@click.argument("source", type=FilePath())
@click.argument("target", type=FilePath())
@click.option("-o", "--output", required=True, type=FilePath(dir_okay=False), help="The .npz file to write.")
@in_place_option
@partial(match_options, starts=[NEAREST])
@table_options(option_table.NEAREST)
@table_options(option_table.RESULT)
@click.option(
    "--first-look",
    type=FilePath(dir_okay=False),
    help="An .npz file for rough images of the candidates, written as soon as they are known.",
)
@json_option
def match(
    source: str,
    target: str,
    output: str,
    in_place: bool,
    first_look: str | None,
    candidate: int,
    as_json: bool,
    **options: Any,
) -> None:
    """Find the point on SOURCE for each vertex of TARGET.

    Either may be a point cloud.

    Writes one .npz file with triangle, barycentric, vertex, confidence and functional_map, and with has_partner and
    source_has_partner: which vertices of TARGET and of SOURCE have a partner. With --initial nearest, for clothes
    on a body, each vertex maps to its nearest point, with a confidence of one or zero, and nothing else is written.

    With --first-look, programs can show the map while it is refined: that file has some vertices of TARGET ("target")
    and, in a row for each candidate, the most likely first, their images on SOURCE ("source").
    """
    with refusals():
        of_nearest = {
            each.name: options.pop(each.name) for each in select_options(option_table.NEAREST, Interface.COMMAND_LINE)
        }
        check_map_output(output, (source, target, *files_of_options(options)), in_place)
        if first_look is not None:
            check_map_output(first_look, (source, target, *files_of_options(options)), in_place)
        shapes = read_shape(source), read_shape(target)
        if options["initial"] == NEAREST:
            _check_nothing_else({**options, "candidate": candidate, "first_look": first_look})
            surfaces = as_surface(shapes[0]), as_surface(shapes[1])
            with progress_bar():
                nearest = match_by_proximity(*surfaces, **of_nearest)
            lines, figures = _save_nearest(nearest, output)
        else:
            _check_nearest_unchanged(of_nearest)
            arguments = start_arguments(**options, more_starts=[NEAREST])
            with progress_bar(), listening(None if first_look is None else FirstLook(Path(first_look))):
                result = match_shapes(*shapes, **arguments)
                if candidate:
                    result = result.use(candidate)
            with keep_map(partial(save_match, result), Path(output)):
                save_match(result, Path(output))
            lines, figures = _summary(result, parts_of_file(source, result.source))
    say([*lines, f"Written to {output}"], {"output": output, **figures}, as_json)


class FirstLook:
    """A listener that writes rough images of a match's candidates to a file, whenever there are new ones."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._written: Outlines = ()

    def __call__(self, latest: Progress) -> None:
        if latest.outlines is self._written:
            return
        self._written = latest.outlines
        vertices, images = zip(*latest.outlines, strict=True)
        with atomic_write(self._path) as part:
            write_arrays(part, {"target": vertices[0], "source": np.stack(images)})


def _check_nothing_else(options: dict[str, Any]) -> None:
    """Raise an OptionError if the user gave options that a map to the nearest points does not take."""
    names = "landmarks", "exact_landmarks", "earlier_map", "common_axes", "candidate"
    flags = {name: OPTIONS[name].name_in(Interface.COMMAND_LINE) for name in names} | {"first_look": "--first-look"}
    for name, flag in flags.items():
        if options[name]:
            raise OptionError(f"{flag} has no effect with --initial {NEAREST}: leave one of them out.")


def _check_nearest_unchanged(of_nearest: dict[str, Any]) -> None:
    """Raise an OptionError if the user changed options that only a map to the nearest points takes."""
    for name, value in of_nearest.items():
        if value != OPTIONS[name].default:
            flag = OPTIONS[name].name_in(Interface.COMMAND_LINE)
            raise OptionError(f"{flag} has an effect only with --initial {NEAREST}: give that, or leave it out.")


def _save_nearest(result: ProximityMatch, output: str) -> tuple[list[str], dict[str, Any]]:
    """Write a map to the nearest points; returns its summary for the user."""
    result.surface_map.save(output, confidence=result.confidence)
    share = float(result.confidence.mean())
    lines = [f"{share:.1%} of the vertices have a partner on the source.", *note_lines(result.notes)]
    return lines, {"share_with_partner": share, **note_figures(result.notes)}


def _summary(result: MatchResult, parts: NamedParts) -> tuple[list[str], dict[str, Any]]:
    """Summary of a match for the user."""
    over = flipped_share(result.surface_map, result.pair.source, result.pair.target)
    origin, notes = result.candidates[result.chosen].origin, match_notes(result, parts)
    lines = [
        *match_lines(result, parts),
        f"Flipped: {over:.1%} of the target's area.",
        f"Candidate {result.chosen} of {len(result.candidates)} (counted from 0), found by {origin}.",
        *note_lines(select_notes(notes, result.verdict)),
    ]
    return lines, {**match_figures(result, parts), "flipped": over, "origin": origin, **note_figures(notes)}
