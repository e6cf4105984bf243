# SPDX-License-Identifier: GPL-3.0-or-later
"""The menus *Object > ZoomOut Transfer* and *Mesh > ZoomOut Transfer*, whose items can have shortcuts.

Operators of shape keys are in the menu beside Blender's list of shape keys as well.

Blender's search lists each item with its menu path; the extension's full name distinguishes it from *View > Zoom Out*.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import bpy
from bpy.types import Context, Menu, Operator, UILayout

from zoomout_core.messages import as_message, message

from ..operators import live_link, symmetry
from ..operators.bake_textures import ZOOMOUT_OT_bake_textures
from ..operators.bind_to_rig import ZOOMOUT_OT_bind_to_rig
from ..operators.check_motion import ZOOMOUT_OT_check_motion
from ..operators.clear_data import ZOOMOUT_OT_clear_match_data
from ..operators.dress import ZOOMOUT_OT_dress
from ..operators.find_source import ZOOMOUT_OT_find_source
from ..operators.make_lods import ZOOMOUT_OT_make_lods
from ..operators.matching import landmarks, select_faults
from ..operators.matching.bend_match import ZOOMOUT_OT_bend_match
from ..operators.matching.candidates import ZOOMOUT_OT_swap_match_sides, ZOOMOUT_OT_use_candidate
from ..operators.matching.cut_seams import ZOOMOUT_OT_cut_seams
from ..operators.matching.match import ZOOMOUT_OT_match
from ..operators.matching.match_collections import ZOOMOUT_OT_match_collections
from ..operators.matching.place_landmarks import ZOOMOUT_OT_place_landmarks
from ..operators.move_rig import ZOOMOUT_OT_move_rig
from ..operators.play_expressions import ZOOMOUT_OT_play_expressions
from ..operators.play_test_poses import ZOOMOUT_OT_test_poses
from ..operators.preview import ZOOMOUT_OT_clear_preview, ZOOMOUT_OT_preview
from ..operators.rename_shape_keys import ZOOMOUT_OT_rename_shape_keys
from ..operators.transfer import ZOOMOUT_OT_transfer
from ..operators.wrap import ZOOMOUT_OT_wrap
from ..storage import stored_symmetry
from ..translations import translated
from ..viewport.preview import ASYMMETRY, OF_BINDING, OF_MATCH, OF_SYMMETRY, Kind

EXTENSION = "ZoomOut Transfer"


class ZOOMOUT_MT_object(Menu):
    bl_label = EXTENSION

    def draw(self, context: Context) -> None:
        layout = invoking(self.layout)
        work = (
            ZOOMOUT_OT_match,
            ZOOMOUT_OT_match_collections,
            ZOOMOUT_OT_find_source,
            ZOOMOUT_OT_transfer,
            *live_link.CLASSES,
            ZOOMOUT_OT_bake_textures,
            ZOOMOUT_OT_bind_to_rig,
            ZOOMOUT_OT_move_rig,
            ZOOMOUT_OT_test_poses,
            ZOOMOUT_OT_check_motion,
            ZOOMOUT_OT_wrap,
            ZOOMOUT_OT_dress,
            ZOOMOUT_OT_cut_seams,
            ZOOMOUT_OT_make_lods,
            ZOOMOUT_OT_rename_shape_keys,
            ZOOMOUT_OT_play_expressions,
        )
        _operators(layout, work)
        layout.separator()
        layout.operator(ZOOMOUT_OT_swap_match_sides.bl_idname)
        layout.operator(ZOOMOUT_OT_use_candidate.bl_idname, text="Next Candidate")
        _show(layout, OF_MATCH | OF_BINDING)
        layout.operator(ZOOMOUT_OT_clear_preview.bl_idname)
        layout.separator()
        _operators(layout, select_faults.CLASSES)
        layout.separator()
        layout.menu(ZOOMOUT_MT_landmarks.__name__)
        layout.menu(ZOOMOUT_MT_symmetry.__name__)
        layout.separator()
        layout.operator(ZOOMOUT_OT_clear_match_data.bl_idname)
        layout.operator(ZOOMOUT_OT_clear_match_data.bl_idname, text="Clear Match Data of File").whole_file = True


class ZOOMOUT_MT_landmarks(Menu):
    bl_label = "Landmarks"

    def draw(self, context: Context) -> None:
        layout = invoking(self.layout)
        layout.operator(ZOOMOUT_OT_place_landmarks.bl_idname)
        layout.operator(landmarks.ZOOMOUT_OT_face_landmarks.bl_idname)
        for what, name in (("GROUPS", "Landmarks from Vertex Groups"), ("EMPTIES", "Landmarks from Empties")):
            layout.operator(landmarks.ZOOMOUT_OT_import_landmarks.bl_idname, text=name).what = what
        layout.operator(ZOOMOUT_OT_bend_match.bl_idname)
        layout.operator(landmarks.ZOOMOUT_OT_confirm_landmarks.bl_idname)
        layout.operator(landmarks.ZOOMOUT_OT_remove_landmark.bl_idname)
        layout.operator(landmarks.ZOOMOUT_OT_clear_landmarks.bl_idname)


class ZOOMOUT_MT_symmetry(Menu):
    bl_label = "Symmetry"

    def draw(self, context: Context) -> None:
        layout = invoking(self.layout)
        _show(layout, {name: kind for name, kind in OF_SYMMETRY.items() if name != ASYMMETRY})
        for operator in symmetry.CLASSES:
            if operator is not symmetry.ZOOMOUT_OT_choose_symmetry:
                layout.operator(operator.bl_idname)
        obj = context.active_object
        stored = stored_symmetry.description(obj.data) if obj and obj.type == "MESH" else None
        if stored is None:
            return
        layout.separator()
        for number, candidate in enumerate(stored["candidates"]):
            text = translated(message("Use {candidate}", candidate=stored_symmetry.summary(candidate)))
            layout.operator(symmetry.ZOOMOUT_OT_choose_symmetry.bl_idname, text=text).number = number


class ZOOMOUT_MT_mesh(Menu):
    bl_label = EXTENSION

    def draw(self, context: Context) -> None:
        layout = invoking(self.layout)
        layout.operator(landmarks.ZOOMOUT_OT_landmarks_from_selected.bl_idname)
        layout.separator()
        _operators(layout, select_faults.CLASSES)


# In the order of registration.
CLASSES = (ZOOMOUT_MT_landmarks, ZOOMOUT_MT_symmetry, ZOOMOUT_MT_object, ZOOMOUT_MT_mesh)


def register() -> None:
    """Add the menus to Blender's."""
    bpy.types.VIEW3D_MT_object.append(_draw_in_object)
    bpy.types.VIEW3D_MT_edit_mesh.append(_draw_in_mesh)
    bpy.types.MESH_MT_shape_key_context_menu.append(_draw_in_shape_keys)


def unregister() -> None:
    """Remove the menus from Blender's."""
    bpy.types.VIEW3D_MT_object.remove(_draw_in_object)
    bpy.types.VIEW3D_MT_edit_mesh.remove(_draw_in_mesh)
    bpy.types.MESH_MT_shape_key_context_menu.remove(_draw_in_shape_keys)


def invoking(layout: UILayout) -> UILayout:
    """Make a layout invoke its operators in any menu, so that they show progress and can be cancelled."""
    layout.operator_context = "INVOKE_DEFAULT"
    return layout


def _draw_in_object(menu: Menu, context: Context) -> None:
    menu.layout.separator()
    menu.layout.menu(ZOOMOUT_MT_object.__name__)


def _draw_in_mesh(menu: Menu, context: Context) -> None:
    menu.layout.separator()
    menu.layout.menu(ZOOMOUT_MT_mesh.__name__)


def _draw_in_shape_keys(menu: Menu, context: Context) -> None:
    menu.layout.separator()
    _operators(invoking(menu.layout), (ZOOMOUT_OT_rename_shape_keys, ZOOMOUT_OT_play_expressions))


def _operators(layout: UILayout, classes: Iterable[type[Operator]]) -> None:
    """Draw an item for each operator."""
    for operator in classes:
        layout.operator(operator.bl_idname)


def _show(layout: UILayout, kinds: Mapping[str, Kind]) -> None:
    """Draw an item for each kind of preview."""
    for name, kind in kinds.items():
        layout.operator(
            ZOOMOUT_OT_preview.bl_idname, text=translated(message("Show {what}", what=as_message(kind.label)))
        ).kind = name
