# SPDX-License-Identifier: GPL-3.0-or-later
"""Thumbnails of candidates: the target in the position colours of each map, and the source in its own colours.

Those of files in libraries are pictures of both, and the file's own.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import bpy
import bpy.utils.previews
import numpy as np

from zoomout_core.arrays import Bytes, Floats
from zoomout_core.drawing import PAPER
from zoomout_core.mesh.formats.blender_files import BLEND, split_asset

from ..storage.stored_candidates import CandidateList

SIZE = 64
# Radius of the disc of each sample, and width of the empty border, in pixels.
DOT, BORDER = 3, 5
# Direction of view, in radians: from the front, slightly from the left and above, so that neither side is hidden.
TURN, TILT = np.radians(30), np.radians(15)
# Brightness of the farthest points, relative to the nearest.
SHADE = 0.6

_previews: bpy.utils.previews.ImagePreviewCollection | None = None


def icon_of_candidate(listing: CandidateList, place: int) -> int:
    """Icon number of the target's thumbnail in a candidate's colours."""
    return _icon(f"{listing.key} {place}", partial(picture, listing.points, listing.candidates[place].colors / 255))


def icon_of_source(listing: CandidateList) -> int:
    """Icon number of the source's thumbnail."""
    colors = np.concatenate([candidate.colors for candidate in listing.candidates])
    return _icon(f"{listing.key} source", partial(picture, colors / 255 * listing.box, colors / 255))


def icon_of_symmetry(name: str, points: Floats, colors: Bytes) -> int:
    """Icon number of a mesh's thumbnail in the colours of one of its symmetries, see `stored_symmetry.thumbnails`."""
    return _icon(name, partial(picture, points, colors / 255))


def icon_of_picture(image: Bytes) -> int:
    """Icon number of a picture (height, width, 3) that the core has drawn, on a transparent background."""
    return _icon(f"picture {hash(image.tobytes())}", partial(_without_paper, image))


def icon_of_file(path: str) -> int | None:
    """Icon number of the thumbnail that a .blend file has of itself or of an asset in it; None if there is none."""
    if split_asset(Path(path))[0].suffix.lower() != BLEND:
        return None
    previews = _collection()
    if path not in previews:
        previews.load(path, path, "BLEND")
    return int(previews[path].icon_id) if previews[path].image_size[0] else None


def unregister() -> None:
    """Remove all thumbnails."""
    global _previews
    if _previews is not None:
        bpy.utils.previews.remove(_previews)
        _previews = None


def picture(points: Floats, colors: Floats) -> Floats:
    """An RGBA image (SIZE, SIZE, 4), bottom row first, of points (s, 3) as discs in their colours (s, 3)."""
    across, depth, up = _in_view(points).T
    scale = (SIZE - 1 - 2 * BORDER) / max(np.ptp(across), np.ptp(up), 1e-12)
    column = (across - (across.max() + across.min()) / 2) * scale + (SIZE - 1) / 2
    row = (up - (up.max() + up.min()) / 2) * scale + (SIZE - 1) / 2
    near = 1 - (depth - depth.min()) / max(np.ptp(depth), 1e-12)
    shaded = colors * (SHADE + (1 - SHADE) * near[:, None])

    dot = np.mgrid[-DOT : DOT + 1, -DOT : DOT + 1].reshape(2, -1)
    dot = dot[:, (dot**2).sum(axis=0) <= DOT**2]
    order = np.argsort(near, kind="stable")  # near points are drawn last
    rows = (np.rint(row[order]).astype(int)[:, None] + dot[0]).clip(0, SIZE - 1)
    columns = (np.rint(column[order]).astype(int)[:, None] + dot[1]).clip(0, SIZE - 1)
    pixels = np.zeros((SIZE, SIZE, 4))
    pixels[rows, columns, :3] = shaded[order][:, None]
    pixels[rows, columns, 3] = 1
    return pixels


def _in_view(points: Floats) -> Floats:
    """(s, 3) points in view space: right, away from the viewer, up."""
    turn, tilt = (
        np.array([[np.cos(TURN), np.sin(TURN), 0], [-np.sin(TURN), np.cos(TURN), 0], [0, 0, 1]]),
        np.array([[1, 0, 0], [0, np.cos(TILT), -np.sin(TILT)], [0, np.sin(TILT), np.cos(TILT)]]),
    )
    return points @ (tilt @ turn).T


def _without_paper(image: Bytes) -> Floats:
    """A picture of the core as an RGBA image, bottom row first."""
    drawn = (image != np.rint(255 * PAPER)).any(axis=2, keepdims=True)
    return np.concatenate([image / 255, drawn], axis=2)[::-1]


def _icon(name: str, draw: Callable[[], Floats]) -> int:
    """The icon number of an RGBA image (height, width, 4), bottom row first, which is drawn once."""
    previews = _collection()
    if name not in previews:
        made = previews.new(name)
        pixels = draw().astype(np.float32)
        made.image_size = made.icon_size = pixels.shape[1], pixels.shape[0]
        made.image_pixels_float.foreach_set(pixels.ravel())
        made.icon_pixels_float.foreach_set(pixels.ravel())
    return int(previews[name].icon_id)


def _collection() -> bpy.utils.previews.ImagePreviewCollection:
    global _previews
    if _previews is None:
        _previews = bpy.utils.previews.new()
    return _previews
