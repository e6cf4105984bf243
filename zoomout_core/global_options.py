# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of all commands. This module imports only click, so that `zoomout --help` appears at once."""

from __future__ import annotations

from typing import Any

import click

QUIET = "zoomout.quiet"


def _set_threads(_context: click.Context, _option: click.Parameter, count: int | None) -> None:
    if count is not None:
        from zoomout_core.runtime.threads import set_threads

        set_threads(count)


threads_option = click.option(
    "--threads",
    type=click.IntRange(1),
    expose_value=False,
    callback=_set_threads,
    help="Threads that work at a time; the result does not depend on it (default: the cores, up to 8).",
)


def quiet_option(command: Any) -> Any:
    """Add an option to print nothing but errors."""

    def set_it(context: click.Context, __: click.Parameter, quiet: bool) -> None:
        if quiet:
            context.meta[QUIET] = True  # which contexts of subcommands share

    option = click.option(
        "-q",
        "--quiet",
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=set_it,
        help="Show no progress; print only errors and the output of --json.",
    )
    return option(command)


def is_quiet() -> bool:
    """Whether the command that is running was given --quiet."""
    context = click.get_current_context(silent=True)
    return context is not None and QUIET in context.meta
