# SPDX-License-Identifier: GPL-3.0-or-later
"""Leaving the mode of the active object, such as Edit or Sculpt Mode, during an operator, and restoring it.

Changes made in a mode may not be in the mesh before the mode is left. Blender keeps the selections within meshes and
the tools of modes.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
from bpy.types import Context, Object, Operator, Window

from ...translations import translated

# Modes whose undo steps do not cover the whole file: an operator's step is pushed before these are entered again.
OWN_UNDO = frozenset({"EDIT", "PARTICLE_EDIT", "TEXTURE_PAINT"})
# Name of the state before an operator in the undo history.
BEFORE = "Sculpted"


@dataclass(frozen=True)
class Left:
    """A mode to restore.

    Attributes:
        mode: the active object's mode, a value of `Object.mode`.
        active: `session_uid` of the active object.
        others: `session_uid` of the other objects in the mode.
    """

    mode: str
    active: int
    others: frozenset[int]


def leave(context: Context, operator: Operator) -> Left | None:
    """Switch to Object Mode for an operator; returns None if it is on already.

    Undo steps of Sculpt Mode store only the strokes, and Blender cannot undo an operator back to one. So a step of the
    whole file is pushed before.
    """
    obj = context.active_object
    if obj is None or obj.mode == "OBJECT":
        return None
    others = frozenset(other.session_uid for other in context.objects_in_mode if other != obj)
    left = Left(obj.mode, obj.session_uid, others)
    if left.mode == "SCULPT" and "UNDO" in operator.bl_options:
        bpy.ops.ed.undo_push(message=translated(BEFORE))
    bpy.ops.object.mode_set(mode="OBJECT")
    return left


def restore(context: Context, left: Left | None) -> None:
    """Restore the mode, unless another object has become active, or the object is in another mode."""
    obj = None if left is None else context.view_layer.objects.active
    if left is None or obj is None or obj.session_uid != left.active or obj.mode != "OBJECT":
        return
    # All selected objects enter Edit Mode with the active one.
    wrong = [] if left.mode != "EDIT" else [other for other in _others(context) if _is_wrong(other, left)]
    for other in wrong:
        other.select_set(not other.select_get())
    bpy.ops.object.mode_set(mode=left.mode)
    for other in wrong:
        other.select_set(not other.select_get())


def restore_later(context: Context, left: Left | None) -> None:
    """Restore the mode once Blender is idle, unless another file is opened before."""
    window = context.window
    if left is not None:
        bpy.app.timers.register(lambda: _restore_in(window, left), first_interval=0)


def restore_after(context: Context, left: Left | None, operator: Operator, result: set[str]) -> set[str]:
    """Restore the mode at the end of an operator, so that its changes are one undo step.

    Blender pushes that step after the operator. In Edit Mode it would cover only the mesh, and undo would not revert
    vertex groups, modifiers and the existence of a match.

    Args:
        context: Blender's.
        left: the result of `leave`.
        operator: the operator that ends.
        result: the operator's return value.

    Returns:
        The `result`.
    """
    done = result == {"FINISHED"} and "UNDO" in operator.bl_options
    if left is None or left.mode not in OWN_UNDO or not done:
        restore(context, left)
    elif bpy.app.background:  # Blender pushes no step, and runs no timers
        bpy.ops.ed.undo_push(message=translated(operator.bl_label))
        restore(context, left)
    else:
        restore_later(context, left)
    return result


def _restore_in(window: Window, left: Left) -> None:
    if window in bpy.context.window_manager.windows[:]:
        with bpy.context.temp_override(window=window):
            restore(bpy.context, left)


def _others(context: Context) -> list[Object]:
    """Visible objects other than the active one."""
    active = context.view_layer.objects.active
    return [obj for obj in context.view_layer.objects if obj not in (None, active) and obj.visible_get()]


def _is_wrong(obj: Object, left: Left) -> bool:
    """Whether an object is selected although it was not in the mode, or vice versa."""
    return obj.select_get() != (obj.session_uid in left.others)
