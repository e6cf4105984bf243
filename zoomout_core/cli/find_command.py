# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout find`: the character of a library that fits a new body best."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import click

from zoomout_core.batch import FAILED
from zoomout_core.cli.report import json_option, say
from zoomout_core.command_options import progress_bar
from zoomout_core.library.library import INDEX, Library, find_source
from zoomout_core.library.search import FoundSource, FoundSources
from zoomout_core.messages import message, probability

NOT_PREPARED = "Files of the library that are not prepared: {count}; `zoomout library` prepares them or says why not."


@click.command()
@click.argument("target", type=click.Path())
@click.option(
    "--library",
    "folders",
    multiple=True,
    required=True,
    type=click.Path(),
    help="A folder that `zoomout library` has prepared. May be repeated.",
)
@click.option(
    "--index",
    type=click.Path(file_okay=False),
    help=f"Folder of the index of a single library (default: {INDEX} in it).",
)
@json_option
def find(target: str, folders: tuple[str, ...], index: str | None, as_json: bool) -> None:
    """Find the characters of a library that fit TARGET.

    It may be in any pose, orientation and unit. The exit code is 1 if nothing fits.
    """
    if index is not None and len(folders) > 1:
        raise click.UsageError("--index is of a single library: give one --library, or leave it out.")
    try:
        libraries = [Library(folder, index) for folder in folders]
        with progress_bar():
            found = find_source(target, libraries)
        new = sum(len(library.new_files()) for library in libraries)
    except (ValueError, OSError, ImportError) as error:
        raise click.ClickException(str(error)) from None
    notes = [message(NOT_PREPARED, count=new)] if new else []
    say([*_lines(found), *notes], {"target": target, **_figures(found), "notes": notes}, as_json)
    if found.refusal:
        sys.exit(FAILED)


def _lines(found: FoundSources) -> list[str]:
    lines = [found.refusal] if found.refusal else []
    return lines + [f"{number}. {_line(each)}" for number, each in enumerate(found.ranked, start=1)]


def _line(found: FoundSource) -> str:
    doubt = "" if found.fits else "; does not fit"
    return f"{found.path}: fit {1 - found.misfit:.0%}, {probability(found.certainty)} certain{doubt}."


def _figures(found: FoundSources) -> dict[str, Any]:
    return {
        "best": None if found.best is None else str(found.best.path),
        "refusal": found.refusal or None,
        "nearest": None if found.nearest is None else str(found.nearest),
        "assets": _rows(found.ranked),
    }


def _rows(ranked: Sequence[FoundSource]) -> list[dict[str, Any]]:
    return [
        {
            "file": str(each.path),
            "fits": each.fits,
            "fit": 1 - each.misfit,
            "certainty": each.certainty,
            "difference": each.difference,
        }
        for each in ranked
    ]
