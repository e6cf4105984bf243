# SPDX-License-Identifier: GPL-3.0-or-later
"""Running modal operators, so that disabling the extension can cancel them.

Blender frees a running operator whose class is unregistered without calling its `cancel`, which resets timers, status
bar and cursor.
"""

from __future__ import annotations

import bpy
from bpy.types import Context, Operator, Window

_running: list[tuple[Operator, Window]] = []


def can_begin(window: Window | None) -> bool:
    """Whether there is a window, and an operator can be added to those that receive its events.

    When the class of a running operator is unregistered, Blender keeps its empty place until the next event. Blender
    4.3 crashes if another operator is added before that, such as by a script that disables and enables an extension.
    """
    if window is None:
        return False
    # Reading any attribute of an empty place is an error.
    return all(bpy.types.bpy_struct.as_pointer(operator) for operator in window.modal_operators)


def begin(context: Context, operator: Operator) -> None:
    """Send the events of the window to an operator, until it ends."""
    context.window_manager.modal_handler_add(operator)
    _running.append((operator, context.window))


def end(operator: Operator) -> None:
    """Remove an operator that has ended."""
    _running[:] = [entry for entry in _running if entry[0] is not operator]


def cancel_all() -> None:
    """Cancel all running operators."""
    for operator, window in list(_running):
        with bpy.context.temp_override(window=window):
            operator.cancel(bpy.context)
