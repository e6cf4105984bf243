# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of a dressed avatar: from the front, from the back, and in two poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zoomout_core.arrays import Booleans, Bytes, Floats, Integers
from zoomout_core.colors import BAD_TO_GOOD
from zoomout_core.drawing import draw_upright
from zoomout_core.outfits.check import REST, CheckedOutfit

# Pixels of a picture.
WIDTH, HEIGHT = 200, 320
# Degrees by which the view of poses is rotated to the side.
YAW = 25.0
# Colours of skin, and of the worn objects in turn; red marks cloth in the skin.
SKIN = np.array([0.86, 0.72, 0.63])
WORN = np.array([[0.30, 0.45, 0.70], [0.75, 0.70, 0.50], [0.35, 0.55, 0.40], [0.45, 0.38, 0.55], [0.30, 0.30, 0.33]])
MARK = BAD_TO_GOOD[0]


def draw_outfit(
    checked: CheckedOutfit, triangles: tuple[Integers, Integers], counts: Sequence[int], front: float = 0.0
) -> Bytes:
    """Draw an avatar from the front and back, and in each pose, side by side.

    Args:
        checked: the body and the clothes in each pose.
        triangles: triangles of the body and of the clothes, each with its own vertex numbers.
        counts: the number of vertices of each worn object.
        front: degrees about the vertical axis from z to the direction that the avatar faces.

    Returns:
        (height, width, 3) pixels, rows from top to bottom.
    """
    poses = [(REST, 0.0), (REST, 180.0), *((pose, YAW) for pose in checked.bodies if pose != REST)]
    first = len(checked.bodies[REST])
    whole = np.concatenate([triangles[0], triangles[1] + first])
    return np.concatenate([_draw(checked, pose, yaw - front, whole, counts) for pose, yaw in poses], axis=1)


def _draw(checked: CheckedOutfit, pose: str, yaw: float, triangles: Integers, counts: Sequence[int]) -> Bytes:
    """Draw a pose, rotated about the vertical axis by some degrees."""
    body, cloth = checked.bodies[pose], checked.clothes[pose]
    colors = np.concatenate([np.tile(SKIN, (len(body), 1)), _colors(checked.marks[pose], counts)])
    return draw_upright(np.concatenate([body, cloth]), triangles, colors, yaw, WIDTH, HEIGHT)


def _colors(marked: Booleans, counts: Sequence[int]) -> Floats:
    """(n, 3) colours of the cloth."""
    colors = WORN[np.repeat(np.arange(len(counts)) % len(WORN), counts)]
    return np.where(marked[:, None], MARK, colors)
