# SPDX-License-Identifier: GPL-3.0-or-later
"""Running modal operators, so that disabling the extension can end them.

Blender frees a running operator whose class is unregistered, but does not call its `cancel`: timers, status bar and
cursor would stay as they are.
"""

from __future__ import annotations

import bpy
from bpy.types import Context, Operator, Window

_running: list[tuple[Operator, Window]] = []


def can_begin(window: Window | None) -> bool:
    """Whether there is a window, and another operator can be added to those that receive its events.

    Where the class of one that was running is unregistered, Blender keeps its empty place until the next event, and 4.3
    crashes when another one is added before, as by a script that disables and enables an extension.
    """
    if window is None:
        return False
    # Even to ask an empty place for its attributes is an error.
    return all(bpy.types.bpy_struct.as_pointer(operator) for operator in window.modal_operators)


def begin(context: Context, operator: Operator) -> None:
    """Have an operator receive the events of the window, until it ends."""
    context.window_manager.modal_handler_add(operator)
    _running.append((operator, context.window))


def end(operator: Operator) -> None:
    """Take note that an operator has ended."""
    _running[:] = [entry for entry in _running if entry[0] is not operator]


def cancel_all() -> None:
    """Cancel all that are under way."""
    for operator, window in list(_running):
        with bpy.context.temp_override(window=window):
            operator.cancel(bpy.context)
