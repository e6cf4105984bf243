# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout symmetry`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from zoomout_core.cli.report import json_option, say
from zoomout_core.command_options import FilePath, check_axis, mesh_options, progress_bar, refusals
from zoomout_core.map_files import check_map_output, keep_map
from zoomout_core.matching.presets import resolve_detail
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_shape
from zoomout_core.messages import note_figures, note_lines, probability
from zoomout_core.symmetry.detect import Symmetry, detect_symmetry


@click.command()
@click.argument("mesh", type=FilePath())
@click.option("-o", "--output", required=True, type=FilePath(dir_okay=False), help="The .npz file to write.")
@click.option(
    "--candidate",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Number of the listed symmetry to write.",
)
@click.option(
    "--left",
    default="x",
    show_default=True,
    metavar="X,Y,Z",
    help="Direction to the character's own left, such as x, -x, y, -y, z or -z, to tell the sides apart.",
)
@json_option
@mesh_options
def symmetry(mesh: str, output: str, candidate: int, left: str, as_json: bool, **accuracy: Any) -> None:
    """Find the symmetries of MESH in any pose.

    Lists all of them, and writes one to an .npz file: triangle, barycentric, vertex, confidence and functional_map of
    the map of MESH onto itself, and for every vertex its signed distance from the symmetry line and its side: 1 left,
    -1 right, 0 on the line.
    """
    with refusals():
        check_map_output(output, [mesh])
        shape, direction = read_shape(mesh), check_axis(left, "--left")
        with progress_bar():
            found = detect_symmetry(shape, left=direction, **resolve_detail(**accuracy))
        if candidate > len(found):
            raise MeshError(f"There is no candidate {candidate}: only {len(found)} were found.")
        chosen = found[candidate - 1]
        with keep_map(partial(_save, chosen), Path(output), use=""):
            _save(chosen, Path(output))
    lines = [f"{number}. {describe(entry)}" for number, entry in enumerate(found, start=1)]
    figures = {
        "output": output,
        "written": candidate,
        "symmetries": [_figures(each) for each in found],
        **note_figures(chosen.notes),
    }
    say([*lines, *note_lines(chosen.notes), f"Number {candidate} written to {output}"], figures, as_json)


def _save(symmetry: Symmetry, path: Path) -> None:
    """Write a symmetry, and the sides that it makes.

    Raises:
        OutputError: it cannot be written.
    """
    symmetry.surface_map.save(
        path,
        confidence=symmetry.confidence,
        functional_map=symmetry.functional_map,
        distance=symmetry.distance,
        side=symmetry.sides(),
    )


def describe(symmetry: Symmetry) -> str:
    """Describe a symmetry in a line: its kind, its probability and its exactness."""
    kind = "reflection" if symmetry.reverses_orientation else "turn"
    order = f" of order {symmetry.order}" if symmetry.order > 2 else ""
    if symmetry.order == 2 and not symmetry.reverses_orientation:
        kind = "half turn"
    return (
        f"A {kind}{order}, with a probability of {probability(symmetry.certainty)}; mean confidence "
        f"{symmetry.confidence.mean():.2f}; round-trip error of {1000 * symmetry.return_error:.1f} thousandths of "
        "the square root of the area."
    )


def _figures(symmetry: Symmetry) -> dict[str, Any]:
    return {
        "reverses_orientation": symmetry.reverses_orientation,
        "order": symmetry.order,
        "certainty": symmetry.certainty,
        "mean_confidence": float(symmetry.confidence.mean()),
        "return_error": symmetry.return_error,
    }
