# SPDX-License-Identifier: GPL-3.0-or-later
"""A group of commands that are imported when they are called, and report errors as JSON, too."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import click

from zoomout_core.global_options import quiet_option
from zoomout_core.messages import NO_MEMORY

# The option of every command to report as JSON.
JSON = "--json"


class CommandGroup(click.Group):
    """Commands whose errors go to standard output as `{"error": sentence}` if they are called with `--json`.

    Args:
        summaries: the first sentences of the commands' help, by name.
        options: of click's group.
    """

    def __init__(self, *args: Any, summaries: Mapping[str, str], **options: Any) -> None:
        super().__init__(*args, **options)
        self._summaries = summaries

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(self._summaries)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name in self._summaries and name not in self.commands:
            module = import_module(f"zoomout_core.cli.{name}_command")
            self.add_command(quiet_option(getattr(module, name)))
        return super().get_command(ctx, name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, self._summaries[name]) for name in self.list_commands(ctx)])

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.meta[JSON] = JSON in args
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except (click.ClickException, MemoryError) as error:
            if not ctx.meta[JSON]:
                raise
            known = error if isinstance(error, click.ClickException) else click.ClickException(NO_MEMORY)
            click.echo(json.dumps({"error": known.format_message()}, indent=1))
            ctx.exit(known.exit_code)
