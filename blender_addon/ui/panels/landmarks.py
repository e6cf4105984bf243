# SPDX-License-Identifier: GPL-3.0-or-later
"""Subpanel of the match: the list of landmarks."""

from __future__ import annotations

from typing import Any

from bpy.types import Context, Panel, UILayout, UIList

import zoomout_core as zo
from zoomout_core.messages import message

from ...operators.matching.bend_match import ZOOMOUT_OT_bend_match
from ...operators.matching.landmarks import (
    ZOOMOUT_OT_clear_landmarks,
    ZOOMOUT_OT_confirm_landmarks,
    ZOOMOUT_OT_face_landmarks,
    ZOOMOUT_OT_import_landmarks,
    ZOOMOUT_OT_landmarks_from_selected,
    ZOOMOUT_OT_remove_landmark,
)
from ...operators.matching.place_landmarks import ZOOMOUT_OT_place_landmarks
from ...properties.landmarks import LandmarkSettings, ZOOMOUT_PG_landmark
from ...scene.landmarks import surface_points_on
from ...scene.selection import participants
from .match import ZOOMOUT_PT_match
from .sidebar import SidebarPanel, sentences


class ZOOMOUT_UL_landmarks(UIList):
    """Landmarks by number, with icons for whether the source and the target have it, or it is proposed."""

    def draw_item(
        self,
        context: Context,
        layout: UILayout,
        settings: LandmarkSettings,
        landmark: ZOOMOUT_PG_landmark,
        icon: int,
        active_settings: LandmarkSettings,
        active_property: str,
        *_: Any,
    ) -> None:
        row = layout.row(align=True)
        number = row.row()
        number.ui_units_x = 1.2
        number.label(text=str(landmark.number))
        row.prop(landmark, "name", text="", emboss=False)
        marks = {stored.object: "QUESTION" if stored.proposed else "CHECKMARK" for stored in landmark.places}
        for obj in _pair(context):
            row.label(text="", icon=marks.get(obj, "REMOVE"))


class ZOOMOUT_PT_landmarks(SidebarPanel, Panel):
    bl_label = "Landmarks"
    bl_parent_id = ZOOMOUT_PT_match.__name__
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 10

    def draw(self, context: Context) -> None:
        layout, settings = self.layout, context.scene.zoomout
        if context.mode == "EDIT_MESH":
            layout.operator(
                ZOOMOUT_OT_landmarks_from_selected.bl_idname, text="From Selected Vertices", icon="VERTEXSEL"
            )
        else:
            layout.operator(ZOOMOUT_OT_place_landmarks.bl_idname, text="Place", icon="CURSOR")
        _draw_list(layout, settings)
        _draw_count(context, layout)
        layout.operator(ZOOMOUT_OT_bend_match.bl_idname, text="Bend Match", icon="MOD_SIMPLEDEFORM")
        layout.operator(ZOOMOUT_OT_face_landmarks.bl_idname, icon="USER")
        row = layout.row(align=True)
        row.label(text="Import")
        row.operator(ZOOMOUT_OT_import_landmarks.bl_idname, text="Groups").what = "GROUPS"
        row.operator(ZOOMOUT_OT_import_landmarks.bl_idname, text="Empties").what = "EMPTIES"
        layout.prop(settings, "exact_landmarks")


def _draw_list(layout: UILayout, settings: Any) -> None:
    """The list of landmarks, and buttons beside it."""
    row = layout.row()
    row.template_list(ZOOMOUT_UL_landmarks.__name__, "", settings, "landmarks", settings, "active_landmark", rows=4)
    column = row.column(align=True)
    column.operator(ZOOMOUT_OT_confirm_landmarks.bl_idname, text="", icon="CHECKMARK")
    column.operator(ZOOMOUT_OT_remove_landmark.bl_idname, text="", icon="REMOVE")
    column.operator(ZOOMOUT_OT_clear_landmarks.bl_idname, text="", icon="X")
    column.separator()
    column.prop(settings, "show_landmarks", text="", icon="HIDE_OFF" if settings.show_landmarks else "HIDE_ON")


def _draw_count(context: Context, layout: UILayout) -> None:
    """The number of landmarks that both objects have, once both are selected."""
    pair = _pair(context)
    if len(pair) < 2:
        return
    on = [set(surface_points_on(context.scene, obj)) for obj in pair]
    names = {"source": pair[0].name, "target": pair[1].name}
    text = message(
        "{landmarks} on both; the marks are for '{source}' and '{target}'", landmarks=len(on[0] & on[1]), **names
    )
    sentences(context, layout, [text])


def _pair(context: Context) -> list[Any]:
    """The source and the first target, if any."""
    try:
        source, targets = participants(context)
    except zo.MeshError:  # the greyed-out buttons show the reason
        return []
    return [source, *targets[:1]]
