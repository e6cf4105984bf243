# SPDX-License-Identifier: GPL-3.0-or-later
"""Options shared by several commands, and their conversion to arguments of the core."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource
from platformdirs import user_cache_dir

from zoomout_core.arrays import Floats
from zoomout_core.assets.gltf.compress import METHODS
from zoomout_core.global_options import is_quiet
from zoomout_core.matching.option_table import (
    ACCURACY,
    MATCHING,
    OPTIONS,
    RESULT,
    Interface,
    Kind,
    Option,
    select_options,
)
from zoomout_core.matching.preparation.memory_cache import store_shapes
from zoomout_core.matching.presets import resolve_detail
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.opening import existing
from zoomout_core.messages import message_of
from zoomout_core.runtime.progress import Progress, progress
from zoomout_core.text_arguments import STARTS, read_axis, read_values

try:
    from tqdm import tqdm
except ValueError:  # tqdm reads its settings when it is imported
    raise click.UsageError(
        "An environment variable that begins with TQDM_ has a value of the wrong type: unset it, or correct it."
    ) from None

NO_CACHE = "off"
# The start of `zoomout match` that is not refined.
NEAREST = "nearest"
# The argument before the targets.
SOURCE = {"source": "SOURCE"}


in_place_option = click.option("--in-place", is_flag=True, help="Allow the output to replace an input.")


class OptionError(click.ClickException):
    """Options that a command does not understand, or that do not fit together, in one sentence."""

    exit_code = 2


class FilePath(click.Path):
    """A path, which is not empty: click would read an unset variable of a shell as the working folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not value:
            self.fail("it is empty: give a path.", param, ctx)
        return super().convert(value, param, ctx)


class InputFile(FilePath):
    """The path of an existing file; a missing one is a failure like that of a mesh, not a mistake of usage."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            existing(value)
        except MeshError as error:
            raise click.ClickException(str(error)) from None
        return super().convert(value, param, ctx)


@contextmanager
def refusals() -> Iterator[None]:
    """Report invalid input and unusable files in the block without a traceback, in one sentence."""
    try:
        yield
    except (ValueError, OSError, ImportError) as error:
        raise click.ClickException(message_of(error)) from None


def folders_option(command: Any) -> Any:
    """Add an option for further folders with files that a mesh file names."""
    option = click.option(
        "--allow-folder",
        "folders",
        multiple=True,
        type=FilePath(exists=True, file_okay=False),
        help="Folder from which buffers, materials and images may be read, besides the mesh's; may be repeated.",
    )
    return option(command)


def compress_option(command: Any) -> Any:
    """Add an option to compress the glTF files that a command writes."""
    option = click.option(
        "--compress",
        "compression",
        type=click.Choice(METHODS),
        help="Compress the meshes of .glb and .gltf files; numbers are rounded to a 100,000th of the size.",
    )
    return option(command)


def tell(line: str) -> None:
    """Print a line for the user, unless the command is quiet."""
    if not is_quiet():
        click.echo(line)


def batch_options(
    endings: Sequence[str],
    default: str | None,
    about_format: str = "Format of the files in an output folder.",
    inputs: Mapping[str, str] = SOURCE,
) -> Callable[[Any], Any]:
    """The options of every command that goes from one source to many targets.

    Args:
        endings: extensions of the files that can be written, such as `.ply`.
        default: extension of the files in a folder.
        about_format: help on the extension.
        inputs: the arguments before the targets, by name, as the usage line shows them.
    """
    names = [ending[1:] for ending in endings]

    def with_options(command: Any) -> Any:
        for option in (
            in_place_option,
            click.option("--force", is_flag=True, help="Write a target even if its match is probably wrong."),
            table_options(RESULT),
            click.option(
                "--format",
                "ending",
                type=click.Choice(names),
                default=default,
                show_default=True,
                help=about_format,
            ),
            click.option(
                "-o",
                "--output",
                required=True,
                type=FilePath(),
                help=f"The file to write for a single target ({', '.join(names)}); or a folder, for any number.",
            ),
            click.argument("targets", metavar="TARGETS...", nargs=-1, required=True, type=FilePath()),
            *(click.argument(name, metavar=inputs[name], type=FilePath()) for name in reversed(list(inputs))),
        ):
            command = option(command)
        return command

    return with_options


def detail_options(command: Any) -> Any:
    """How finely meshes are analysed."""
    return table_options(ACCURACY)(command)


def mesh_options(command: Any) -> Any:
    """The options of every command that analyses meshes."""
    cache = click.option(
        "--cache",
        default=user_cache_dir("zoomout", appauthor=False),
        envvar="ZOOMOUT_CACHE",
        show_default=True,
        show_envvar=True,
        expose_value=False,
        callback=_set_cache,
        help="Folder that caches prepared meshes for the next match, a gigabyte at most; off disables the cache.",
    )
    return cache(detail_options(command))


def _set_cache(context: click.Context, _: click.Parameter, folder: str) -> None:
    """Cache shapes in a folder; one that the user chose has to be writable."""
    if folder == NO_CACHE:
        store_shapes(None)
        return
    if context.get_parameter_source("cache") is not ParameterSource.DEFAULT:
        check_cache(folder, f", or {NO_CACHE}")
    store_shapes(folder)


def check_cache(folder: str | Path, alternative: str = "") -> None:
    """Raise a ClickException if the folder of --cache cannot be made or written to; it also names an `alternative`."""
    place = Path(os.path.realpath(folder))
    first = next(each for each in (place, *place.parents) if os.path.exists(each))  # pathlib's raises errors
    if not str(folder) or not (first.is_dir() and os.access(first, os.W_OK)):
        raise click.ClickException(f"--cache {folder} cannot be written to: choose another folder{alternative}.")


def match_options(command: Any, starts: Sequence[str] = ()) -> Any:
    """The options of every command that matches two meshes.

    Args:
        command: the command.
        starts: starts that it offers beside those of the others.
    """
    return table_options(MATCHING, starts)(mesh_options(command))


def table_options(options: Sequence[Option], starts: Sequence[str] = ()) -> Callable[[Any], Any]:
    """The options of a table that are available on the command line, and further starts of a match."""

    def with_options(command: Any) -> Any:
        for option in reversed(select_options(options, Interface.COMMAND_LINE)):
            command = table_option(option, starts)(command)
        return command

    return with_options


def table_option(option: Option, starts: Sequence[str] = ()) -> Callable[[Any], Any]:
    """The command-line option of a row of the table, and further starts of a match."""
    flag = option.name_in(Interface.COMMAND_LINE)
    if option.kind is Kind.FLAG:
        names = f"{flag}/--no-{flag.removeprefix('--')}" if option.default else flag
        return click.option(names, option.name, is_flag=True, default=option.default, help=_help_of(option, starts))
    keywords = _values_of(option)
    if option.default is not None:
        keywords |= {"default": option.default, "show_default": True}
    return click.option(flag, option.name, help=_help_of(option, starts), **keywords)


def _values_of(option: Option) -> dict[str, Any]:
    """Arguments for click that describe an option's values."""
    if option.kind is Kind.CHOICE:
        return {"type": click.Choice([choice.name for choice in option.choices_in(Interface.COMMAND_LINE)])}
    if option.kind is Kind.START:
        return {"type": str}
    if option.kind is Kind.COUNT:
        low, high = (None if end is None else int(end) for end in (option.minimum, option.maximum))
        return {"type": click.IntRange(low, high)}
    if option.kind in (Kind.NUMBER, Kind.ANGLE):
        return {"type": float}
    if option.kind is Kind.DIRECTIONS:
        return {"multiple": True, "metavar": option.kind.value}
    return {"type": InputFile()}


def _help_of(option: Option, starts: Sequence[str]) -> str:
    """The help of an option, with additions for the command line."""
    text = option.help
    if option.starts == ("nearest",):
        text = f"With --initial nearest: {text[0].lower()}{text[1:]}"
    if option.kind is Kind.START:
        choices = ", ".join([*(choice.name for choice in option.choices_in(Interface.COMMAND_LINE)), *starts])
        text += f": {choices}, or a map.npz written by `zoomout match`"
    elif option.kind is Kind.ANGLE:
        text += ", in degrees"
    elif option.kind is Kind.DIRECTIONS:
        text += ". May be repeated"
    return f"{text}."


def start_arguments(**options: Any) -> dict[str, Any]:
    """The arguments of `match` from the options of `match_options`.

    Raises:
        OptionError: options do not fit together, or a direction is invalid.
        MeshError: a file is invalid.
    """
    return resolve_detail(**read_options(**options))


def read_options(
    initial: str,
    landmarks: str | None,
    exact_landmarks: bool,
    earlier_map: str | None,
    common_axes: Sequence[str],
    more_starts: Sequence[str] = (),
    **others: Any,
) -> dict[str, Any]:
    """The options of `match_options` with files and directions read; `detail` stays a word.

    `more_starts` are starts that the command itself offers, for messages.

    Raises:
        OptionError, MeshError: see `start_arguments`.
    """
    if landmarks is None and (initial == "landmarks" or exact_landmarks):
        wish = "--exact-landmarks" if exact_landmarks else "A start from landmarks"
        raise OptionError(f"{wish} needs --landmarks FILE, which names pairs of vertices or of points.")
    if initial not in STARTS and not Path(initial).is_file():
        if initial == NEAREST:
            raise OptionError(
                "--initial nearest is a start of `zoomout match` alone: run that, and give its map as --initial."
            )
        known = ", ".join((*STARTS, *more_starts))
        raise OptionError(f"--initial is {initial!r}: give {known}, or the file of an earlier map.")
    if (earlier_map and initial != "auto") or (common_axes and initial not in ("auto", "landmarks")):
        wish = "--earlier-map" if earlier_map else "--common-axis"
        raise OptionError(f"{wish} is evidence for --initial auto, not for {initial}: leave one of them out.")
    for text in common_axes:
        check_axis(text, OPTIONS["common_axes"].name_in(Interface.COMMAND_LINE))
    files = {"landmarks": landmarks, "initial_map": earlier_map, "common_axes": list(common_axes) or None}
    if initial not in STARTS:
        files["initial_map"], initial = initial, "given"
    return read_values(
        {"initial": initial, "exact_landmarks": exact_landmarks, **files, **others}, Interface.COMMAND_LINE
    )


def files_of_options(options: Mapping[str, Any]) -> list[str]:
    """The files that the options of `match_options` name."""
    return [options[name] for name in ("landmarks", "earlier_map", "initial") if options[name]]


def check_axis(text: str, option: str) -> Floats:
    """The direction of an option, see `read_axis`.

    Raises:
        OptionError: it is not a direction.
    """
    try:
        return read_axis(text, option)
    except MeshError as error:
        raise OptionError(str(error)) from None


@contextmanager
def progress_bar() -> Iterator[Any]:
    """Show the progress of a block on the terminal, in a bar that the block closes if it fails without an exception."""
    with tqdm(
        total=100, bar_format="{desc:28}{percentage:3.0f}%|{bar}| {elapsed}<{remaining}", disable=is_quiet()
    ) as bar:

        def show(latest: Progress) -> None:
            if latest.stage:
                bar.set_description_str(latest.stage, refresh=False)
            bar.update(100 * latest.fraction - bar.n)

        with progress(show):
            yield bar
        bar.update(100 - bar.n)
