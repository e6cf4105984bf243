# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the animation and the pictures of the extension's page, from a new scene with the add-on's own operators.

`make page` writes to `dist/page`: `animation.mp4` (30 seconds), `featured.jpg` and `icon.png` in the sizes that
Blender's extensions site requires, and `sheet.jpg`, some of its frames. The demo's character is the source, its
posed and remeshed copy the target. Frames are rendered with Workbench, which looks like the viewport; Blender's
sequencer combines them, with wipes and captions, and encodes them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from math import radians
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import bpy
import extension
import numpy as np
from bpy.types import Mesh, Object
from mathutils import Vector
from numpy.typing import ArrayLike

from blender_addon import mesh_data, registered
from blender_addon.demo import picture
from blender_addon.demo.character import PAINT, build_character, select_only
from blender_addon.demo.target import POSE, clear_pose, posed_copy, remeshed, set_pose
from blender_addon.viewport import preview
from zoomout_core.arrays import Floats
from zoomout_core.transfer import Attribute, Domain, Kind

Pose = Mapping[str, tuple[float, float, float]]

OUTPUT = extension.DIST / "page"
# Sizes of the animation, and of the featured image and the icon, which the site prescribes.
SIZE, FPS, SECONDS = (1280, 720), 12, 30
FEATURED, ICON = (1920, 1080), (256, 256)
# Resolution of the character in metres, and of its copy in vertices: smooth, with visible wires.
EDGE, VOXEL, VERTICES = 0.0155, 0.0145, 8000
# Distance of the two from the middle, their rotation, and the thickness of their wires.
ASIDE, TURN, WIRE = 1.0, radians(14), 0.0016
# Scene-linear colours of a mesh without data, wires and podiums; colours of background and captions.
CLAY, INK, PLINTH = (0.55, 0.56, 0.58), (0.02, 0.03, 0.05), (0.16, 0.17, 0.19)
BACKGROUND, TEXT = (0.055, 0.06, 0.07), (0.95, 0.95, 0.93, 1.0)
BARE, PLACES = "Bare", "Places"
# Times of the sheet's frames in seconds, row by row, and their size in percent.
SHEET = ((2.0, 6.0, 7.9), (10.0, 13.5, 16.0), (19.5, 22.2, 25.8))
SHEET_PERCENT = 40
# Seconds of a wipe.
WIPE = 0.75

# Degrees as in `demo.target.POSE`: a step with the left foot, and a wave.
STEP: Pose = {
    "spine": (4, 0, 8),
    "chest": (4, 0, 8),
    "head": (-4, 0, -10),
    "upper_arm.L": (0, 38, -38),
    "forearm.L": (0, 10, -42),
    "upper_arm.R": (0, -38, -30),
    "forearm.R": (0, -10, -22),
    "thigh.L": (-38, 0, 0),
    "shin.L": (22, 0, 0),
    "thigh.R": (24, 0, 0),
    "shin.R": (34, 0, 0),
    "foot.R": (16, 0, 0),
    "tail_1": (0, 0, 16),
    "tail_2": (4, 0, 18),
    "tail_3": (4, 0, 18),
    "tail_4": (0, 0, 14),
}
WAVE: Pose = {
    "hips": (0, -5, 0),
    "spine": (0, -5, 0),
    "chest": (-4, -6, -6),
    "neck": (0, 6, 0),
    "head": (-4, 12, 8),
    "ear.L": (0, -12, 0),
    "ear.R": (0, 12, 0),
    "shoulder.L": (0, -10, 0),
    "upper_arm.L": (0, -22, -8),
    "forearm.L": (0, -40, 0),
    "upper_arm.R": (0, -40, 10),
    "forearm.R": (0, -8, 20),
    "thigh.R": (0, 10, 0),
    "tail_1": (-8, 0, -14),
    "tail_2": (-8, 0, -18),
    "tail_3": (0, 0, -18),
}


def mirror(pose: Pose) -> Pose:
    """A pose with its sides exchanged."""
    other = str.maketrans("LR", "RL")
    return {name[:-1] + name[-1:].translate(other): (x, -y, -z) for name, (x, y, z) in pose.items()}


def leaning(pose: Pose, forearm: float, hand: float) -> Pose:
    """A pose with the left forearm and hand turned further in the picture's plane, in degrees."""
    return {**pose, "forearm.L": (0, pose["forearm.L"][1] + forearm, 0), "hand.L": (0, hand, 0)}


# The rig's motion at the end: seconds from its start, and the pose then.
MOTION: tuple[tuple[float, Pose], ...] = (
    (0.0, POSE),
    (1.0, STEP),
    (1.75, mirror(STEP)),
    (2.5, STEP),
    (3.25, mirror(STEP)),
    (4.25, WAVE),
    (4.75, leaning(WAVE, forearm=-10, hand=-12)),
    (5.25, leaning(WAVE, forearm=24, hand=16)),
    (5.75, leaning(WAVE, forearm=-10, hand=-12)),
    (6.25, leaning(WAVE, forearm=24, hand=16)),
    (7.0, POSE),
)


class Shot(NamedTuple):
    """A picture, or several in a row, and their duration.

    Attributes:
        files: its pictures; several are shown for one frame each.
        seconds: its duration.
        caption: the text below.
    """

    files: list[Path]
    seconds: float
    caption: str


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


# --- the session that is shown --------------------------------------------------------------------------------


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


def pose_at(seconds: float) -> Pose:
    """The current pose of the rig."""
    for (begin, pose), (end, other) in pairwise(MOTION):
        if seconds < end:
            return between(pose, other, (seconds - begin) / (end - begin))
    return MOTION[-1][1]


def between(pose: Pose, other: Pose, share: float) -> Pose:
    """A pose interpolated between two, with zero velocity at both."""
    share = share * share * (3 - 2 * share)
    rest = (0.0, 0.0, 0.0)
    found = {}
    for name in {*POSE, *STEP, *WAVE, *mirror(STEP)}:
        (x, y, z), (to_x, to_y, to_z) = pose.get(name, rest), other.get(name, rest)
        found[name] = (x + share * (to_x - x), y + share * (to_y - y), z + share * (to_z - z))
    return found


# --- how it looks ---------------------------------------------------------------------------------------------


def stage() -> None:
    """Add podiums and a camera, and choose Workbench."""
    scene = bpy.context.scene
    for side in (-1, 1):
        podium(side * ASIDE)
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = BACKGROUND
    scene.camera = picture.link("Camera", bpy.data.cameras.new("Camera"), Vector((0, -9, 1.35)))
    scene.camera.data.lens = 78
    look_at(Vector((0, 0, 0.68)))
    scene.render.engine = "BLENDER_WORKBENCH"
    scene.view_settings.view_transform = "Standard"
    shading = scene.display.shading
    shading.light, shading.studio_light, shading.color_type = "STUDIO", "paint.sl", "VERTEX"
    shading.show_cavity, shading.cavity_type = True, "BOTH"
    scene.display.render_aa = "5"  # more take longer without a visible difference


def podium(x: float) -> Object:
    """Add a podium."""
    mesh = picture.podium_mesh()
    add_colors(mesh, BARE, PLINTH)
    mesh.materials[0].diffuse_color = (*PLINTH, 1)
    return picture.link("Podium", mesh, Vector((x, 0, 0)))


def look_at(point: Vector) -> None:
    camera = bpy.context.scene.camera
    camera.rotation_euler = (point - camera.location).to_track_quat("-Z", "Y").to_euler()


def show(mesh: Mesh, attribute: str) -> None:
    """Show a mesh in the colours of one of its attributes."""
    mesh.color_attributes.active_color = mesh.color_attributes[attribute]
    mesh.color_attributes.render_color_index = mesh.color_attributes.find(attribute)


def add_colors(mesh: Mesh, name: str, colors: ArrayLike) -> None:
    """Add a colour attribute of linear colours of the vertices, (n, 3) or one (3,) for all."""
    values = np.ones((len(mesh.vertices), 4))
    values[:, :3] = colors
    attribute = Attribute(name, Domain.POINT, Kind.COLOR, values)
    mesh_data.write_layer(mesh, mesh_data.Layer(attribute, mesh_data.Role.COLOR, "FLOAT_COLOR"))


def wireframe(obj: Object, thickness: float = WIRE) -> Object:
    """Dark wires along the edges of an object."""
    wire = obj.copy()
    wire.data = obj.data.copy()
    bpy.context.scene.collection.objects.link(wire)
    add_colors(wire.data, BARE, INK)
    show(wire.data, BARE)
    wire.modifiers.new("Wire", "WIREFRAME").thickness = thickness
    return wire


def draw(path: Path, size: tuple[int, int] = SIZE) -> Path:
    """Render the scene to a file, in the format of its extension."""
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y = size
    render.image_settings.file_format = {".png": "PNG", ".jpg": "JPEG"}[path.suffix]
    render.image_settings.color_mode = "RGBA" if render.film_transparent else "RGB"
    render.image_settings.quality = 90
    render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return path


# --- pictures -------------------------------------------------------------------------------------------------


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


def render_only(objects: list[Object]) -> None:
    for obj in bpy.context.scene.objects:
        obj.hide_render = obj not in objects


def aim(position: Vector, point: Vector, width: float) -> None:
    """Aim an orthographic camera of a given width at a point."""
    camera = bpy.context.scene.camera
    camera.location = position
    camera.data.type, camera.data.ortho_scale = "ORTHO", width
    look_at(point)


def read_colors(mesh: Mesh, name: str) -> Floats:
    """The linear colours (n, 3) of the vertices in an attribute."""
    colors = np.empty(4 * len(mesh.vertices), np.float32)
    mesh.color_attributes[name].data.foreach_get("color", colors)
    return colors.reshape(-1, 4)[:, :3].astype(float)


# --- the sequencer --------------------------------------------------------------------------------------------


def edit(shots: list[Shot]) -> None:
    """Add shots to the sequencer, with wipes between them and captions below."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.fps = FPS
    scene.view_settings.view_transform = "Standard"
    strips = scene.sequence_editor_create().strips
    font = bpy.data.fonts.load(str(Path(bpy.utils.system_resource("DATAFILES", path="fonts"), "Inter.woff2")))
    begin, before = 1, None
    for number, shot in enumerate(shots):
        end = begin + round(shot.seconds * FPS)
        overlap = 0 if before is None or shot.files[0] == shots[number - 1].files[-1] else round(WIPE * FPS)
        strip = strips.new_image(f"Shot {number}", str(shot.files[0]), 1 + number % 2, begin)
        for path in shot.files[1:]:
            strip.elements.append(path.name)
        tail = 0 if number + 1 == len(shots) else round(WIPE * FPS)
        strip.frame_final_duration = end - begin + tail
        if overlap:
            wipe = strips.new_effect(f"Wipe {number}", "WIPE", 3, begin, length=overlap, input1=before, input2=strip)
            wipe.transition_type, wipe.direction, wipe.blur_width = "SINGLE", "IN", 0.15
        caption = strips.new_effect(f"Caption {number}", "TEXT", 4, begin, length=end - begin)
        caption.text, caption.font_size, caption.color = shot.caption, 34, TEXT
        caption.font, caption.location, caption.use_shadow = font, (0.5, 0.07), False
        begin, before = end, strip
    scene.frame_start, scene.frame_end = 1, begin - 1


def encode(path: Path) -> None:
    """Encode the sequence as H.264, which the site and browsers play."""
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y = SIZE
    render.image_settings.media_type = "VIDEO"
    render.image_settings.file_format = "FFMPEG"
    render.ffmpeg.format, render.ffmpeg.codec = "MPEG4", "H264"
    render.ffmpeg.constant_rate_factor, render.ffmpeg.ffmpeg_preset = "MEDIUM", "GOOD"
    render.ffmpeg.audio_codec = "NONE"
    render.use_file_extension = False
    render.filepath = str(path)
    bpy.ops.render.render(animation=True)


def make_sheet(path: Path) -> None:
    """Combine some frames of the sequence, with their captions, in one picture."""
    scene = bpy.context.scene
    scene.render.image_settings.media_type = "IMAGE"
    scene.render.resolution_percentage = SHEET_PERCENT
    frame_file = path.with_name("frame.png")
    rows = []
    for row in SHEET:
        pictures = []
        for seconds in row:
            scene.frame_set(1 + round(seconds * FPS))
            image = bpy.data.images.load(str(draw(frame_file)))
            width, height = image.size
            pixels = np.empty(width * height * 4, np.float32)
            image.pixels.foreach_get(pixels)
            pictures.append(pixels.reshape(height, width, 4))
            bpy.data.images.remove(image)
        rows.append(np.concatenate(pictures, axis=1))
    frame_file.unlink()
    sheet = np.concatenate(rows[::-1], axis=0)  # Blender's rows of pixels go upwards
    image = bpy.data.images.new("Sheet", sheet.shape[1], sheet.shape[0])
    image.pixels.foreach_set(sheet.ravel())
    image.file_format = "JPEG"
    image.save(filepath=str(path), quality=85)


if __name__ == "__main__":
    main()
