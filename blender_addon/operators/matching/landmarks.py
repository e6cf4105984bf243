# SPDX-License-Identifier: GPL-3.0-or-later
"""Set landmarks from selected or named places on objects, confirm and remove them."""

from __future__ import annotations

import bmesh
from bpy.types import Context, Object, Operator

import zoomout_core as zo
from zoomout_core.messages import Message, message

from ... import services
from ...mesh_data import surface_point_of_vertex
from ...properties.landmarks import ImportOptions
from ...scene.landmarks import (
    confirm_landmarks,
    landmarks_in_words,
    next_number,
    obstacle,
    remove_landmark,
    remove_landmarks_on,
    set_landmark,
)
from ...scene.selection import participants
from ...translations import reported
from ..base import modes
from ..base.availability import is_available

# A selection of more vertices is probably not meant to set landmarks one by one.
MAX_SELECTED = 64


class LandmarkOperator(Operator):
    """The base of operators that change the landmarks of the source and the targets by `change`, and report it."""

    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether there are objects for landmarks."""
        return is_available(cls, obstacle(context))

    def change(self, context: Context, objects: list[Object]) -> str:
        """Change the landmarks on the source, which is the first object, and the targets; returns a report."""
        raise NotImplementedError

    def execute(self, context: Context) -> set[str]:
        """Change the landmarks in Object Mode, and report."""
        left = modes.leave(context, self)
        return modes.restore_after(context, left, self, self._finish_change(context))

    def _finish_change(self, context: Context) -> set[str]:
        try:
            source, targets = participants(context)
            self.report({"INFO"}, reported(self.change(context, [source, *targets])))
        except zo.MeshError as error:
            self.report({"ERROR"}, reported(str(error)))
            return {"CANCELLED"}
        return {"FINISHED"}


class ZOOMOUT_OT_landmarks_from_selected(LandmarkOperator):
    bl_idname = "zoomout.landmarks_from_selected"
    bl_label = "Landmarks from Selected Vertices"
    bl_description = (
        "Place a landmark on each selected vertex of the source and the target, in the order of selection: the first "
        "vertex of one corresponds to the first of the other"
    )

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether vertices of objects for landmarks can be selected."""
        is_editing = context.mode == "EDIT_MESH"
        return is_available(cls, "" if is_editing else "Switch to Edit Mode") and super().poll(context)

    def execute(self, context: Context) -> set[str]:
        """Read the selection before leaving Edit Mode."""
        self._selected = {obj.name: _selected_vertices(obj) for obj in context.objects_in_mode}
        return super().execute(context)

    def change(self, context: Context, objects: list[Object]) -> str:
        """Set landmarks at the selected vertices."""
        selected = {obj: self._selected.get(obj.name, []) for obj in objects}
        count = sum(map(len, selected.values()))
        if not count:
            raise zo.MeshError("No vertex of the source or of a target is selected: select at least one.")
        if count > MAX_SELECTED:
            raise zo.MeshError(
                "{count:,} vertices are selected, more than {most}: select fewer.", count=count, most=MAX_SELECTED
            )
        depsgraph = context.evaluated_depsgraph_get()
        places = {obj: [surface_point_of_vertex(obj, vertex, depsgraph) for vertex in selected[obj]] for obj in objects}
        numbers = set()
        for obj in objects:
            for place in places[obj]:
                number = next_number(context.scene, obj, objects)
                set_landmark(context.scene, obj, place, number)
                numbers.add(number)
        return _describe_placed(count, services.matching.propose_partners.propose_partners(context, objects, numbers))


class ZOOMOUT_OT_face_landmarks(LandmarkOperator):
    bl_idname = "zoomout.face_landmarks"
    bl_label = "Face Landmarks"
    bl_description = (
        "Place twelve landmarks on a head: corners of mouth and eyes, lips, nose, chin and ears. Their places on the "
        "source come from its keys that blink and open the mouth, those on the target are proposed by the match. Drag "
        "or confirm them, then bend the match"
    )

    def change(self, context: Context, objects: list[Object]) -> str:
        """Set the landmarks of a face."""
        return _describe_placed(*services.face_landmarks.set_face_landmarks(context, objects))


class ZOOMOUT_OT_import_landmarks(ImportOptions, LandmarkOperator):
    bl_idname = "zoomout.import_landmarks"
    bl_label = "Import Landmarks"
    bl_description = "Place landmarks at vertex groups or empties that have the same name on the source and the target"

    def change(self, context: Context, objects: list[Object]) -> str:
        """Import landmarks."""
        count = services.matching.landmark_import.import_landmarks(context, objects, self.what)
        return message("Imported {landmarks}", landmarks=landmarks_in_words(count))


class ZOOMOUT_OT_confirm_landmarks(LandmarkOperator):
    bl_idname = "zoomout.confirm_landmarks"
    bl_label = "Confirm Proposed Landmarks"
    bl_description = "Accept all landmark positions that the match proposed, drawn as pale dots"

    def change(self, context: Context, objects: list[Object]) -> str:
        """Confirm proposed landmarks."""
        return message("Confirmed {landmarks}", landmarks=landmarks_in_words(confirm_landmarks(context.scene, objects)))


class ZOOMOUT_OT_remove_landmark(LandmarkOperator):
    bl_idname = "zoomout.remove_landmark"
    bl_label = "Remove Landmark"
    bl_description = "Remove the active landmark of the list from the source and the targets"

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether a landmark is chosen."""
        settings = context.scene.zoomout
        is_chosen = settings.active_landmark < len(settings.landmarks)
        return is_available(cls, "" if is_chosen else "Choose a landmark in the list") and super().poll(context)

    def change(self, context: Context, objects: list[Object]) -> str:
        """Remove the chosen landmark."""
        settings = context.scene.zoomout
        number = settings.landmarks[settings.active_landmark].number
        remove_landmark(context.scene, number, objects)
        return message("Removed landmark {number}", number=number)


class ZOOMOUT_OT_clear_landmarks(LandmarkOperator):
    bl_idname = "zoomout.clear_landmarks"
    bl_label = "Clear Landmarks"
    bl_description = "Remove all landmarks from the source and the targets"

    def change(self, context: Context, objects: list[Object]) -> str:
        """Remove the landmarks on the objects."""
        return message("Removed {landmarks}", landmarks=landmarks_in_words(remove_landmarks_on(context.scene, objects)))


def _describe_placed(count: int, proposed: int) -> Message:
    """A report of the landmarks that were placed, and of the partners that were proposed."""
    placed = message("Placed {landmarks}", landmarks=landmarks_in_words(count))
    if not proposed:
        return placed
    proposals = "{placed}, and proposed 1 partner" if proposed == 1 else "{placed}, and proposed {count} partners"
    return message(proposals, placed=placed, count=proposed)


def _selected_vertices(obj: Object) -> list[int]:
    """The selected vertices of a mesh in Edit Mode, first those in the selection history, in its order."""
    editable = bmesh.from_edit_mesh(obj.data)
    editable.verts.index_update()
    history = [item.index for item in editable.select_history if isinstance(item, bmesh.types.BMVert)]
    return list(dict.fromkeys([*history, *(vertex.index for vertex in editable.verts if vertex.select)]))
