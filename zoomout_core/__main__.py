# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout`, also `python -m zoomout_core`; names the extra to install if packages are missing."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import NoReturn

from zoomout_core.messages import NO_MEMORY, message_of
from zoomout_core.runtime.child_process import leave_out_working_folder
from zoomout_core.runtime.extras import install_hint
from zoomout_core.runtime.interrupts import INTERRUPTED, handle_interrupts
from zoomout_core.runtime.terminal import drop_output, print_any_character


def run(commands: str, name: str, extra: str) -> None:
    """Run the `main` of the module `commands`, and end the process; reports an interrupt by the user in one line.

    `name` is its name for the user, `extra` the extra of the package `zoomout-core` that installs its requirements.
    """
    leave_out_working_folder()
    print_any_character()
    try:
        _run(commands, name)
    except KeyboardInterrupt:
        print(f"{name}: interrupted; incomplete files were not written.", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except MemoryError:
        sys.exit(f"Error: {NO_MEMORY}")
    except ModuleNotFoundError as error:
        own = __package__, commands.partition(".")[0]
        if error.name is None or error.name.partition(".")[0] in own:
            raise
        sys.exit(f"{name} needs the package {error.name}, which is missing: {install_hint(extra)}.")


def _run(commands: str, name: str) -> NoReturn:
    """`run`, without handling of errors that a command line does not catch."""
    import click

    try:
        with handle_interrupts():
            status = import_module(commands).main.main(prog_name=name, standalone_mode=False)
            if sys.stdout is not None:  # the user has closed it
                sys.stdout.flush()
            sys.exit(status)
    except click.Abort:  # click's error for an interrupt
        raise KeyboardInterrupt from None
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except OSError as error:
        drop_output()
        if error.filename is not None:  # standard output has no name
            sys.exit(f"Error: {message_of(error)}")
        sys.exit(
            f"Error: the report could not be printed ({error.strerror or error}), but all output files are complete: "
            "print it elsewhere."
        )


def main() -> None:
    """The command `zoomout`."""
    run("zoomout_core.cli", "zoomout", "cli")


if __name__ == "__main__":
    main()
