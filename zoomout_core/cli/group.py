# SPDX-License-Identifier: GPL-3.0-or-later
"""A group of commands that report errors as JSON, too."""

from __future__ import annotations

import json
from typing import Any

import click

from zoomout_core.mesh.memory import NO_MEMORY

# The option of every command to report as JSON.
JSON = "--json"


class CommandGroup(click.Group):
    """Commands whose errors go to standard output as `{"error": sentence}` if they are called with `--json`."""

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
