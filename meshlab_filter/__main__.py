"""The filters on files: `python -m meshlab_filter transfer SOURCE TARGET -o OUT.ply`, and scripts of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from meshlab_filter.filters import transfer_attributes_by_zoomout
from meshlab_filter.mesh_data import custom_in_ply
from meshlab_filter.script import read_script, run_script_steps
from zoomout_core.cli import match_options, start_arguments, with_progress_bar
from zoomout_core.correspondence.detail import DETAIL
from zoomout_core.surface import MeshError

if TYPE_CHECKING:
    from pymeshlab import MeshSet

# What of the results the formats can hold.
FORMATS = {
    ".ply": {"texcoord", "vertex_color", "face_color", "vertex_scalar", "face_scalar"},
    ".obj": {"texcoord", "vertex_color", "face_color"},
}


@click.group()
def main() -> None:
    """Filters for mesh files, in every format that MeshLab reads."""


@main.command()
@click.argument("source", type=click.Path())
@click.argument("target", type=click.Path())
@click.option("-o", "--output", required=True, type=click.Path(dir_okay=False), help="The PLY or OBJ file to write.")
@click.option(
    "--candidate", default=0, show_default=True, help="Which correspondence to use: another if sides are swapped."
)
@match_options
def transfer(source: str, target: str, output: str, candidate: int, **options: Any) -> None:
    """Transfer texture coordinates, colours and scalars from the mesh SOURCE to the mesh TARGET.

    They may differ in pose, in triangles and in placement. Textures are written beside the output.
    """
    try:
        kept = _kept_in(output)
        ms = _loaded(source, target)
        preset = DETAIL[options["detail"]]
        matching = {name: value for name, value in start_arguments(**options).items() if name not in preset}
        steps = transfer_attributes_by_zoomout.row.run(ms, candidate=candidate, detail=options["detail"], **matching)
        report = with_progress_bar(steps)
        _save(ms, output)
    except (ValueError, OSError, ImportError) as error:
        raise click.ClickException(str(error)) from None
    for line in _summary(report, kept):
        click.echo(line)
    click.echo(f"Written to {output}")


@main.command()
@click.argument("script", type=click.Path())
@click.argument("inputs", nargs=-1, required=True, type=click.Path())
@click.option("-o", "--output", required=True, type=click.Path(dir_okay=False), help="The mesh file to write.")
def run(script: str, inputs: tuple[str, ...], output: str) -> None:
    """Run SCRIPT, a .mlx file, on the meshes INPUTS, and write the mesh that is current in the end.

    The script may mix the filters of MeshLab and of this project. INPUTS are meshes 0, 1 and so on; the last is
    current.
    """
    try:
        _check_folder(output)
        read_script(script)
        ms = _loaded(*inputs)
        reports = with_progress_bar(run_script_steps(ms, script))
        if ms.mesh_number() == 0:
            raise MeshError("No mesh is left to write: keep one.")
        _save(ms, output)
    except (ValueError, OSError, ImportError) as error:
        raise click.ClickException(str(error)) from None
    for report in reports:
        for note in report.get("notes", ()):
            click.echo(f"Line {report['line']}, {report['name']}: {note}")
    click.echo(f"Written to {output}")


def _kept_in(output: str) -> set[str]:
    """What the format of the output can hold; said before the work begins, not after."""
    path = Path(output)
    if path.suffix.lower() not in FORMATS:
        raise MeshError(f"{output} ends in '{path.suffix}': choose {' or '.join(FORMATS)}, which can hold the results.")
    _check_folder(output)
    return FORMATS[path.suffix.lower()]


def _check_folder(output: str) -> None:
    if not Path(output).parent.is_dir():
        raise MeshError(f"There is no folder {Path(output).parent}: create it, or write elsewhere.")


def _loaded(*paths: str) -> MeshSet:
    """A MeshSet with one mesh from each file."""
    try:
        import pymeshlab
    except ImportError as error:
        raise ImportError("This needs pymeshlab: pip install 'zoomout-core[meshlab]'.") from error
    ms = pymeshlab.MeshSet()
    for number, path in enumerate(paths):
        gltf = Path(path).suffix.lower() in (".gltf", ".glb")
        try:
            ms.load_new_mesh(path, **({"load_in_a_single_layer": True} if gltf else {}))
        except pymeshlab.PyMeshLabException as error:
            raise MeshError(f"{path} could not be read ({' '.join(str(error).split())}): check the file.") from error
        if ms.mesh_number() > number + 1:
            raise MeshError(f"{path} holds {ms.mesh_number() - number} meshes: merge them into one.")
    return ms


def _save(ms: MeshSet, output: str) -> None:
    """Write the current mesh; to PLY with its custom attributes, which other programs can read, not MeshLab."""
    from pymeshlab import PyMeshLabException

    custom = dict.fromkeys(custom_in_ply(ms), True) if Path(output).suffix.lower() == ".ply" else {}
    try:
        ms.save_current_mesh(output, **custom)
    except PyMeshLabException as error:
        raise MeshError(f"{output} could not be written ({' '.join(str(error).split())}): write elsewhere.") from error


def _summary(report: dict[str, Any], kept: set[str]) -> list[str]:
    """What a user should know about a transfer, a sentence a line."""
    confidence = report["confidence"]
    lines = [
        f"Transferred: {', '.join(report['transferred'])}.",
        f"Mean confidence {confidence.mean():.2f}; {(confidence < 0.5).mean():.1%} of the vertices are below 0.5.",
        f"{len(report['candidates'])} correspondences were found; where sides are swapped, try --candidate 1.",
        *report["notes"],
    ]
    lost = [name for name in report["transferred"] if name not in kept]
    if lost:
        lines.append(f"OBJ cannot hold {' and '.join(lost)}: write PLY to keep them.")
    return lines


if __name__ == "__main__":
    main(prog_name="python -m meshlab_filter")
