# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the animation and the pictures of the extension's page, from a new scene with the add-on's own operators.

`make page` writes to `dist/page`: `animation.mp4` (30 seconds), `featured.jpg` and `icon.png` in the sizes that
Blender's extensions site requires, and `sheet.jpg`, some of its frames. The demo's character is the source, its
posed and remeshed copy the target. Frames are rendered with Workbench, which looks like the viewport; Blender's
sequencer combines them, with wipes and captions, and encodes them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from time import perf_counter

import bpy
import extension
import numpy as np
from bpy.types import Object
from extension_page_poses import MOTION, WAVE, between, pose_at
from extension_page_scene import (
    ASIDE,
    BARE,
    CLAY,
    FPS,
    PLACES,
    SECONDS,
    TEXT,
    TURN,
    WIRE,
    add_colors,
    aim,
    draw,
    podium,
    read_colors,
    render_only,
    show,
    stage,
    wireframe,
)
from extension_page_video import Shot, edit, encode, make_sheet
from mathutils import Vector

from blender_addon import mesh_data, registered
from blender_addon.demo import picture
from blender_addon.demo.character import PAINT, build_character, select_only
from blender_addon.demo.target import clear_pose, posed_copy, remeshed, set_pose
from blender_addon.viewport import preview

OUTPUT = extension.DIST / "page"
# Sizes of the featured image and the icon, which the site prescribes.
FEATURED, ICON = (1920, 1080), (256, 256)
# Resolution of the character in metres, and of its copy in vertices: smooth, with visible wires.
EDGE, VOXEL, VERTICES = 0.0155, 0.0145, 8000


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the animation and the pictures of the extension's page.")
    parser.add_argument("-o", "--output", type=Path, default=OUTPUT, help="folder to write to (default: dist/page)")
    output = parser.parse_args().output.resolve()
    frames = output / "frames"
    frames.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with registered():
        shots = list(film(frames))
        make_featured(output / "featured.jpg")
        make_icon(output / "icon.png")
    edit(shots)
    encode(output / "animation.mp4")
    make_sheet(output / "sheet.jpg")
    for path in sorted(output.glob("*.*")):
        print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


def film(frames: Path) -> Iterator[Shot]:
    """Go through a session, and render its pictures to a folder."""
    source, rig, target = make_pair()
    stage()

    def still(name: str, of_source: str, of_target: str, seconds: float, caption: str) -> Shot:
        show(source.data, of_source)
        show(target.data, of_target)
        return Shot([draw(frames / f"{name}.png")], seconds, caption)

    add_colors(target.data, BARE, CLAY)
    yield still("begin", PAINT, BARE, 4, "A finished character, and a new mesh of it in another pose")
    add_colors(source.data, BARE, CLAY)
    wires = [wireframe(obj) for obj in (source, target)]
    counts = " and ".join(f"{len(obj.data.vertices):,}" for obj in (source, target))
    yield still("wires", BARE, BARE, 3.5, f"{counts} vertices: only the shape is the same")
    for wire in wires:
        bpy.data.objects.remove(wire)

    select_only(target, source)
    seconds = seconds_of(bpy.ops.zoomout.match)
    bpy.ops.zoomout.preview(kind=preview.PLACES)
    shown = preview.current()
    assert shown is not None  # a match was just made
    for obj, overlay in zip((target, source), shown.overlays, strict=True):
        add_colors(obj.data, PLACES, np.asarray(overlay.values) ** 2.2)
    yield still("match", PLACES, PLACES, 4.5, f"Match ({seconds:.0f} s): same color, same place")

    bpy.ops.zoomout.cut_seams()
    seconds = seconds_of(bpy.ops.zoomout.transfer)
    yield still("paint", PAINT, PAINT, 3, f"Transfer ({seconds:.1f} s): its painted colors,")
    for obj in (source, target):
        obj.data.materials.append(picture.checker_material())
        picture.color_weights(obj)
    bpy.context.scene.display.shading.color_type = "TEXTURE"
    yield still("uv", PAINT, PAINT, 3, "its UV map, islands cut where it has its seams,")
    bpy.context.scene.display.shading.color_type = "VERTEX"
    yield still("weights", picture.WEIGHT_COLORS, picture.WEIGHT_COLORS, 3, "and its skin weights")

    show(source.data, PAINT)
    show(target.data, PAINT)
    select_only(target, source)
    seconds = seconds_of(bpy.ops.zoomout.bind_to_rig)
    files = list(draw_motion(frames, source, rig))
    yield Shot(files, len(files) / FPS, f"Bind to Rig ({seconds:.0f} s): the source's bones pose the target")
    yield Shot(files[-1:], SECONDS - 21 - len(files) / FPS, "ZoomOut Transfer, for Blender 4.2 and newer")


def seconds_of(operator: Callable[[], object]) -> float:
    """Seconds that an operator takes."""
    begun = perf_counter()
    operator()
    return perf_counter() - begun


def make_pair() -> tuple[Object, Object, Object]:
    """Build the character, its armature, and the target next to it."""
    source, rig = build_character(EDGE)
    set_pose(rig)
    posed = posed_copy(source)
    target = remeshed(posed, VOXEL, VERTICES)
    bpy.data.meshes.remove(posed.data)
    clear_pose(rig)
    source.name, target.name = "Hero", "Scan"
    for obj, side, mesh in ((rig, -1, source), (target, 1, target)):
        place(obj, side * ASIDE, mesh)
    bpy.context.view_layer.update()
    return source, rig, target


def place(obj: Object, x: float, figure: Object) -> None:
    """Move an object so that a figure parented to it has its lowest point on the ground."""
    evaluated = figure.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    obj.location, obj.rotation_euler = (x, 0, -mesh_data.read_positions(evaluated)[:, 2].min()), (0, 0, TURN)


def draw_motion(frames: Path, source: Object, rig: Object) -> Iterator[Path]:
    """Render the bound target next to the source, both posed by the bones, frame by frame.

    Both are bound to one armature and would overlap: the source is shown as a copy with a copy of the armature.
    """
    copy, copied_rig = source.copy(), rig.copy()
    for obj in (copy, copied_rig):
        bpy.context.scene.collection.objects.link(obj)
    copy.parent = copied_rig
    copy.modifiers["Armature"].object = copied_rig
    source.hide_render = True
    for frame in range(round(FPS * MOTION[-1][0]) + 1):
        now = frame / FPS
        pose = pose_at(now)
        set_pose(rig, pose)
        set_pose(copied_rig, between({}, pose, min(now / MOTION[1][0], 1)))
        bpy.context.view_layer.update()
        place(rig, ASIDE, source)
        place(copied_rig, -ASIDE, copy)
        yield draw(frames / f"motion_{frame:03d}.png")


def make_featured(path: Path) -> None:
    """From the source to the bound target in four figures, after the film."""
    source, target, rig = (bpy.data.objects[name] for name in ("Hero", "Scan", "Armature"))
    rig.location = rig.rotation_euler = (0, 0, 0)
    set_pose(rig)
    scan = [posed_copy(target) for _ in range(2)]
    clear_pose(rig)
    rested = posed_copy(source)
    set_pose(rig, WAVE)
    figures = [rested, *scan, posed_copy(target), wireframe(scan[0])]
    clear_pose(rig)
    seen = []
    places = (-2.4, -0.8, 0.8, 2.4)
    for x, figure, color in zip((*places, places[1]), figures, (PAINT, BARE, PLACES, PAINT, BARE), strict=True):
        show(figure.data, color)
        place(figure, x, figure)
        seen += [figure, podium(x)]
    for x, label in zip(places, ("Source", "Target", "Match", "Transfer and Bind"), strict=True):
        seen.append(picture.write(label, (x, 0, -0.4), 0.17, TEXT[:3]))
    seen.append(picture.write("ZoomOut Transfer", (0, 0, 2.05), 0.44, TEXT[:3]))
    render_only(seen)
    aim(Vector((0, -9, 1.35)), Vector((0, 0, 0.95)), 6.5)
    bpy.context.scene.display.render_aa = "16"
    draw(path, FEATURED)


def make_icon(path: Path) -> None:
    """The source's head, half of it as wires, half with its colours."""
    source = bpy.data.objects["Hero"]
    left = mesh_data.read_positions(source.data)[:, :1] > 0
    add_colors(source.data, "Icon", np.where(left, read_colors(source.data, PAINT), CLAY))
    show(source.data, "Icon")
    wire = wireframe(source, 1.5 * WIRE)
    wire.modifiers.remove(wire.modifiers["Corrective Smooth"])  # it refuses another number of vertices
    wire.vertex_groups.new(name="Right").add(np.flatnonzero(~left).tolist(), 1, "ADD")
    wire.modifiers.new("Right", "MASK").vertex_group = "Right"
    wire.modifiers.move(len(wire.modifiers) - 1, 0)
    render_only([source, wire])
    bpy.data.objects["Armature"].rotation_euler = (0, 0, 0)
    aim(Vector((0, -9, 1.9)), Vector((0, 0, 1.34)), 0.86)
    bpy.context.scene.render.film_transparent = True
    draw(path, ICON)


if __name__ == "__main__":
    main()
