# SPDX-License-Identifier: GPL-3.0-or-later
"""The line where the lips meet, seen from the front, and how the lips of two faces correspond.

Seen from the front, the depth of a skin has a valley between the lips, whether they touch or not, and whatever is
behind them. Dynamic programming finds its bottom in all columns of the image at once (Amini et al., Using dynamic
programming for solving variational problems in vision, 1990). Between the corners of the mouth, the valley is a crease.
Beyond them it is rounded, and a closing by a few millimetres does not fill it in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from scipy.sparse.csgraph import dijkstra

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.transfer.keys.front_view import enclosed_pieces, view_from_front
from zoomout_core.transfer.keys.head_directions import HeadDirections

# Lengths relative to the distance between the eyes, about 65 mm.
HALF_WIDTH, HALF_HEIGHT = 0.55, 0.26  # of the image around a mouth
SEARCHED = 0.2  # the line is searched up to this distance above and below the middle of the image
VALLEY, CREASE = 0.2, 0.03  # heights of the closings: above those of an opening and of a crease
OPEN = 0.05  # depth above which lips are apart
SHARP = 0.01  # depth of a crease between lips
BRIDGED = 0.05  # width of the gaps in a valley that are bridged: lips may be level where they meet
MIDDLE = 0.15  # half the width of the narrowest mouth
LIP = 0.12  # height of a lip
RIM = 0.02  # half the height of a rim
BAND = 0.06  # height of the bands along the rims that are certain to be on one lip
SIDES_END = 0.3  # distance from a band, along the surface, at which the sides of the mouth end
COLUMNS, CENTRE_COLUMNS = 176, 24  # of the image around a mouth, and of the image for finding its middle
BESIDE = 3  # pixels beside the rims in which the crease is searched
HOLES = 0.1  # share of the columns with holes in a lip above which the line is unclear; at most .01 on whole lips
MAX_RATIO = 1.5  # of the widths of the mouths of two persons
PARTED = 0.3  # touching lips are separated by this share of the largest motion of the jaw


@dataclass(frozen=True, eq=False)
class MouthLine:
    """The rims of two lips, as positions along the directions of the head. The rims coincide where the lips touch."""

    across: Floats  # (c,) columns along the direction left, ascending
    upper: Floats  # (c,) the upper rim along the direction up
    lower: Floats  # (c,) the lower rim
    depth: Floats  # (c,) the lips along the direction forward
    corners: tuple[float, float]  # the right and the left corner along the direction left
    above: Integers  # (a,) vertices of the upper lip that are visible along the rim
    below: Integers  # (b,) vertices of the lower lip that are visible along the rim

    @property
    def width(self) -> float:
        """The distance between the corners, as seen from the front."""
        return self.corners[1] - self.corners[0]

    def place_at(self, share: Floats, is_upper: Booleans) -> tuple[Floats, Floats]:
        """Positions (q,) along left and (q,) along up, at shares (q,) of the width, on the requested rims (q,)."""
        across = self.corners[0] + share * self.width
        upper, lower = (np.interp(across, self.across, rim) for rim in (self.upper, self.lower))
        return across, np.where(is_upper, upper, lower)


def find_lips(
    vertices: Floats, triangles: Integers, opens: Floats, places: tuple[Floats, Floats], head: HeadDirections
) -> Floats | None:
    """The point (3,) between the lips, where a motion (n,) that opens the mouth jumps, as seen from the front.

    It is searched between two points (3,), the eyes and the jaw. None if no lips are separated.
    """
    eyes, jaw = places
    half = MIDDLE * head.size, float((eyes - jaw) @ head.up) / 2
    view = view_from_front(vertices, triangles, (eyes + jaw) / 2, head, half, CENTRE_COLUMNS)
    if view is None:
        return None
    jumps = -np.diff(view.interpolate(opens), axis=1)
    row = int(np.median(jumps.argmax(axis=1)))
    if np.median(jumps.max(axis=1)) <= PARTED * opens.max():
        return None
    height, depth = float(view.height_of(np.array(row + 1.0))), float(np.median(view.close(VALLEY * head.size)[:, row]))
    return np.asarray(view.origin[0] * head.left + height * head.up + depth * head.forward)


def find_mouth_line(vertices: Floats, triangles: Integers, centre: Floats, head: HeadDirections) -> MouthLine | None:
    """The line between the lips around a point (3,) in a skin of vertices (n, 3) and triangles (m, 3).

    None if the lips have holes, or if there is no line between them, because they are joined and level.
    """
    half = HALF_WIDTH * head.size, HALF_HEIGHT * head.size
    view = view_from_front(vertices, triangles, centre, head, half, COLUMNS)
    if view is None:
        return None
    closed = view.close(VALLEY * head.size)
    depth = np.minimum((closed - view.depth) / head.size, OPEN)
    column, row = np.arange(depth.shape[0]), np.arange(depth.shape[1])
    searched = round(SEARCHED * head.size / view.pixel)
    first = len(row) // 2 - searched
    line = first + find_best_path(depth[:, first : len(row) // 2 + searched])
    lower, upper = _run(depth == OPEN, line)
    on_rims = (row >= lower[:, None] - BESIDE) & (row < upper[:, None] + BESIDE)

    crease = (view.close(CREASE * head.size) - view.depth) / (SHARP * head.size)
    sharp = np.where(on_rims, np.minimum(crease, 1), 0).max(axis=1)
    sharp[(upper - lower) * view.pixel > CREASE * head.size] = 1  # lips that are apart
    bridge = np.ones(round(BRIDGED * head.size / view.pixel), dtype=bool)
    is_valley = scipy.ndimage.binary_closing(depth[column, line] > SHARP, bridge)
    middle = len(column) // 2
    right, left = _length(sharp[:middle][::-1], is_valley[:middle][::-1]), _length(sharp[middle:], is_valley[middle:])
    between = slice(middle - int(right), middle + int(left))
    is_lip = np.abs(row - line[:, None]) * view.pixel < LIP * head.size
    # The valley between lip and chin may be as deep, but extends beyond the image.
    has_hole = ((enclosed_pieces(depth == OPEN) > 0) & is_lip & ~on_rims).any(axis=1)[between]
    if min(left, right) * view.pixel < MIDDLE * head.size or has_hole.mean() > HOLES:
        return None
    is_between = (column >= between.start) & (column < between.stop)
    band = BAND * head.size / view.pixel
    bands = (
        (row > upper[:, None] + BESIDE) & (row < upper[:, None] + band),
        (row < lower[:, None] - BESIDE) & (row > lower[:, None] - band),
    )
    return MouthLine(
        view.across,
        view.height_of(upper),
        view.height_of(lower),
        closed[column, line],
        (view.origin[0] - right * view.pixel, view.origin[0] + left * view.pixel),
        *(view.nearest_corners(on & is_between[:, None]) for on in bands),
    )


def match_lips(
    vertices: Floats, is_upper: Booleans, here: MouthLine, there: MouthLine, head: HeadDirections
) -> tuple[Integers, Floats]:
    """The vertices (r,) of a face (n, 3) along one line, and the shifts (r, 3) to another one.

    Takes a mask (n,) of the vertices on the upper lip. The shifts are perpendicular to the direction forward.
    """
    across, height, depth = (vertices @ axis for axis in (head.left, head.up, head.forward))
    share = np.clip((across - here.corners[0]) / here.width, 0, 1)
    (own, own_height), (other, other_height) = (line.place_at(share, is_upper) for line in (here, there))
    rim = RIM * head.size
    chosen = np.flatnonzero(
        (np.abs(across - own) < 2 * rim)
        & (np.abs(height - own_height) < rim)
        & (np.abs(depth - np.interp(own, here.across, here.depth)) < 4 * rim)
    )
    shift = (other - own)[:, None] * head.left + (other_height - own_height)[:, None] * head.up
    return chosen, shift[chosen]


def sides_of_mouth(vertices: Floats, triangles: Integers, line: MouthLine, head: HeadDirections) -> Floats:
    """The side (n,) of a mouth at vertices (n, 3): 1 on the upper lip and -1 on the lower one, 0 far from both.

    Distances along the surface distinguish lips that overlap, where one is hidden behind the other.
    """
    if not len(line.above) or not len(line.below):
        return np.zeros(len(vertices))
    edges = edge_graph(vertices, triangles)
    to_upper, to_lower = (
        dijkstra(edges, indices=lip, min_only=True, limit=(SIDES_END + LIP) * head.size) / head.size
        for lip in (line.above, line.below)
    )
    with np.errstate(invalid="ignore"):
        side = np.nan_to_num(np.clip((to_lower - to_upper) / LIP, -1, 1))
    near = np.clip(2 * (1 - np.minimum(to_upper, to_lower) / SIDES_END), 0, 1)
    return np.asarray(side * near)


def find_best_path(values: Floats) -> Integers:
    """The path (columns,) with the largest sum of values (columns, rows), at most one row apart between columns."""
    best, steps = values[0], np.zeros(values.shape, dtype=np.int64)
    for column, each in enumerate(values[1:], 1):
        beside = np.stack([np.append(-np.inf, best[:-1]), best, np.append(best[1:], -np.inf)])
        steps[column] = beside.argmax(axis=0) - 1
        best = beside.max(axis=0) + each
    path = np.full(len(values), best.argmax())
    for column in range(len(values) - 1, 0, -1):
        path[column - 1] = path[column] + steps[column, path[column]]
    return path


def _run(chosen: Booleans, line: Integers) -> tuple[Floats, Floats]:
    """First and last rows (columns,) of the runs of chosen pixels (columns, rows) around a line (columns,).

    Where the line's pixel is not chosen, both are its middle.
    """
    columns, rows = chosen.shape
    row = np.arange(rows)
    below = np.where(~chosen & (row < line[:, None]), row, -1).max(axis=1) + 1.0
    above = np.where(~chosen & (row > line[:, None]), row, rows).min(axis=1)
    on = chosen[np.arange(columns), line]
    return np.where(on, below, line + 0.5), np.where(on, above, line + 0.5)


def _length(sharp: Floats, is_valley: Booleans) -> float:
    """The number of columns of a crease, by its sharpness (c,) from 0 to 1, up to the end of a valley (c,).

    Within a crease, each column counts as sharp as the sharpest one beyond it.
    """
    end = len(sharp) if is_valley.all() else int(np.argmin(is_valley))
    return float(np.maximum.accumulate(sharp[:end][::-1]).sum())
