"""The command `zoomout transfer`: from one mesh file to another, without Blender and without MeshLab."""

from __future__ import annotations

from typing import Any

import click

from zoomout_core.assets.asset import Asset
from zoomout_core.assets.files import check_format, read_asset, write_asset
from zoomout_core.assets.transfer_asset import KINDS, SHAPES, TransferredAsset, transfer_asset_steps
from zoomout_core.cli.report import json_option, match_figures, match_lines, say
from zoomout_core.command_options import in_place_option, match_options, start_arguments, with_progress_bar
from zoomout_core.matching.match import MatchResult, match_steps
from zoomout_core.mesh.surface import MeshError
from zoomout_core.runtime.outputs import check_output
from zoomout_core.runtime.stepping import Steps, within

# The fraction of the progress at which two meshes are matched.
MATCHED = 0.8


@click.command()
@click.argument("source", type=click.Path())
@click.argument("target", type=click.Path())
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(dir_okay=False),
    help="The .glb, .gltf, .obj or .ply file to write.",
)
@in_place_option
@click.option(
    "--kinds",
    default=",".join(kind.replace(" ", "-") for kind in KINDS[:-1]),
    show_default=True,
    metavar="KIND,KIND",
    help=f"What to transfer, of {', '.join(kind.replace(' ', '-') for kind in KINDS)}.",
)
@click.option(
    "--shape",
    type=click.Choice([each.replace(" ", "-") for each in SHAPES]),
    default=SHAPES[0],
    show_default=True,
    help="With skin weights: whether TARGET is taken to the rest pose, if it stands in another, or always, or never.",
)
@click.option("--candidate", type=click.IntRange(min=0), default=0, show_default=True, help="Which map to go by.")
@json_option
@match_options
def transfer(
    source: str,
    target: str,
    output: str,
    in_place: bool,
    kinds: str,
    shape: str,
    candidate: int,
    as_json: bool,
    **options: Any,
) -> None:
    """Transfer what the mesh SOURCE carries to the mesh TARGET, which may differ in pose, triangles and placement.

    From glTF these are texture coordinates, colours, materials with their images, morph targets, and skin weights: the
    joints come along, with what animates them, and TARGET moves as SOURCE does. OBJ has texture coordinates, colours
    and materials, PLY texture coordinates and colours; of other formats only the shape is read.
    """
    try:
        chosen = _checked_kinds(kinds)
        check_format(output)
        check_output(output, [each for each in (source, target, options["landmarks"]) if each], in_place)
        assets = read_asset(source), read_asset(target)
        steps = _steps(*assets, candidate, chosen, shape.replace("-", " "), start_arguments(**options))
        result, carried = with_progress_bar(steps)
        left_out = write_asset(carried.asset, output)
    except (ValueError, OSError, ImportError) as error:
        raise click.ClickException(str(error)) from None
    notes = [*assets[0].notes, *result.notes, *carried.notes, *left_out]
    received = [*carried.received, *(["skin weights"] if carried.asset.skin is not None else [])]
    lines = [
        f"Transferred: {', '.join(received)}.",
        *match_lines(result),
        f"{len(result.candidates)} maps were found; where sides are swapped, try --candidate 1.",
        *notes,
        f"Written to {output}",
    ]
    say(lines, {"output": output, "transferred": received, **match_figures(result), "notes": notes}, as_json)


def _checked_kinds(kinds: str) -> list[str]:
    chosen = [kind.strip().lower().replace("-", " ") for kind in kinds.split(",") if kind.strip()]
    unknown = [kind for kind in chosen if kind not in KINDS]
    if unknown or not chosen:
        known = ", ".join(kind.replace(" ", "-") for kind in KINDS)
        raise MeshError(f"--kinds is {kinds!r}: give some of {known}, with commas between.")
    return chosen


def _steps(
    source: Asset, target: Asset, candidate: int, kinds: list[str], shape: str, arguments: dict[str, Any]
) -> Steps[tuple[MatchResult, TransferredAsset]]:
    result = yield from within(match_steps(source.surface, target.surface, **arguments), 0.0, MATCHED)
    if candidate:
        result = yield from within(result.use_steps(candidate), MATCHED, MATCHED)
    carried = yield from within(transfer_asset_steps(source, target, result, kinds, shape), MATCHED, 1.0)
    return result, carried
