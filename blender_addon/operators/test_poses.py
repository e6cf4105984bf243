# SPDX-License-Identifier: GPL-3.0-or-later
"""Play the poses of *Bind to Rig*'s check in the viewport, and restore the pose at the end."""

from __future__ import annotations

from time import monotonic

import bpy
import numpy as np
from bpy.types import Context, Event, Operator, Timer

from zoomout_core.messages import message
from zoomout_core.transfer.stretch import extreme_turns

from ..mesh_data import HeldPose, armatures_of, follow_constraints, read_bones, turn_bones
from ..translations import reported, translated
from . import modal

# Seconds of each pose, from rest and back, and between two steps.
SECONDS, STEP = 1.0, 0.04
# Events that end the operator, and those that only turn the view.
ENDING = ("ESC", "RET", "LEFTMOUSE", "RIGHTMOUSE")
OF_VIEW = ("MIDDLEMOUSE", "MOUSEMOVE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TRACKPADPAN", "TRACKPADZOOM", "NDOF_MOTION")


class ZOOMOUT_OT_test_poses(Operator):
    bl_idname = "zoomout.test_poses"
    bl_label = "Test Poses"
    bl_description = (
        "Turn the bones of the active mesh's armature to extremes, as Bind to Rig does before it writes anything. A "
        "click or ESC ends it and restores the pose"
    )
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active mesh has an armature whose bones can be turned."""
        reason = _obstacle(context)
        if reason:
            cls.poll_message_set(translated(reason).removesuffix("."))
        return not reason

    def invoke(self, context: Context, event: Event) -> set[str]:
        """Start to play."""
        if not modal.can_begin(context.window):
            self.report({"ERROR"}, reported("Test poses need a 3D viewport: move the mouse over one, and try again"))
            return {"CANCELLED"}
        self._bones = read_bones(context.active_object)
        self._turns = extreme_turns(self._bones.parents)
        self._held = {armature.name: HeldPose(armature) for armature in armatures_of(context.active_object)}
        self._begun = monotonic()
        self._timer: Timer = context.window_manager.event_timer_add(STEP, window=context.window)
        modal.begin(context, self)
        self._play(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: Context, event: Event) -> set[str]:
        """Play, or end; only events of the view pass through, so that nothing else is done meanwhile."""
        if event.type in ENDING and event.value == "PRESS":
            self.cancel(context)
            return {"CANCELLED"}
        if event.type == "TIMER":
            self._play(context)
        return {"PASS_THROUGH"} if event.type in (*OF_VIEW, "TIMER") else {"RUNNING_MODAL"}

    def cancel(self, context: Context) -> None:
        """Restore the pose; Blender calls this when a file is loaded or the window closes."""
        modal.end(self)
        for name, held in self._held.items():
            if name in bpy.data.objects:
                held.restore(bpy.data.objects[name])
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)

    def _play(self, context: Context) -> None:
        """Turn the bones to the pose of the current time."""
        time = (monotonic() - self._begun) / SECONDS
        pose = int(time) % len(self._turns)
        share = np.sin(np.pi * (time % 1)) ** 2
        turns = dict(zip(self._bones.names, share * self._turns[pose], strict=True))
        for name in self._held:
            if name in bpy.data.objects:  # a script may have removed it
                turn_bones(bpy.data.objects[name], turns)
        text = message("Test pose {number} of {count}  |  Click or ESC: end", number=pose + 1, count=len(self._turns))
        context.workspace.status_text_set(translated(text))


def _obstacle(context: Context) -> str:
    """The reason why no poses can be tested; empty if they can."""
    obj = context.active_object
    armatures = armatures_of(obj) if obj is not None and obj.type == "MESH" else []
    if not armatures:
        return "Bind this mesh to a rig first"
    if context.mode != "OBJECT":
        return "Switch to Object Mode first"
    if follow_constraints(armatures):
        return message(
            "Constraints move all deform bones of '{armature}': pose its control bones instead",
            armature=armatures[0].name,
        )
    return ""
