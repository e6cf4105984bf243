"""Options that several commands have, and what they mean to the core."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from platformdirs import user_cache_dir
from tqdm import tqdm

from zoomout_core.maps.surface_map import read_vertex_map
from zoomout_core.matching.memory_cache import store_shapes
from zoomout_core.matching.options import PARTIAL
from zoomout_core.matching.presets import DETAIL, resolve_detail
from zoomout_core.mesh.surface import MeshError
from zoomout_core.runtime.progress import Progress, progress
from zoomout_core.runtime.threads import set_threads
from zoomout_core.text_arguments import STARTS, read_axis, read_landmarks

NO_CACHE = "off"


def threads_option(command: Any) -> Any:
    """Give a command the number of threads that it works with."""

    def set_them(_: click.Context, __: click.Parameter, count: int | None) -> None:
        if count is not None:
            set_threads(count)

    option = click.option(
        "--threads",
        type=click.IntRange(1),
        expose_value=False,
        callback=set_them,
        help="Threads that work at a time; the result does not depend on it (default: the cores, up to 8).",
    )
    return option(command)


def in_place_option(command: Any) -> Any:
    """Let a command write over what it reads."""
    option = click.option("--in-place", is_flag=True, help="The output may take the place of an input.")
    return option(command)


def batch_options(endings: Sequence[str], default: str) -> Callable[[Any], Any]:
    """The options of every command that goes from one source to many targets.

    Args:
        endings: of the files that can be written, such as `.ply`.
        default: that of the files in a folder.
    """
    names = [ending[1:] for ending in endings]

    def with_options(command: Any) -> Any:
        for option in (
            in_place_option,
            click.option(
                "--candidate",
                type=click.IntRange(min=0),
                default=0,
                show_default=True,
                help="Which of the maps that are found to use: another if sides are swapped.",
            ),
            click.option(
                "--format",
                "ending",
                type=click.Choice(names),
                default=default,
                show_default=True,
                help="Of the files in a folder.",
            ),
            click.option(
                "-o",
                "--output",
                required=True,
                type=click.Path(),
                help=f"The file to write for a single target ({', '.join(names)}); or a folder, for any number.",
            ),
            click.argument("targets", metavar="TARGETS...", nargs=-1, required=True, type=click.Path()),
            click.argument("source", type=click.Path()),
        ):
            command = option(command)
        return command

    return with_options


def detail_options(command: Any) -> Any:
    """How finely meshes are analysed."""
    for option in (
        click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the eigensolver."),
        click.option(
            "--detail",
            type=click.Choice(list(DETAIL)),
            default="balanced",
            show_default=True,
            help="How fine a stand-in for the mesh to match, and by how many eigenfunctions and samples; full: none, "
            "which takes many times as long.",
        ),
    ):
        command = option(command)
    return command


def mesh_options(command: Any) -> Any:
    """The options of every command that analyses meshes."""
    for option in (
        detail_options,
        click.option(
            "--cache",
            default=user_cache_dir("zoomout", appauthor=False),
            envvar="ZOOMOUT_CACHE",
            show_default=True,
            show_envvar=True,
            expose_value=False,
            callback=lambda _context, _option, folder: store_shapes(None if folder == NO_CACHE else folder),
            help="Folder in which prepared meshes are kept for the next match, a gigabyte at most; off: nowhere.",
        ),
    ):
        command = option(command)
    return command


def match_options(command: Any) -> Any:
    """The options of every command that matches two meshes."""
    for option in (
        mesh_options,
        click.option(
            "--common-axis",
            "common_axes",
            multiple=True,
            metavar="X,Y,Z",
            help="A direction in which both meshes stand alike, or x, y, z for short: evidence. May be repeated.",
        ),
        click.option(
            "--earlier-map",
            type=click.Path(exists=True, dir_okay=False),
            help="A map.npz of these meshes, by `zoomout match`: evidence, whereas --initial starts from it alone.",
        ),
        click.option(
            "--partial",
            type=click.Choice(PARTIAL),
            default="auto",
            show_default=True,
            help="Whether one mesh is tried as a part of the other where they are not recognised as wholes.",
        ),
        click.option("--exact-landmarks", is_flag=True, help="Bend the map so that it hits the landmarks."),
        click.option(
            "--landmarks",
            type=click.Path(exists=True, dir_okay=False),
            help="Text file of pairs, one a line: a source vertex and a target vertex, numbered from 0; or the six "
            "coordinates of a point on the source and of one on the target.",
        ),
        click.option(
            "--initial",
            default="auto",
            show_default=True,
            help="How to begin: auto, landmarks, proximity, or a map.npz written by `zoomout match`.",
        ),
    ):
        command = option(command)
    return command


def start_arguments(
    initial: str,
    landmarks: str | None,
    exact_landmarks: bool,
    earlier_map: str | None,
    common_axes: Sequence[str],
    partial: str,
    detail: str,
    seed: int,
) -> dict[str, Any]:
    """What the options of `match_options` mean to `match`.

    Raises:
        MeshError: options that do not fit together, or a file or a direction that cannot be used.
    """
    arguments = resolve_detail(detail, seed=seed, initial=initial, partial=partial)
    if landmarks is None and (initial == "landmarks" or exact_landmarks):
        wish = "--exact-landmarks" if exact_landmarks else "A start from landmarks"
        raise MeshError(f"{wish} needs --landmarks FILE, which names pairs of vertices or of points.")
    if landmarks is not None:
        arguments |= {"landmarks": read_landmarks(landmarks), "exact_landmarks": exact_landmarks}
    if initial not in STARTS:
        if not Path(initial).is_file():
            raise MeshError(f"--initial is {initial!r}: give {', '.join(STARTS)}, or the file of an earlier map.")
        arguments.update(initial="given", initial_map=read_vertex_map(initial))
    if earlier_map is not None:
        if initial != "auto":
            raise MeshError(f"--earlier-map is evidence for --initial auto, not for {initial}: leave one of them out.")
        arguments["initial_map"] = read_vertex_map(earlier_map)
    if common_axes:
        if initial not in ("auto", "landmarks"):
            raise MeshError(f"--common-axis is evidence for --initial auto, not for {initial}: leave one of them out.")
        arguments["common_axes"] = [read_axis(axis) for axis in common_axes]
    return arguments


@contextmanager
def progress_bar() -> Iterator[None]:
    """Show the progress of a block on the terminal."""
    with tqdm(total=100, bar_format="{desc:28}{percentage:3.0f}%|{bar}| {elapsed}<{remaining}") as bar:

        def show(latest: Progress) -> None:
            if latest.stage:
                bar.set_description_str(latest.stage, refresh=False)
            bar.update(100 * latest.fraction - bar.n)

        with progress(show):
            yield
        bar.update(100 - bar.n)
