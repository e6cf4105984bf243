# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `blender --command zoomout`, for pipelines: matching, transferring and symmetry without a window.

blender --background FILE.blend --command zoomout transfer --source Hero --target Scan --save OUT.blend
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from typing import Any

import bpy

from zoomout_core.runtime.interrupts import INTERRUPTED, handle_interrupts
from zoomout_core.runtime.terminal import print_any_character

NAME = "zoomout"

_handle: Any = None


def register() -> None:
    """Register the command with Blender."""
    global _handle
    _handle = bpy.utils.register_cli_command(NAME, main)


def unregister() -> None:
    """Unregister the command."""
    bpy.utils.unregister_cli_command(_handle)


def main(command_line: Sequence[str]) -> int:
    """Run the command on the open file.

    Args:
        command_line: the arguments after the command's name.

    Returns:
        0 if everything succeeded, 1 if anything failed, 2 if the arguments are invalid, 130 if it was interrupted.
    """
    print_any_character()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # Blender sets its own without a window
    try:
        with handle_interrupts():
            from . import command  # it needs every service, and enabling the add-on none

            return command.run(command_line)
    except KeyboardInterrupt:
        print("zoomout: interrupted; incomplete files were not written.", file=sys.stderr)
        return INTERRUPTED
    finally:
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)
