# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's window in the pictures of panels: its view and sidebar, and screenshots of it."""

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
from bpy.types import Area, Object
from mathutils import Vector

from blender_addon.ui.panels.match import ZOOMOUT_PT_match

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
# The part of a window of 1600 x 1000 pixels that is kept: its right side, without the bars above and below.
SEEN = "1270x880+330+81"
# Seconds until changes are drawn, and until facts about meshes have been read between events.
DRAWN, KNOWN = 2.0, 6.0

# Steps of a series of pictures; each yields the seconds until the next one.
Story = Iterator[float]


def begin(target: Object, *others: Object) -> Story:
    """Select objects, the first as the active one, and view them from the front, left of the sidebar."""
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in (target, *others))
    bpy.context.view_layer.objects.active = target
    if len(bpy.context.window_manager.windows[0].screen.areas) > 1:
        call(bpy.ops.screen.screen_full_area)
        yield DRAWN
    space = view().spaces.active
    for name in ("floor", "axis_x", "axis_y", "cursor", "object_origins", "relationship_lines"):
        setattr(space.overlay, f"show_{name}", False)
    space.show_region_toolbar, space.show_region_ui = False, True
    yield DRAWN  # a tab can be chosen once the sidebar has been drawn
    region("UI").active_panel_category = ZOOMOUT_PT_match.bl_category
    call(bpy.ops.view3d.view_all)
    space.region_3d.view_perspective = "ORTHO"
    space.region_3d.view_rotation = Vector((0.1, -1, 0.15)).to_track_quat("Z", "Y")
    space.region_3d.view_distance *= 1.1
    space.region_3d.view_location += Vector((0.4, 0, 0))
    yield KNOWN


def view() -> Area:
    return next(area for area in bpy.context.window_manager.windows[0].screen.areas if area.type == "VIEW_3D")


def region(kind: str) -> Any:
    return next(region for region in view().regions if region.type == kind)


def call(operator: Callable[..., Any], *context: str, kind: str | None = None) -> None:
    """Call an operator as if in the 3D view."""
    options = {"kind": kind} if kind else {}
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=view(), region=region("WINDOW")):
        operator(*context, **options)


def scroll(operator: Callable[..., Any], times: int) -> None:
    """Scroll the sidebar."""
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=view(), region=region("UI")):
        for _ in range(times):
            operator()


def picture(name: str, seen: str = SEEN) -> None:
    """Take a screenshot of the window."""
    for each in view().regions:
        each.tag_redraw()
    bpy.ops.wm.redraw_timer(type="DRAW_WIN_SWAP", iterations=2)
    options = ["-window", "root", "-crop", seen, "+repage", "+dither", "-colors", "256"]
    subprocess.run(["import", *options, f"PNG8:{IMAGES / name}.png"], check=True)
