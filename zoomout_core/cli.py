"""The command `zoomout`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click
import numpy as np

from zoomout_core.command_options import (
    in_place_option,
    match_options,
    mesh_options,
    start_arguments,
    threads_option,
    with_progress_bar,
)
from zoomout_core.evaluation import coverage, edge_distortion, flipped_share, geodesic_error
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.confidence import cycle_error
from zoomout_core.matching.match import MatchResult, match_steps
from zoomout_core.matching.presets import DETAIL
from zoomout_core.matching.proximity import (
    MOST_ANGLE,
    MOST_DISTANCE,
    ProximityMatch,
    match_by_proximity_steps,
)
from zoomout_core.mesh.files import read_shape
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.mesh.surface import MeshError, Surface, vertex_numbers
from zoomout_core.runtime.outputs import check_output
from zoomout_core.symmetry.detect import Symmetry, detect_symmetry_steps
from zoomout_core.text_arguments import read_axis, read_landmarks
from zoomout_core.transfer_command import transfer

# A start that nothing follows.
NEAREST = "nearest"


@click.group()
@click.version_option(package_name="zoomout-core")
@threads_option
def main() -> None:
    """Dense correspondence between surfaces, whatever their pose and topology."""


main.add_command(transfer)


def read_surface_map(path: str, source: Surface, target: Surface) -> SurfaceMap:
    """The map from `target` to `source` in a file that `match` wrote.

    Raises:
        MeshError: the file is not one of `match`, or the map is one between other surfaces.
    """
    surface_map = SurfaceMap.load(path, source)
    if len(surface_map.triangle) != len(target.vertices):
        raise MeshError(
            f"{path} maps {len(surface_map.triangle)} vertices, but the surface that it should start from has "
            f"{len(target.vertices)}: give the two meshes of the map, in its order."
        )
    return surface_map


@main.command()
@click.argument("source", type=click.Path())
@click.argument("target", type=click.Path())
@click.option("-o", "--output", required=True, type=click.Path(dir_okay=False), help="The .npz file to write.")
@in_place_option
@match_options
@click.option(
    "--most-distance",
    type=float,
    default=MOST_DISTANCE,
    show_default=True,
    help="With --initial nearest: how far the nearest point may be, over the square root of SOURCE's area.",
)
@click.option(
    "--most-angle",
    type=float,
    default=MOST_ANGLE,
    show_default=True,
    help="With --initial nearest: by how many degrees the normals may differ there.",
)
@click.option("--either-side", is_flag=True, help="With --initial nearest: the normals may also oppose each other.")
def match(
    source: str,
    target: str,
    output: str,
    in_place: bool,
    most_distance: float,
    most_angle: float,
    either_side: bool,
    **options: Any,
) -> None:
    """Find for every vertex of TARGET the point on SOURCE that it corresponds to; either may be a point cloud.

    Writes triangle, barycentric, vertex, confidence, functional_map, and has_partner and source_has_partner, which
    vertices of TARGET and of SOURCE have something on the other that they correspond to, to one .npz file. With
    --initial nearest the map is that to the nearest points, as for clothes on a body, with a confidence of one or zero,
    and nothing else.
    """
    try:
        landmarks, earlier, start = (options[name] for name in ("landmarks", "earlier_map", "initial"))
        check_map_output(output, filter(None, (source, target, landmarks, earlier, start)), in_place)
        shapes = read_shape(source), read_shape(target)
        if options["initial"] == NEAREST:
            _check_nothing_else(options)
            surfaces = as_surface(shapes[0]), as_surface(shapes[1])
            nearest = match_by_proximity_steps(*surfaces, most_distance, most_angle, either_side)
            lines = _save_nearest(with_progress_bar(nearest), output)
        else:
            result = with_progress_bar(match_steps(*shapes, **start_arguments(**options)))
            result.surface_map.save(
                output,
                confidence=result.confidence,
                functional_map=result.functional_map,
                has_partner=result.has_partner,
                source_has_partner=result.source_has_partner,
            )
            lines = summary(result)
    except (ValueError, OSError, ImportError) as error:
        raise click.ClickException(str(error)) from None
    for line in lines:
        click.echo(line)
    click.echo(f"Written to {output}")


def check_map_output(path: str, inputs: Iterable[str], in_place: bool = False) -> None:
    """Check that a map can be written to a path, before it is worked out.

    Raises:
        OutputError: the folder is missing or cannot be written to, or the file is one of those that are read.
        MeshError: the path does not end in .npz.
    """
    check_output(path, inputs, in_place)
    if Path(path).suffix != ".npz":
        raise MeshError(f"{path} does not end in .npz: a map is written to such a file only.")


def _check_nothing_else(options: dict[str, Any]) -> None:
    """Raise a MeshError if the user gave more than a map to the nearest points takes."""
    for name in ("landmarks", "exact_landmarks", "earlier_map", "common_axes"):
        if options[name]:
            option = f"--{name}".replace("_", "-").replace("axes", "axis")
            raise MeshError(f"{option} has no effect on --initial {NEAREST}: leave one of them out.")


def _save_nearest(result: ProximityMatch, output: str) -> list[str]:
    """Write a map to the nearest points; what a user should know about it, a sentence a line."""
    result.surface_map.save(output, confidence=result.confidence)
    return [f"{result.confidence.mean():.1%} of the vertices have a partner on the source.", *result.notes]


def summary(result: MatchResult) -> list[str]:
    """What a user should know about a match, a sentence a line."""
    low = float((result.confidence < 0.5).mean())
    over = flipped_share(result.surface_map, result.pair.source, result.pair.target)
    lines = [
        f"Right with a probability of {result.certainty:.0%}, by its lead over the other candidates.",
        f"Mean confidence {result.confidence.mean():.2f}; {low:.1%} of the vertices are below 0.5.",
        f"Turned over: {over:.1%} of the target's area.",
        f"Without a partner: {result.share_without_partner:.1%} of the target's area, "
        f"{result.source_share_without_partner:.1%} of the source's.",
        f"Found by {result.candidates[result.chosen].origin}, the best of {len(result.candidates)} candidates.",
    ]
    return [*lines, *result.notes]


@main.command()
@click.argument("mesh", type=click.Path())
@click.option("-o", "--output", required=True, type=click.Path(dir_okay=False), help="The .npz file to write.")
@click.option(
    "--candidate",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Which of the symmetries that are listed to write.",
)
@click.option(
    "--left",
    default="x",
    show_default=True,
    metavar="X,Y,Z",
    help="Where the left of what the mesh shows is, or x, -x, y, -y, z, -z for short: it tells the sides apart.",
)
@mesh_options
def symmetry(mesh: str, output: str, candidate: int, left: str, detail: str, seed: int) -> None:
    """Find the symmetries of MESH, in whatever pose it is, and write one of them.

    Writes triangle, barycentric, vertex, confidence and functional_map of the map onto itself to one .npz file, and
    of every vertex the signed distance from the symmetry line, and the side: 1 left, -1 right, 0 on the line.
    """
    try:
        check_map_output(output, [mesh])
        shape, direction = read_shape(mesh), read_axis(left, "--left")
        arguments: dict[str, Any] = {**DETAIL[detail], "seed": seed, "left": direction}
        found = with_progress_bar(detect_symmetry_steps(shape, **arguments))
        for number, entry in enumerate(found, start=1):
            click.echo(f"{number}. {described(entry)}")
        if candidate > len(found):
            raise MeshError(f"There is no candidate {candidate}: {len(found)} were found.")
        chosen = found[candidate - 1]
        chosen.surface_map.save(
            output,
            confidence=chosen.confidence,
            functional_map=chosen.functional_map,
            distance=chosen.distance,
            side=chosen.sides(),
        )
    except (ValueError, OSError, ImportError) as error:
        raise click.ClickException(str(error)) from None
    for line in chosen.notes:
        click.echo(line)
    click.echo(f"Number {candidate} written to {output}")


def described(symmetry: Symmetry) -> str:
    """A symmetry in a line: what it is, how likely, and how exact."""
    kind = "reflection" if symmetry.reverses_orientation else "turn"
    order = f" of order {symmetry.order}" if symmetry.order > 2 else ""
    if symmetry.order == 2 and not symmetry.reverses_orientation:
        kind = "half turn"
    return (
        f"A {kind}{order}, with a probability of {symmetry.certainty:.0%}; mean confidence "
        f"{symmetry.confidence.mean():.2f}; going round misses by {1000 * symmetry.return_error:.1f} thousandths of "
        "the root of the area."
    )


@main.command()
@click.argument("map_file", metavar="MAP", type=click.Path(exists=True, dir_okay=False))
@click.argument("source", type=click.Path())
@click.argument("target", type=click.Path())
@click.option(
    "--truth",
    type=click.Path(exists=True, dir_okay=False),
    help="Text file of pairs that truly correspond: a source vertex and a target vertex a line, numbered from 0.",
)
@click.option(
    "--reverse",
    type=click.Path(exists=True, dir_okay=False),
    help="A map from SOURCE to TARGET, as of `zoomout match TARGET SOURCE`: does going there and back lead home?",
)
def evaluate(map_file: str, source: str, target: str, truth: str | None, reverse: str | None) -> None:
    """Say how good MAP is, which `zoomout match SOURCE TARGET` wrote: what it folds, misses and stretches.

    With --truth also how far its images are off their true places. Distances are in thousandths of the square root
    of the surface's area.
    """
    try:
        surfaces = as_surface(read_shape(source)), as_surface(read_shape(target))
        surface_map = read_surface_map(map_file, *surfaces)
        lines = [] if truth is None else _error_lines(surface_map, *surfaces, truth)
        lines += [
            f"Turned over: {flipped_share(surface_map, *surfaces):.1%} of the target's area.",
            f"Covered: {coverage(surface_map, surfaces[0]):.1%} of the source's area.",
            f"Edge distortion: {edge_distortion(surface_map, *surfaces):.3f} (0 for an isometry).",
        ]
        if reverse is not None:
            back = read_surface_map(reverse, *surfaces[::-1])
            missed = 1000 * cycle_error(surface_map, back, surfaces[1].vertices) / np.sqrt(surfaces[1].area)
            missed = missed[np.isfinite(missed)]  # vertices that no face uses may be nowhere
            lines.append(f"Distance from a target vertex to where going there and back leads: {_spread_of(missed)}.")
    except (ValueError, OSError, ImportError) as error:
        raise click.ClickException(str(error)) from None
    for line in lines:
        click.echo(line)


def _error_lines(surface_map: SurfaceMap, source: Surface, target: Surface, truth: str) -> list[str]:
    source_vertex, target_vertex = read_landmarks(truth)
    known = (
        vertex_numbers(target_vertex, len(target.vertices), f"What {truth} names of the target"),
        vertex_numbers(source_vertex, len(source.vertices), f"What {truth} names of the source"),
    )
    error = 1000 * geodesic_error(surface_map, source, *known)
    reached = error[np.isfinite(error)]  # an image on a loose part has no distance to the body
    lines = [f"Error at {len(reached)} true places: {_spread_of(reached)}."] if len(reached) else []
    if len(reached) < len(error):
        lines.append(f"{len(error) - len(reached)} images lie on another part of the source than their true places.")
    return lines


def _spread_of(values: np.ndarray) -> str:
    high = np.percentile(values, 95)
    return f"mean {values.mean():.1f}, median {np.median(values):.1f}, 95th percentile {high:.1f}"


@main.command()
@click.option(
    "-o", "--output", default="demo", show_default=True, type=click.Path(file_okay=False), help="Folder to write to."
)
def demo(output: str) -> None:
    """Build, pose, match and transfer a character in headless Blender, and measure it against the truth."""
    try:
        from blender_addon.demo import run, summary
    except ModuleNotFoundError as error:
        if error.name == "blender_addon":
            raise click.ClickException("The demo is part of the project's source: run `make demo` there.") from None
        raise click.ClickException(f"The demo needs Blender as a module ({error}): pip install bpy.") from None
    try:
        report = run(Path(output))
    except (MeshError, OSError) as error:
        raise click.ClickException(str(error)) from None
    for line in summary(report):
        click.echo(line)
