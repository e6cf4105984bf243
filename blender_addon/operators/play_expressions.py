# SPDX-License-Identifier: GPL-3.0-or-later
"""Play the shape keys of the active mesh and its source in the viewport, and restore their values at the end."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.types import Context

from zoomout_core.messages import message

from .. import mesh_data, services
from ..mesh_data import HeldKeys
from ..viewport import overlay, preview
from .base.play_operator import PlayOperator

# The strength of a key over the share of its time: half, full, and back.
TIMES, STRENGTHS = (0, 0.12, 0.4, 0.52, 0.88, 1), (0, 0.5, 0.5, 1, 1, 0)


class ZOOMOUT_OT_play_expressions(PlayOperator):
    bl_idname = "zoomout.play_expressions"
    bl_label = "Play Expressions"
    bl_description = (
        "Play the shape keys of the active mesh, and of the source that it was matched with, at half and at full "
        "strength. Red: edges that stretch far more than on the source, and faces that intersect others although "
        "they do not at rest or on the source, such as lips and teeth. The arrow keys go to other keys; a click or "
        "ESC ends it "
        "and restores the values"
    )
    bl_options = {"REGISTER"}
    seconds = 2.0

    @classmethod
    def obstacle(cls, context: Context) -> str:
        obj = context.active_object
        if obj is None or obj.type != "MESH" or not mesh_data.names_of_keys(obj):
            return "Add or transfer shape keys first"
        if context.mode != "OBJECT":
            return "Switch to Object Mode first"
        return "" if obj.data.shape_keys.use_relative else "Turn on Relative in the shape keys first"

    def start(self, context: Context) -> int:
        target = context.active_object
        self._keys = mesh_data.names_of_keys(target)
        self._found: services.expressions.Faults = services.expressions.faults_of_keys(context, target)
        names = [target.name, *self._found.sources]
        self._held = {name: HeldKeys(bpy.data.objects[name]) for name in names}
        self._uid, self._colored = target.session_uid, ""
        preview.clear()
        return len(self._keys)

    def show(self, context: Context, part: int, share: float) -> str:
        name = self._keys[part]
        strength = float(np.interp(share, TIMES, STRENGTHS))
        for obj_name, held in self._held.items():
            if obj_name in bpy.data.objects:
                held.play(bpy.data.objects[obj_name], name, strength)
        if name != self._colored:
            self._color(name)
        return message(
            "{key}, {number} of {count}, {strength:.0%}  |  Arrow keys: other keys  |  Click or ESC: end",
            key=name,
            number=part + 1,
            count=len(self._keys),
            strength=strength,
        )

    def restore(self, context: Context) -> None:
        overlay.clear()
        for name, held in self._held.items():
            if name in bpy.data.objects:
                held.restore(bpy.data.objects[name])

    def _color(self, name: str) -> None:
        """Colour the faults of a key, and nothing for a key without any."""
        self._colored = name
        colors = self._found.colors(name)
        if colors is None:
            overlay.clear()
        else:
            overlay.show([overlay.Overlay(self._uid, colors, self._found.content)])
