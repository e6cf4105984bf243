# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout evaluate`."""

from __future__ import annotations

from typing import Any

import click
import numpy as np

from zoomout_core.cli.report import json_option, say, spread_in_words, spread_of
from zoomout_core.command_options import FilePath, InputFile, refusals
from zoomout_core.evaluation import coverage, edge_distortion, flipped_share, geodesic_error
from zoomout_core.map_files import read_surface_map
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.refinement.confidence import cycle_error
from zoomout_core.mesh.formats.files import read_shape
from zoomout_core.mesh.input_checks import vertex_numbers
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.text_arguments import read_truth


@click.command()
@click.argument("map_file", metavar="MAP", type=InputFile())
@click.argument("source", type=FilePath())
@click.argument("target", type=FilePath())
@click.option(
    "--truth",
    type=InputFile(),
    help="Text file of ground-truth pairs: a source vertex and a target vertex per line, numbered from 0.",
)
@click.option(
    "--reverse",
    type=InputFile(),
    help="A map from SOURCE to TARGET, written by `zoomout match TARGET SOURCE`, to measure the round-trip error.",
)
@json_option
def evaluate(map_file: str, source: str, target: str, truth: str | None, reverse: str | None, as_json: bool) -> None:
    """Measure MAP: flipped area, coverage, distortion and error.

    MAP is a file that `zoomout match SOURCE TARGET` wrote. Its error is measured with --truth, along the surface, in
    thousandths of the square root of its area.
    """
    with refusals():
        surfaces = as_surface(read_shape(source)), as_surface(read_shape(target))
        surface_map = read_surface_map(map_file, *surfaces)
        lines, figures = ([], {}) if truth is None else _errors(surface_map, *surfaces, truth)
        over, covered = flipped_share(surface_map, *surfaces), coverage(surface_map, surfaces[0])
        distortion = edge_distortion(surface_map, *surfaces)
        figures |= {"flipped": over, "covered": covered, "edge_distortion": distortion}
        lines += [
            f"Flipped: {over:.1%} of the target's area.",
            f"Covered: {covered:.1%} of the source's area.",
            f"Edge distortion: {distortion:.3f} (0 for an isometry).",
        ]
        if reverse is not None:
            back = read_surface_map(reverse, *surfaces[::-1])
            missed = 1000 * cycle_error(surface_map, back, surfaces[1].vertices) / np.sqrt(surfaces[1].area)
            figures["cycle_error"] = spread = spread_of(missed[np.isfinite(missed)])  # unused vertices have no place
            lines.append(f"Round-trip error at target vertices: {spread_in_words(spread)}.")
    say(lines, figures, as_json)


def _errors(surface_map: SurfaceMap, source: Surface, target: Surface, truth: str) -> tuple[list[str], dict[str, Any]]:
    """Errors of the images relative to their true places."""
    source_vertex, target_vertex = read_truth(truth)
    known = (
        vertex_numbers(target_vertex, len(target.vertices), f"The target vertices of {truth}"),
        vertex_numbers(source_vertex, len(source.vertices), f"The source vertices of {truth}"),
    )
    error = 1000 * geodesic_error(surface_map, source, target_vertex=known[0], source_vertex=known[1])
    reached = error[np.isfinite(error)]  # an image on a loose part has no path to the body
    missed = len(error) - len(reached)
    lines: list[str] = []
    figures: dict[str, Any] = {
        "places_given": len(known[0]),
        "places": len(reached),
        "places_on_another_part": missed,
    }
    if len(reached):
        figures["error"] = spread = spread_of(reached)
        lines.append(f"Error at {len(reached):,} of {len(known[0]):,} ground-truth points: {spread_in_words(spread)}.")
    if missed:
        lines.append(f"{missed} images are on a different part of the source than the ground truth.")
    return lines, figures
