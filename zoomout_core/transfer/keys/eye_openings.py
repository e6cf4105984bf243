# SPDX-License-Identifier: GPL-3.0-or-later
"""The openings between the eyelids, seen from the front, and how the rims of the lids of two faces correspond.

Seen from the front, the depth of a skin jumps from the rims of the lids to the bottom of the socket, for any
triangulation. An opening consists of the pixels that a morphological closing of the depth image raises. Between the
corners of the lids, rims correspond by their relative position along the width.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.transfer.keys.front_view import enclosed_pieces, view_from_front
from zoomout_core.transfer.keys.head_directions import HeadDirections

# Lengths relative to the distance between the eyes, about 65 mm.
WINDOW = 0.38  # half the side of the square around an eye in which its opening is searched
DEPTH = 0.12  # minimum depth of a socket behind the lids: exceeds that of the skin beside the nose
CLOSING = 0.25  # height of the closing of the image
MAX_HEIGHT = 0.9  # of an opening, as a share of the closing's height: only parts of higher ones are found
RIM = 0.05  # half the height of a rim
PIXELS = 96  # along a side of the square
SLIT = 5  # pixels: narrower ends of openings depend on the triangles, and are filled in
MIN_COLUMNS = 12  # of an opening
SMOOTHING = 1.5  # of the rims, in pixels
MAX_RATIO = 4.0  # of the areas of the openings of two persons: nearly closed eyes have a third of the usual area


@dataclass(frozen=True, eq=False)
class EyeOpening:
    """An opening between two lids, as positions along the directions of the head."""

    across: Floats  # (c,) columns along the direction left, ascending
    upper: Floats  # (c,) the upper rim along the direction up
    lower: Floats  # (c,) the lower rim
    depth: Floats  # (c,) the lids along the direction forward

    @property
    def area(self) -> float:
        """The area of the opening, as seen from the front."""
        return float((self.upper - self.lower).mean() * np.ptp(self.across))

    def middle_at(self, across: Floats) -> Floats:
        """Heights (q,) halfway between the rims, in columns (q,)."""
        return np.interp(across, self.across, (self.upper + self.lower) / 2)

    def rim_at(self, across: Floats, is_upper: Booleans) -> Floats:
        """Heights (q,) of the upper or lower rim, as requested by a mask (q,), in columns (q,)."""
        return np.where(
            is_upper, np.interp(across, self.across, self.upper), np.interp(across, self.across, self.lower)
        )


def find_eye_opening(vertices: Floats, triangles: Integers, centre: Floats, head: HeadDirections) -> EyeOpening | None:
    """The opening of the eye around a centre (3,) in a skin of vertices (n, 3) and triangles (m, 3).

    None if the eye is closed or has no socket, or if the opening is too large.
    """
    half = WINDOW * head.size
    view = view_from_front(vertices, triangles, centre, head, (half, half), PIXELS)
    if view is None:
        return None
    view = replace(view, depth=scipy.ndimage.maximum_filter(view.depth, SLIT))
    closed = view.close(CLOSING * head.size)
    piece = enclosed_pieces(closed - view.depth > DEPTH * head.size)
    sizes = np.bincount(piece.ravel())
    sizes[0] = 0
    opening = (piece == np.argmax(sizes)) & bool(sizes.any())
    columns = np.flatnonzero(opening.any(axis=1))
    if len(columns) < MIN_COLUMNS:
        return None
    first, last = opening.argmax(axis=1)[columns], PIXELS - opening[:, ::-1].argmax(axis=1)[columns]
    if (last - first).max() * view.pixel > MAX_HEIGHT * CLOSING * head.size:
        return None
    lower, upper = (
        view.height_of(scipy.ndimage.gaussian_filter1d(rim.astype(np.float64), SMOOTHING, mode="nearest"))
        for rim in (first, last)
    )
    return EyeOpening(view.across[columns], upper, lower, closed[columns, (first + last) // 2])


def match_rims(
    vertices: Floats, displacement: Floats, here: EyeOpening, there: EyeOpening, inner: int, head: HeadDirections
) -> tuple[Integers, Floats]:
    """The vertices (r,) of a face (n, 3) on the rims of one opening, and the shifts (r, 3) to the rims of another one.

    Takes a first displacement (n, 3), and the column at the inner corner of an eye: the first, 0, or the last, -1. The
    shifts are perpendicular to the direction forward. Both arrays are empty if the areas of the openings differ too
    much.
    """
    if not 1 / MAX_RATIO < there.area / here.area < MAX_RATIO:
        return np.empty(0, dtype=np.int64), np.empty((0, 3))
    across, height, depth = (vertices @ axis for axis in (head.left, head.up, head.forward))
    is_upper, rim = height > here.middle_at(across), RIM * head.size
    own_ends, other_ends = (opening.across[[0, -1]] for opening in (here, there))
    on_rim = (across > own_ends[0] - rim) & (across < own_ends[1] + rim)
    on_rim &= np.abs(height - here.rim_at(across, is_upper)) < rim
    on_rim &= np.abs(depth - np.interp(across, here.across, here.depth)) < 2 * rim
    chosen = np.flatnonzero(on_rim)
    at_inner = chosen[np.abs(across[chosen] - own_ends[inner]) < rim]
    if len(at_inner):
        # The socket is shallow beside the nose, so that openings of two persons end at different places there. The
        # displacement is no less exact, and its errors are independent.
        moved = own_ends[inner] + displacement[at_inner].mean(axis=0) @ head.left
        other_ends[inner] = (other_ends[inner] + moved) / 2
    share = np.clip((across[chosen] - own_ends[0]) / np.ptp(own_ends), 0, 1)
    own, other = (ends[0] + share * (ends[1] - ends[0]) for ends in (own_ends, other_ends))
    rise = there.rim_at(other, is_upper[chosen]) - here.rim_at(own, is_upper[chosen])
    return chosen, (other - own)[:, None] * head.left + rise[:, None] * head.up
