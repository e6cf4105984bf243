# SPDX-License-Identifier: GPL-3.0-or-later
"""Bend along arcs, which nearly preserves distances along a surface."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats


def bend_along_arc(across: Floats, angle: Floats, radius: float, middle: float = 0.0) -> tuple[Floats, Floats]:
    """Bend points as a straight line becomes an arc of constant curvature; cross sections stay plane.

    Each point is given by its distance (n,) from the line towards the arc's centre, and by the angle (n,) of its
    section, in radians from the start of the arc. The line itself is at `middle`.

    Returns:
        (n,) coordinates along the line's first direction, from the start of the arc, and (n,) across it.
    """
    reach = radius - (across - middle)
    return reach * np.sin(angle), middle + radius - reach * np.cos(angle)
