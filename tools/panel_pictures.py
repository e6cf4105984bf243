# SPDX-License-Identifier: GPL-3.0-or-later
r"""Take screenshots of the panels for the guide, in a Blender with a window. In the checkout:

    PYTHONPATH=.:tools:LIBS blender --factory-startup --python-use-system-env --window-geometry 0 0 1600 1000 \
        --python tools/panel_pictures.py -- STORY

STORY is one of those below. LIBS is a folder with the core's dependencies, such as the installed extension's.
ImageMagick's `import` takes the screenshots, from a real or a virtual screen (Xvfb).
"""

import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
from panel_picture_objects import EDGE, VERTICES, bulge, cut_below, garment, pair, show_color_grid, unwrap
from panel_picture_window import DRAWN, KNOWN, Story, begin, call, picture, region, scroll, view

import blender_addon
from blender_addon.demo.character import select_only
from blender_addon.demo.target import remeshed, set_pose
from blender_addon.operators.base import activity
from blender_addon.ui import panels
from zoomout_core.samples.characters import write_samples

# Colors of objects.
SKIN, BLUE, RED = (0.8, 0.62, 0.5, 1), (0.12, 0.25, 0.6, 1), (0.7, 0.12, 0.1, 1)
# A pose for the bound scan, in degrees as the demo's.
RAISED = {
    "upper_arm.L": (0.0, -40.0, 0.0),
    "forearm.L": (0.0, -40.0, 0.0),
    "upper_arm.R": (0.0, 40.0, 0.0),
    "forearm.R": (0.0, 40.0, 0.0),
    "thigh.R": (-40.0, 0.0, 0.0),
    "shin.R": (50.0, 0.0, 0.0),
}


def matching() -> Story:
    """From a new scene to a transfer."""
    hero, scan = pair()
    yield from begin(scan, hero)
    picture("panel_fresh")
    bpy.context.scene.zoomout.source = scan
    region("UI").tag_redraw()
    yield KNOWN
    region("UI").tag_redraw()
    yield DRAWN  # panels below the warning slide down
    picture("panel_warning")
    bpy.context.scene.zoomout.source = None
    yield DRAWN
    call(bpy.ops.zoomout.match, "INVOKE_DEFAULT")
    while activity.running is not None and activity.running.fraction < 0.25:
        yield 0.05
    picture("panel_running")
    while activity.running is not None:
        yield DRAWN
    call(bpy.ops.zoomout.preview, kind="CONFIDENCE")
    yield KNOWN
    picture("panel_heat")
    call(bpy.ops.zoomout.preview, kind="PLACES")
    yield DRAWN
    picture("panel_candidates")
    call(bpy.ops.zoomout.swap_match_sides)
    yield DRAWN
    picture("panel_swapped")
    call(bpy.ops.zoomout.swap_match_sides)
    call(bpy.ops.zoomout.transfer)
    call(bpy.ops.zoomout.preview, kind="CHECKER")
    yield KNOWN  # the range of scrolling is known once it has been drawn
    scroll(bpy.ops.view2d.scroll_down, 19)
    yield DRAWN
    picture("panel_transferred")


def parts() -> Story:
    """A bust, matched with a whole body: the areas of each without a partner."""
    hero, bust = pair()
    bust.name = "Bust"
    cut_below(bust, 0.55)
    yield from begin(bust, hero)
    call(bpy.ops.zoomout.match)
    call(bpy.ops.zoomout.preview, kind="CONFIDENCE")
    yield KNOWN
    picture("panel_parts")


def landmarks() -> Story:
    """Landmarks on both meshes, and a pair of collections."""
    hero, scan = pair(with_landmarks=True)
    scene = bpy.context.scene
    settings = scene.zoomout
    settings.show_landmarks, settings.active_landmark, settings.source = True, 1, hero
    for name, obj in (("Hero parts", hero), ("Scan parts", scan)):
        collection = bpy.data.collections.new(name)
        scene.collection.children.link(collection)
        for former in obj.users_collection:
            former.objects.unlink(obj)
        collection.objects.link(obj)
    settings.source_collection = bpy.data.collections["Hero parts"]
    settings.target_collection = bpy.data.collections["Scan parts"]
    yield from begin(scan, hero)
    picture("panel_landmarks")
    picture("panel_collections", "700x880+900+81")


def binding() -> Story:
    """A scan bound to a character's rig and posed by it, and a copy of it before."""
    hero, scan = pair(with_rig=True)
    rig = hero.parent
    before = scan.copy()
    before.data = scan.data.copy()
    bpy.context.scene.collection.objects.link(before)
    yield from begin(scan, hero)
    call(bpy.ops.zoomout.match)
    call(bpy.ops.zoomout.bind_to_rig)
    bpy.context.scene.zoomout.source = hero
    rig.show_in_front, rig.data.display_type = True, "STICK"
    set_pose(rig, RAISED)
    yield KNOWN
    picture("panel_bind")


def wrapping() -> Story:
    """A scan, and a new object with its topology in the shape of a character."""
    hero, scan = pair()
    bpy.context.scene.zoomout.wrap_result = "OBJECT"
    yield from begin(scan, hero)
    call(bpy.ops.zoomout.match)
    call(bpy.ops.zoomout.wrap)
    hero.hide_set(True)
    bpy.context.scene.zoomout.source = hero
    overlay = view().spaces.active.overlay
    overlay.show_wireframes, overlay.wireframe_opacity = True, 0.4
    yield KNOWN
    picture("panel_wrap")


def dressing() -> Story:
    """A character's clothes on a scan next to it."""
    hero, scan = pair()
    worn = [garment(hero, "Vest", 0.4, 0.55, 0.025), garment(hero, "Socks", 0.0, 0.2, 0.02)]
    for obj, color in zip((hero, scan, *worn), (SKIN, SKIN, BLUE, RED), strict=True):
        obj.color = color
    yield from begin(scan, hero)
    view().spaces.active.shading.color_type = "OBJECT"
    call(bpy.ops.zoomout.match)
    bpy.context.scene.zoomout.source = hero
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in (scan, *worn))
    yield KNOWN
    call(bpy.ops.zoomout.dress)
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj is scan)
    yield KNOWN
    picture("panel_dress")


def symmetry() -> Story:
    """Pairs and sides of a posed character, and the differences between the sides of a sculpted one."""
    hero, scan = pair()
    hero.hide_set(True)
    scan.location.x = 0
    yield from begin(scan)
    call(bpy.ops.zoomout.detect_symmetry)
    call(bpy.ops.zoomout.preview, kind="PAIRS")
    yield KNOWN
    picture("panel_symmetry")
    call(bpy.ops.zoomout.preview, kind="SIDES")
    yield DRAWN
    picture("panel_symmetry_sides")
    scan.hide_set(True)
    sculpt = remeshed(hero, EDGE, VERTICES)
    sculpt.name, sculpt.location.x = "Sculpt", 0
    bulge(sculpt)
    yield from begin(sculpt)
    call(bpy.ops.zoomout.detect_symmetry)
    call(bpy.ops.zoomout.check_symmetry)
    yield KNOWN
    picture("panel_symmetry_check")


def levels() -> Story:
    """Levels of detail of a character, beside each other."""
    hero, scan = pair(with_rig=True)
    bpy.data.objects.remove(scan)
    yield from begin(hero)
    call(bpy.ops.zoomout.make_lods)
    made = sorted(bpy.data.collections["Hero LODs"].objects, key=lambda level: level.name)
    hero.hide_set(True)
    hero.parent.hide_set(True)
    for number, level in enumerate(made):
        level.hide_set(False)
        level.modifiers.clear()
        level.location.x += 1.5 * number
    overlay = view().spaces.active.overlay
    overlay.show_wireframes, overlay.wireframe_opacity = True, 0.4
    yield from begin(made[0])
    scroll(bpy.ops.view2d.scroll_down, 40)
    yield DRAWN
    picture("panel_lods")


def baking() -> Story:
    """A scan with the character's texture in an atlas of its own, linked to it."""
    hero, scan = pair()
    show_color_grid(hero)
    unwrap(scan, "Atlas")
    yield from begin(scan, hero)
    call(bpy.ops.zoomout.match)
    bpy.context.scene.zoomout.bake_uv_map = "Atlas"
    call(bpy.ops.zoomout.bake_textures)
    call(bpy.ops.zoomout.keep_linked)
    view().spaces.active.shading.color_type = "TEXTURE"
    yield KNOWN
    scroll(bpy.ops.view2d.scroll_down, 40)
    yield DRAWN
    picture("panel_bake")


def library() -> Story:
    """The source that fits a scan best, in a library of two characters."""
    hero, scan = pair(with_rig=True)
    with TemporaryDirectory() as folder:
        write_samples(Path(folder) / "characters")
        select_only(hero, hero.parent)
        file = str(Path(folder) / "characters" / "Hero.glb")
        bpy.ops.export_scene.gltf(filepath=file, use_selection=True, export_animations=False)
        for obj in (hero, hero.parent):
            obj.hide_set(True)
        scan.location.x = 0
        bpy.ops.wm.save_as_mainfile(filepath=str(Path(folder) / "scene.blend"))
        bpy.context.scene.zoomout.library_folder = "//characters"
        yield from begin(scan)
        call(bpy.ops.zoomout.find_source)
        yield KNOWN
        region("UI").tag_redraw()
        yield DRAWN  # the panel below slides down
        picture("panel_library")


# Each with the panels to open and to close.
STORIES: dict[str, tuple[Callable[[], Story], set[str], set[str]]] = {
    "matching": (matching, set(), set()),
    "parts": (parts, set(), {"ZOOMOUT_PT_transfer"}),
    "landmarks": (
        landmarks,
        {"ZOOMOUT_PT_landmarks", "ZOOMOUT_PT_collections"},
        {"ZOOMOUT_PT_transfer", "ZOOMOUT_PT_binding"},
    ),
    "binding": (binding, {"ZOOMOUT_PT_binding_check"}, {"ZOOMOUT_PT_match", "ZOOMOUT_PT_transfer"}),
    "wrapping": (wrapping, {"ZOOMOUT_PT_wrap"}, {"ZOOMOUT_PT_match", "ZOOMOUT_PT_transfer"}),
    "dressing": (dressing, {"ZOOMOUT_PT_dress"}, {"ZOOMOUT_PT_match", "ZOOMOUT_PT_transfer"}),
    "levels": (levels, {"ZOOMOUT_PT_lods"}, {"ZOOMOUT_PT_match"}),
    "baking": (baking, {"ZOOMOUT_PT_bake", "ZOOMOUT_PT_live_link"}, {"ZOOMOUT_PT_match"}),
    "library": (library, {"ZOOMOUT_PT_library"}, {"ZOOMOUT_PT_match", "ZOOMOUT_PT_transfer"}),
    "symmetry": (symmetry, {"ZOOMOUT_PT_symmetry"}, {"ZOOMOUT_PT_match", "ZOOMOUT_PT_transfer"}),
}


def main() -> None:
    tell, opened, closed = STORIES[sys.argv[-1]]
    for panel in panels.CLASSES:
        if panel.__name__ in opened | closed:
            panel.bl_options = {"DEFAULT_CLOSED"} if panel.__name__ in closed else set()
    bpy.context.preferences.view.show_splash = False
    blender_addon.register()

    def story() -> Story:
        yield DRAWN  # the window opens
        yield from tell()

    steps = story()

    def go_on() -> float | None:
        try:
            return next(steps)
        except StopIteration:
            call(bpy.ops.wm.quit_blender)
            return None

    bpy.app.timers.register(go_on)


if __name__ == "__main__":
    main()
