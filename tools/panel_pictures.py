# SPDX-License-Identifier: GPL-3.0-or-later
r"""Take screenshots of the panels for the guide, in a Blender with a window. In the checkout:

    PYTHONPATH=.:LIBS blender --factory-startup --python-use-system-env --window-geometry 0 0 1600 1000 \
        --python tools/panel_pictures.py -- STORY

STORY is one of those below. LIBS is a folder with the core's dependencies, such as the installed extension's.
ImageMagick's `import` takes the screenshots, from a real or a virtual screen (Xvfb).
"""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import bmesh
import bpy
import numpy as np
from bpy.types import Area, Object
from mathutils import Vector

import blender_addon
from blender_addon.demo.character import build_character, select_only
from blender_addon.demo.target import clear_pose, posed_copy, remeshed, set_pose
from blender_addon.mesh_data import nearest_surface_point
from blender_addon.operators.base import activity
from blender_addon.scene.landmarks import set_landmark
from blender_addon.ui import panels
from blender_addon.ui.panels.match import ZOOMOUT_PT_match
from zoomout_core.samples.characters import write_samples

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
# The part of a window of 1600 x 1000 pixels that is kept: its right side, without the bars above and below.
SEEN = "1270x880+330+81"
# Resolution of the character in metres, and of its scan in vertices.
EDGE, VERTICES = 0.024, 6000
# Seconds until changes are drawn, and until facts about meshes have been read between events.
DRAWN, KNOWN = 2.0, 6.0
# Colors of objects.
SKIN, BLUE, RED = (0.8, 0.62, 0.5, 1), (0.12, 0.25, 0.6, 1), (0.7, 0.12, 0.1, 1)
# Landmarks: their bones and names. The last is on one side only.
LANDMARKS = {
    "hand.L": "Left hand",
    "ear.R": "Right ear",
    "foot.L": "Left foot",
    "ear.L": "Left ear",
    "hand.R": "Right hand",
}

# A pose for the bound scan, in degrees as the demo's.
RAISED = {
    "upper_arm.L": (0.0, -40.0, 0.0),
    "forearm.L": (0.0, -40.0, 0.0),
    "upper_arm.R": (0.0, 40.0, 0.0),
    "forearm.R": (0.0, 40.0, 0.0),
    "thigh.R": (-40.0, 0.0, 0.0),
    "shin.R": (50.0, 0.0, 0.0),
}

Story = Iterator[float]


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


def pair(with_landmarks: bool = False, with_rig: bool = False) -> tuple[Object, Object]:
    """The character, and next to it a posed scan of it with another topology and without data.

    Args:
        with_landmarks: whether both have landmarks.
        with_rig: whether the character stays bound to its armature.
    """
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    hero, armature = build_character(EDGE)
    before = tips(armature)
    set_pose(armature)
    posed, after = posed_copy(hero), tips(armature)
    scan = remeshed(posed, EDGE, VERTICES)
    bpy.data.objects.remove(posed)
    clear_pose(armature)
    hero.name, scan.name = "Hero", "Scan"
    if not with_rig:
        hero.modifiers.clear()
        hero.parent = None
        bpy.data.objects.remove(armature)
    collapse_crowded_edges(hero)
    for obj in (hero, scan):
        obj.data.shade_smooth()
    bpy.context.view_layer.update()
    if with_landmarks:
        set_landmarks(hero, before, len(LANDMARKS))
        set_landmarks(scan, after, len(LANDMARKS) - 1)
    (hero.parent or hero).location.x -= 0.8
    scan.location.x += 0.8
    bpy.context.view_layer.update()
    return hero, scan


def tips(armature: Object) -> list[Vector]:
    """Points near the ends of the bones of landmarks, in world space."""
    bones = [armature.pose.bones[name] for name in LANDMARKS]
    return [armature.matrix_world @ bone.head.lerp(bone.tail, 0.7) for bone in bones]


def set_landmarks(obj: Object, points: list[Vector], count: int) -> None:
    """Set the first landmarks of an object at its closest points to some positions."""
    depsgraph, inverse = bpy.context.evaluated_depsgraph_get(), obj.matrix_world.inverted()
    for number, (point, name) in enumerate(zip(points[:count], LANDMARKS.values(), strict=False), start=1):
        place = nearest_surface_point(obj, inverse @ point, 1, depsgraph)
        assert place is not None  # the character has faces
        set_landmark(bpy.context.scene, obj, place, number, name)


def collapse_crowded_edges(obj: Object) -> None:
    """Collapse edges with more than two faces, which the Skin modifier creates."""
    mesh = bmesh.new()
    mesh.from_mesh(obj.data)
    while crowded := [edge for edge in mesh.edges if len(edge.link_faces) > 2]:
        bmesh.ops.collapse(mesh, edges=crowded)
    mesh.to_mesh(obj.data)
    mesh.free()


def garment(body: Object, name: str, low: float, high: float, off: float) -> Object:
    """A garment from the part of a body between two heights, offset from its skin, without hands and tail."""
    worn = body.copy()
    worn.data, worn.name = body.data.copy(), name
    bpy.context.scene.collection.objects.link(worn)
    mesh = bmesh.new()
    mesh.from_mesh(worn.data)
    mesh.normal_update()
    heights = [vertex.co.z for vertex in mesh.verts]
    bottom, height = min(heights), max(heights) - min(heights)
    left = [
        vertex
        for vertex in mesh.verts
        if not low <= (vertex.co.z - bottom) / height <= high
        or abs(vertex.co.x) > 0.25 * height
        or vertex.co.y > 0.07 * height
    ]
    for vertex in mesh.verts:
        vertex.co += off * vertex.normal
    bmesh.ops.delete(mesh, geom=left, context="VERTS")
    mesh.to_mesh(worn.data)
    mesh.free()
    thick = worn.modifiers.new("Solidify", "SOLIDIFY")
    thick.thickness = 0.6 * off
    return worn


def show_color_grid(obj: Object) -> None:
    """Show one of Blender's test images on an object, by its UV map."""
    image = bpy.data.images.new("Color Grid", 1024, 1024)
    image.generated_type = "COLOR_GRID"
    material = bpy.data.materials.new("Grid")
    material.use_nodes = True
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    shader = next(each for each in material.node_tree.nodes if each.type == "BSDF_PRINCIPLED")
    material.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    obj.data.materials.append(material)


def unwrap(obj: Object, name: str) -> None:
    """Give an object a UV map, by *Smart UV Project*."""
    obj.data.uv_layers.new(name=name)
    select_only(obj)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(island_margin=0.005)
    bpy.ops.object.mode_set(mode="OBJECT")


def cut_below(obj: Object, height: float) -> None:
    """Delete the vertices of an object below a fraction of its height."""
    mesh = bmesh.new()
    mesh.from_mesh(obj.data)
    heights = [vertex.co.z for vertex in mesh.verts]
    limit = min(heights) + height * (max(heights) - min(heights))
    bmesh.ops.delete(mesh, geom=[vertex for vertex in mesh.verts if vertex.co.z < limit], context="VERTS")
    mesh.to_mesh(obj.data)
    mesh.free()


def bulge(obj: Object) -> None:
    """Sculpt on one side of an upright character: on an arm, and on the tip of an ear."""
    mesh = obj.data
    points, normals = np.empty((2, 3 * len(mesh.vertices)), np.float32)
    mesh.vertices.foreach_get("co", points)
    mesh.vertices.foreach_get("normal", normals)
    points, normals = points.reshape(-1, 3), normals.reshape(-1, 3)
    to_front = normals[:, 1] < -0.3
    middle = points[np.argmin(np.abs(points[:, 0] - 0.45 * points[:, 0].max()) + 5 * ~to_front)]
    points += 0.045 * np.exp(-((points - middle) ** 2).sum(axis=1) / 0.006)[:, None] * normals
    height, start = points[:, 2], np.percentile(points[:, 2], 96)
    ear = np.clip((height - start) / (height.max() - start), 0, 1) * (points[:, 0] < 0)
    points[:, 2] += 0.12 * ear**2
    mesh.vertices.foreach_set("co", points.ravel())
    mesh.update()


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


if __name__ == "__main__":
    main()
