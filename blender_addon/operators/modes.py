# SPDX-License-Identifier: GPL-3.0-or-later
"""Leaving the mode of the active object, such as Edit or Sculpt Mode, while an operator works, and coming back to it.

What was changed in a mode may be in the mesh only once that is left. Selections within meshes and the tools of modes
are kept by Blender.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
from bpy.types import Context, Object, Operator, Window

from ..translations import translated

# Modes whose undo steps are not of the whole file: what an operator did is pushed before these are entered again.
OWN_UNDO = frozenset({"EDIT", "PARTICLE_EDIT", "TEXTURE_PAINT"})
# What the history of undo calls the state before an operator.
BEFORE = "Sculpted"


@dataclass(frozen=True)
class Left:
    """A mode that was left.

    Attributes:
        mode: of the active object, as `Object.mode` says it.
        active: `session_uid` of that object.
        others: those of the other objects that were in the mode.
    """

    mode: str
    active: int
    others: frozenset[int]


def leave(context: Context, operator: Operator) -> Left | None:
    """Switch to Object Mode for an operator; None where that is on already.

    From what an operator did Blender cannot undo to a stroke in Sculpt Mode, which alone is stored: a step of the
    whole file goes before.
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


def come_back(context: Context, left: Left | None) -> None:
    """Switch to the mode that was left, unless another object was made active, or is in a mode."""
    obj = None if left is None else context.view_layer.objects.active
    if left is None or obj is None or obj.session_uid != left.active or obj.mode != "OBJECT":
        return
    # The objects that enter Edit Mode with the active one are those that are selected.
    wrong = [] if left.mode != "EDIT" else [other for other in _others(context) if _is_wrong(other, left)]
    for other in wrong:
        other.select_set(not other.select_get())
    bpy.ops.object.mode_set(mode=left.mode)
    for other in wrong:
        other.select_set(not other.select_get())


def come_back_later(context: Context, left: Left | None) -> None:
    """Switch to the mode that was left once Blender is idle, if no other file is opened before."""
    window = context.window
    if left is not None:
        bpy.app.timers.register(lambda: _come_back_in(window, left), first_interval=0)


def come_back_after(context: Context, left: Left | None, operator: Operator, result: set[str]) -> set[str]:
    """Switch to the mode that was left at the end of an operator, so that what that did is one undo step.

    Blender pushes that step after the operator. In Edit Mode it would be of the mesh alone, and undo would leave what
    is not in the mesh: vertex groups, modifiers, and that there is a match.

    Args:
        context: Blender's.
        left: what `leave` gave.
        operator: that ends.
        result: what it returns.

    Returns:
        The result.
    """
    done = result == {"FINISHED"} and "UNDO" in operator.bl_options
    if left is None or left.mode not in OWN_UNDO or not done:
        come_back(context, left)
    elif bpy.app.background:  # where nothing is pushed, and no timer runs
        bpy.ops.ed.undo_push(message=translated(operator.bl_label))
        come_back(context, left)
    else:
        come_back_later(context, left)
    return result


def _come_back_in(window: Window, left: Left) -> None:
    if window in bpy.context.window_manager.windows[:]:
        with bpy.context.temp_override(window=window):
            come_back(bpy.context, left)


def _others(context: Context) -> list[Object]:
    """Meshes besides the active object that are selected, or may be."""
    active = context.view_layer.objects.active
    return [obj for obj in context.view_layer.objects if obj not in (None, active) and obj.visible_get()]


def _is_wrong(obj: Object, left: Left) -> bool:
    """Whether an object is selected though it was not in the mode, or the other way round."""
    return obj.select_get() != (obj.session_uid in left.others)
