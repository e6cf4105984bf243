# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout`, also as `python -m zoomout_core`; without the packages that it needs it names the extra."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import NoReturn

from zoomout_core.runtime.interrupts import INTERRUPTED, handle_interrupts


def run(commands: str, name: str, extra: str) -> None:
    """Run the command line of a module, and end the process; where the user interrupts it, with a line that says so.

    Args:
        commands: the module, whose `main` it is.
        name: how the user calls it.
        extra: of the package `zoomout-core`, that brings what the module needs.
    """
    try:
        _run(commands, name)
    except KeyboardInterrupt:
        print(f"{name}: interrupted; incomplete files were not written.", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except MemoryError:
        sys.exit(f"Error: {import_module('zoomout_core.mesh.memory').NO_MEMORY}")
    except ModuleNotFoundError as error:
        own = __package__, commands.partition(".")[0]
        if error.name is None or error.name.partition(".")[0] in own:
            raise
        sys.exit(f"{name} needs the package {error.name}, which is missing: pip install 'zoomout-core[{extra}]'.")


def _run(commands: str, name: str) -> NoReturn:
    """`run`, which may end with what a command line does not catch."""
    import click

    try:
        with handle_interrupts():
            sys.exit(import_module(commands).main.main(prog_name=name, standalone_mode=False))
    except click.Abort:  # which an interrupt becomes
        raise KeyboardInterrupt from None
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)


def main() -> None:
    """The command `zoomout`."""
    run("zoomout_core.cli", "zoomout", "cli")


if __name__ == "__main__":
    main()
