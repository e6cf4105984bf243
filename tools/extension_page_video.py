# SPDX-License-Identifier: GPL-3.0-or-later
"""The animation of the extension's page: shots in Blender's sequencer, with wipes and captions, and their encoding."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np
from extension_page_scene import FPS, SIZE, TEXT, draw

# Times of the sheet's frames in seconds, row by row, and their size in percent.
SHEET = ((2.0, 6.0, 7.9), (10.0, 13.5, 16.0), (19.5, 22.2, 25.8))
SHEET_PERCENT = 40
# Seconds of a wipe.
WIPE = 0.75


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
