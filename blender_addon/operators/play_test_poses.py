# SPDX-License-Identifier: GPL-3.0-or-later
"""Play the poses of *Bind to Rig*'s check in the viewport, and restore the pose at the end."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.types import Context

from zoomout_core.messages import message
from zoomout_core.transfer import rigging

from ..mesh_data import HeldPose, armatures_of, follow_constraints, read_bones, turn_bones
from .base.play_operator import PlayOperator


class ZOOMOUT_OT_test_poses(PlayOperator):
    bl_idname = "zoomout.test_poses"
    bl_label = "Test Poses"
    bl_description = (
        "Rotate the bones of the active mesh's armature to extremes, as Bind to Rig does to test weights. Click or "
        "press ESC to stop and restore the pose"
    )
    bl_options = {"REGISTER"}

    @classmethod
    def obstacle(cls, context: Context) -> str:
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

    def start(self, context: Context) -> int:
        self._bones = read_bones(context.active_object)
        self._turns = rigging.poses.extreme_turns(self._bones.parents)
        self._held = {armature.name: HeldPose(armature) for armature in armatures_of(context.active_object)}
        return len(self._turns)

    def show(self, context: Context, part: int, share: float) -> str:
        strength = np.sin(np.pi * share) ** 2
        turns = dict(zip(self._bones.names, strength * self._turns[part], strict=True))
        for name in self._held:
            if name in bpy.data.objects:
                turn_bones(bpy.data.objects[name], turns)
        return message("Test pose {number} of {count}  |  Click or ESC: end", number=part + 1, count=len(self._turns))

    def restore(self, context: Context) -> None:
        for name, held in self._held.items():
            if name in bpy.data.objects:
                held.restore(bpy.data.objects[name])
