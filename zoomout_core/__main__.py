"""The command `zoomout`, also as `python -m zoomout_core`; without the packages that it needs it names the extra."""

from __future__ import annotations

import sys
from importlib import import_module


def run(commands: str, name: str, extra: str) -> None:
    """Run the command line of a module.

    Args:
        commands: the module, whose `main` it is.
        name: how the user calls it.
        extra: of the package `zoomout-core`, that brings what the module needs.
    """
    try:
        command = import_module(commands).main
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] in ("zoomout_core", "meshlab_filter"):
            raise
        sys.exit(f"{name} needs the package {error.name}, which is missing: pip install 'zoomout-core[{extra}]'.")
    command(prog_name=name)


def main() -> None:
    """The command `zoomout`."""
    run("zoomout_core.cli", "zoomout", "cli")


if __name__ == "__main__":
    main()
