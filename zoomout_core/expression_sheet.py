# SPDX-License-Identifier: GPL-3.0-or-later
"""A contact sheet of expression keys: a tile for each key, with the source's head beside the target's."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, sqrt
from typing import TypeAlias

import numpy as np

from zoomout_core.arrays import Booleans, Bytes, Floats, Integers
from zoomout_core.colors import BAD_TO_GOOD
from zoomout_core.drawing import draw_triangles
from zoomout_core.geometry.procrustes import Similarities, procrustes
from zoomout_core.mesh.triangles import unit_vectors, vertex_areas, vertex_normals, widen
from zoomout_core.messages import message
from zoomout_core.runtime.progress import advance, stage

# Pixels of a head, of the line above it, and between tiles.
WIDTH, HEIGHT, LINE, GAP = 170, 190, 18, 8
# Width of a sheet over its height.
SHAPE = 1.6
# Colours of paper, text and skin; red marks faults of keys.
PAPER, INK, SKIN = np.full(3, 0.97), np.full(3, 0.1), np.array([0.86, 0.81, 0.77])
MARK = BAD_TO_GOOD[0]
# A head is seen from this far to its side, in degrees, so that lips and chin have a profile.
YAW = 20.0
# A picture shows the vertices whose motion is at least the first share of the key's largest motion, with a margin
# around them, as a share of their extent.
MOVING, MARGIN = 0.5, 0.15
# Minimum number of keys that determine the rotation between two heads, and minimum spread of their places along the
# second direction relative to the first; below it they are on a line.
MIN_PLACES, MIN_SPREAD = 4, 0.1

# Draws text in a colour on paper, as a picture (height, width, 3) of a given height and at most a given width.
Label: TypeAlias = Callable[[str, int, int], Bytes]


@dataclass(frozen=True, eq=False)
class Head:
    """A head with expression keys.

    Attributes:
        vertices: (n, 3) at rest; z is up.
        triangles: (m, 3) vertex numbers.
        keys: the offsets (n, 3) of each key at full strength, by name.
    """

    vertices: Floats
    triangles: Integers
    keys: Mapping[str, Floats]

    @property
    def motion(self) -> Floats:
        """(n,) how much any key moves each vertex, at most, as a share of its largest motion."""
        share = np.zeros(len(self.vertices))
        for offsets in self.keys.values():
            length = np.linalg.norm(offsets, axis=1)
            share = np.maximum(share, length / max(length.max(), np.finfo(float).tiny))
        return share


def draw_sheet(source: Head, target: Head, marks: Mapping[str, Booleans], label: Label) -> Bytes:
    """Draw all keys of the source beside those of the target, and both at rest in the first tile.

    Args:
        source: the head that has the keys.
        target: the head that received them, in any place, rotation and size.
        marks: by key, the target's vertices (n_t,) to colour red.
        label: draws text.

    Returns:
        (height, width, 3) pixels, rows from top to bottom.
    """
    view = _View.of(source)
    similarity = _similarity(source, target)
    views = view, _View.of(target) if similarity is None else view.follow(target, similarity)
    tiles = [_tile("At rest", [view.at_rest for view in views], label)]
    for number, name in enumerate(source.keys):
        with stage(message("Drawing {key}", key=name), 0, 1):
            advance(number / len(source.keys))
        drawn = [views[0].draw(name), views[1].draw(name, marks.get(name))]
        tiles.append(_tile(name if name in target.keys else f"{name} (missing)", drawn, label))
    columns = max(1, round(sqrt(SHAPE * len(tiles) * tiles[0].shape[0] / tiles[0].shape[1])))
    return _arrange(tiles, columns)


def face_axes(head: Head) -> Floats:
    """(3, 3) the directions to the right, upwards and towards the viewer for whom the head is from the front.

    The front is where the keys move the head.
    """
    moved = head.motion * vertex_areas(head.vertices, head.triangles)
    forward = moved @ vertex_normals(head.vertices, head.triangles) * [1, 1, 0]
    towards = unit_vectors(forward[None])[0] if forward.any() else np.array([0.0, -1.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    right = np.cross(up, towards)
    side = np.radians(YAW)
    return np.array(
        [
            np.cos(side) * right + np.sin(side) * towards,
            up,
            np.cos(side) * towards - np.sin(side) * right,
        ]
    )


def _similarity(source: Head, target: Head) -> Similarities | None:
    """The similarity from the source to the target by the places that their keys move; None if it is not determined."""
    shared = [name for name in source.keys if name in target.keys]
    shared = [name for name in shared if source.keys[name].any() and target.keys[name].any()]
    if len(shared) < MIN_PLACES:
        return None
    places, images = (np.array([_place(head, name) for name in shared]) for head in (source, target))
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return None if spread[1] < MIN_SPREAD * spread[0] else procrustes(places, images)


def _place(head: Head, name: str) -> Floats:
    """(3,) the centre of the vertices that a key moves."""
    weight = np.linalg.norm(head.keys[name], axis=1) * vertex_areas(head.vertices, head.triangles)
    return weight @ head.vertices / max(weight.sum(), np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class _View:
    """A head and how it is seen.

    Attributes:
        head: the head.
        axes: (3, 3) the directions to the right, upwards and towards the viewer.
        center: (3,) the place in the middle of the picture.
        scale: pixels for each unit of length.
    """

    head: Head
    axes: Floats
    center: Floats
    scale: float

    @classmethod
    def of(cls, head: Head) -> _View:
        """A view of the vertices that the keys move."""
        axes, motion = face_axes(head), head.motion
        seen = head.vertices[motion >= min(MOVING, motion.max())] @ axes.T
        low, high = seen.min(axis=0), seen.max(axis=0)
        size = (1 + 2 * MARGIN) * np.maximum(high - low, np.finfo(float).tiny)[:2]
        return cls(head, axes, (low + high) / 2 @ axes, float((np.array([WIDTH, HEIGHT]) / size).min()))

    def follow(self, head: Head, similarity: Similarities) -> _View:
        """The same view of another head, which a similarity takes this one to."""
        scale, rotation = float(similarity.scale), similarity.rotation
        center = scale * rotation @ self.center + similarity.translation
        return _View(head, self.axes @ rotation.T, center, self.scale / scale)

    @cached_property
    def at_rest(self) -> Bytes:
        """A picture of the head at rest."""
        return self._paint(self._points(self.head.vertices), self._colors())

    def draw(self, key: str, marked: Booleans | None = None) -> Bytes:
        """A picture of the head with a key at full strength, if it has it, and with marked vertices in red."""
        vertices, triangles = self.head.vertices, self.head.triangles
        offsets = self.head.keys.get(key, np.zeros_like(vertices))
        changed = offsets.any(axis=1) if marked is None else offsets.any(axis=1) | marked
        if not changed.any():
            return self.at_rest
        # The triangles around a vertex shade it, and the others around it show its shade.
        changed = widen(widen(changed, triangles), triangles)
        points = self._points(vertices + offsets)
        reached = np.concatenate([points[changed], self._points(vertices[changed])])[:, :2]
        left, bottom = np.floor(reached.min(axis=0).clip(0, [WIDTH, HEIGHT])).astype(int)
        right, top = np.ceil(reached.max(axis=0).clip(0, [WIDTH, HEIGHT])).astype(int)
        picture = self.at_rest.copy()
        part = self._paint(points - [left, bottom, 0], self._colors(marked), right - left, top - bottom)
        picture[HEIGHT - top : HEIGHT - bottom, left:right] = part
        return picture

    def _colors(self, marked: Booleans | None = None) -> Floats:
        """(n, 3) colours of the vertices."""
        colors = np.tile(SKIN, (len(self.head.vertices), 1))
        if marked is not None:
            colors[marked] = MARK
        return colors

    def _points(self, vertices: Floats) -> Floats:
        """(n, 3) places of vertices (n, 3) in the picture, in pixels."""
        return (vertices - self.center) @ self.axes.T * self.scale + [WIDTH / 2, HEIGHT / 2, 0]

    def _paint(self, points: Floats, colors: Floats, width: int = WIDTH, height: int = HEIGHT) -> Bytes:
        return draw_triangles(points, self.head.triangles, colors, width, height, PAPER)


def _tile(text: str, pictures: Sequence[Bytes], label: Label) -> Bytes:
    """Pictures side by side below a line of text."""
    row = np.concatenate(pictures, axis=1)
    tile = _paper(LINE + row.shape[0] + GAP, row.shape[1] + GAP)
    line = label(text, LINE, row.shape[1])
    tile[: line.shape[0], : line.shape[1]] = line
    tile[LINE : LINE + row.shape[0], : row.shape[1]] = row
    return tile


def _arrange(tiles: Sequence[Bytes], columns: int) -> Bytes:
    """Tiles of equal size in rows, with a gap around them."""
    height, width = tiles[0].shape[:2]
    sheet = _paper(GAP + height * ceil(len(tiles) / columns), GAP + width * min(columns, len(tiles)))
    for number, tile in enumerate(tiles):
        top, left = GAP + height * (number // columns), GAP + width * (number % columns)
        sheet[top : top + height, left : left + width] = tile
    return sheet


def _paper(height: int, width: int) -> Bytes:
    return np.tile(np.rint(255 * PAPER).astype(np.uint8), (height, width, 1))
