# SPDX-License-Identifier: GPL-3.0-or-later
"""Place landmarks by clicking on the source and the targets in the 3D view, and move them by dragging."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import bpy
from bpy.types import Area, Context, Event, Object, Operator, Region
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d
from mathutils import Vector

from zoomout_core.messages import message

from ... import services
from ...mesh_data import SurfacePoint, raycast_surface_point
from ...scene.landmarks import (
    confirm_landmarks,
    next_number,
    obstacle,
    remove_landmark,
    set_landmark,
    surface_points_on,
)
from ...scene.selection import participants
from ...translations import reported, translated
from ...viewport.landmark_dots import dot_at, dots
from ..base import modes, running_operators
from ..base.availability import is_available


class Pointed(NamedTuple):
    """The place of the mouse in a 3D view."""

    area: Area
    region: Region
    place: Vector


class ZOOMOUT_OT_place_landmarks(Operator):
    bl_idname = "zoomout.place_landmarks"
    bl_label = "Place Landmarks"
    bl_description = (
        "Click corresponding points on the source and the target in turn; drag a dot to move it. If the two are "
        "matched, the partner is proposed: drag it, or click it to confirm. Backspace removes the last landmark, ESC "
        "or the right mouse button finishes"
    )
    bl_options = {"REGISTER"}  # each click is a separate undo step

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether there are objects to click on."""
        return is_available(cls, obstacle(context))

    def invoke(self, context: Context, event: Event) -> set[str]:
        """Start to follow the mouse."""
        if not running_operators.can_begin(context.window):
            text = "Landmarks are placed with the mouse: move it over a 3D viewport, and try again"
            self.report({"ERROR"}, reported(text))
            return {"CANCELLED"}
        self._left = modes.leave(context, self)
        self._objects = [obj.name for obj in _clickable(context)]
        self._dragged: tuple[int, str] | None = None
        self._placed: list[tuple[int, str]] = []
        context.scene.zoomout.show_landmarks = True
        context.window.cursor_modal_set("CROSSHAIR")
        running_operators.begin(context, self)
        self._show(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: Context, event: Event) -> set[str]:
        """Place or drag landmarks, or end; other events pass through to the view."""
        if event.type in ("ESC", "RIGHTMOUSE", "RET") and event.value == "PRESS":
            self._end(context)
            result = {"FINISHED"} if self._placed else {"CANCELLED"}
            return modes.restore_after(context, self._left, self, result)
        if event.type == "BACK_SPACE" and event.value == "PRESS" and self._placed:
            return self._take_back(context)
        pointed = _place_of_mouse(context, event)
        if event.type == "LEFTMOUSE" and event.value == "RELEASE" and self._dragged:
            return self._drop(context)
        if event.type == "MOUSEMOVE" and self._dragged and pointed:
            return self._drag(context, pointed)
        if event.type == "LEFTMOUSE" and event.value in ("PRESS", "DOUBLE_CLICK") and pointed and not event.alt:
            return self._press(context, pointed)
        return {"PASS_THROUGH"}

    def cancel(self, context: Context) -> None:
        """Clean up; Blender calls this when a file is loaded or the window closes."""
        self._end(context)
        modes.restore_later(context, self._left)

    def _end(self, context: Context) -> None:
        running_operators.end(self)
        context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)

    def _press(self, context: Context, pointed: Pointed) -> set[str]:
        """Start to drag the dot under the mouse, or place a landmark."""
        view = pointed.area.spaces.active
        shown = dots(context, pointed.region, view.region_3d, view)
        dot = dot_at(shown, pointed.place, context.preferences.system.ui_scale)
        if dot is not None:
            self._dragged = dot.number, dot.obj.name
            return {"RUNNING_MODAL"}
        objects = self._present(context)
        hit = _first_hit(context, objects, pointed)
        if hit is None:
            self.report(
                {"INFO"}, reported(message("There is no surface here: click on {names}", names=_names(objects)))
            )
            return {"RUNNING_MODAL"}
        obj, place = hit
        number = next_number(context.scene, obj, objects)
        set_landmark(context.scene, obj, place, number)
        self._placed.append((number, obj.name))
        services.matching.propose_partners.propose_partners(context, objects, [number])
        bpy.ops.ed.undo_push(message=translated(message("Place Landmark {number}", number=number)))
        return self._show(context)

    def _drag(self, context: Context, pointed: Pointed) -> set[str]:
        number, name = self._dragged
        hit = _first_hit(context, [obj for obj in self._present(context) if obj.name == name], pointed)
        if hit is not None:
            set_landmark(context.scene, *hit, number)
        return self._show(context)

    def _drop(self, context: Context) -> set[str]:
        """Confirm the dragged landmark, and update its proposed partners."""
        number, name = self._dragged
        self._dragged = None
        objects = self._present(context)
        confirm_landmarks(context.scene, [obj for obj in objects if obj.name == name], [number])
        services.matching.propose_partners.propose_partners(context, objects, [number])
        bpy.ops.ed.undo_push(message=translated(message("Move Landmark {number}", number=number)))
        return self._show(context)

    def _take_back(self, context: Context) -> set[str]:
        number, name = self._placed.pop()
        remove_landmark(context.scene, number, [obj for obj in self._present(context) if obj.name == name])
        bpy.ops.ed.undo_push(message=translated(message("Remove Landmark {number}", number=number)))
        return self._show(context)

    def _present(self, context: Context) -> list[Object]:
        """The objects to click on that still exist."""
        found = (context.scene.objects.get(name) for name in self._objects)
        return [obj for obj in found if obj is not None]

    def _show(self, context: Context) -> set[str]:
        """Show the next step in the status bar, and redraw the dots."""
        context.workspace.status_text_set(translated(_advice(context, self._present(context))))
        for area in context.window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
        return {"RUNNING_MODAL"}


def _clickable(context: Context) -> list[Object]:
    source, targets = participants(context)
    return [source, *targets]


def _advice(context: Context, objects: list[Object]) -> str:
    """The next object to click on, for the status bar."""
    waiting = [
        (number, obj)
        for obj in objects
        for number in [next_number(context.scene, obj, objects)]
        if any(number in surface_points_on(context.scene, other) for other in objects)
    ]
    if waiting:
        number, obj = min(waiting, key=lambda entry: entry[0])
        proposed = number in surface_points_on(context.scene, obj, proposed=True)
        click = (
            "Landmark {number}: click on '{name}', or drag or click its pale dot"
            if proposed
            else "Landmark {number}: click on '{name}'"
        )
        task = message(click, number=number, name=obj.name)
    else:
        number = next_number(context.scene, objects[0], objects) if objects else 1
        task = message("Landmark {number}: click on {names}", number=number, names=_names(objects))
    return message("{task}  |  Drag a dot to move it  |  Backspace: undo  |  ESC or right click: finish", task=task)


def _names(objects: list[Object]) -> str:
    return ", ".join(f"'{obj.name}'" for obj in objects)


def _place_of_mouse(context: Context, event: Event) -> Pointed | None:
    """The place of the mouse in a 3D view, or None elsewhere, such as over a sidebar."""
    for area in context.window.screen.areas if context.window else ():
        if area.type == "VIEW_3D" and _inside(area, event):
            found = [region for region in area.regions if region.width > 1 and _inside(region, event)]
            if [region.type for region in found] == ["WINDOW"]:
                (region,) = found
                return Pointed(area, region, Vector((event.mouse_x - region.x, event.mouse_y - region.y)))
    return None


def _inside(box: Area | Region, event: Event) -> bool:
    return 0 <= event.mouse_x - box.x < box.width and 0 <= event.mouse_y - box.y < box.height


def _first_hit(context: Context, objects: list[Object], pointed: Pointed) -> tuple[Object, SurfacePoint] | None:
    """The object nearest to the viewer at a place in a view, and the surface point there."""
    view = pointed.area.spaces.active
    origin = region_2d_to_origin_3d(pointed.region, view.region_3d, pointed.place)
    direction = region_2d_to_vector_3d(pointed.region, view.region_3d, pointed.place)
    depsgraph = context.evaluated_depsgraph_get()

    def hits() -> Iterator[tuple[float, Object, SurfacePoint]]:
        for obj in objects:
            if obj.visible_get() and (view.local_view is None or obj.local_view_get(view)):
                hit = raycast_surface_point(obj, origin, direction, depsgraph)
                if hit is not None:
                    yield hit[1], obj, hit[0]

    nearest = min(hits(), key=lambda hit: hit[0], default=None)
    return None if nearest is None else nearest[1:]
