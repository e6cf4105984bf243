"""Modal operators that are under way, so that disabling the extension can end them.

Blender frees a running operator whose class is unregistered, but does not call its `cancel`: timers, status bar and
cursor would stay as they are.
"""

from __future__ import annotations

import bpy
from bpy.types import Context, Operator, Window

_under_way: list[tuple[Operator, Window]] = []


def begin(context: Context, operator: Operator) -> None:
    """Have an operator receive the events of the window, until it ends."""
    context.window_manager.modal_handler_add(operator)
    _under_way.append((operator, context.window))


def end(operator: Operator) -> None:
    """Take note that an operator has ended."""
    _under_way[:] = [entry for entry in _under_way if entry[0] is not operator]


def cancel_all() -> None:
    """Cancel all that are under way."""
    for operator, window in list(_under_way):
        with bpy.context.temp_override(window=window):
            operator.cancel(bpy.context)
