# SPDX-License-Identifier: GPL-3.0-or-later
"""The directions of a head, computed from the positions of its eyes and mouth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import SMALLEST


@dataclass(frozen=True, eq=False)
class HeadDirections:
    """Orthogonal unit vectors (3,) of a head, and the distance between its eyes."""

    left: Floats
    up: Floats
    forward: Floats
    size: float

    @classmethod
    def of(cls, left_eye: Floats, right_eye: Floats, mouth: Floats) -> HeadDirections:
        """The directions of a head from the positions (3,) of both eyes and the mouth."""
        across = left_eye - right_eye
        size = float(np.linalg.norm(across))
        left = across / max(size, SMALLEST)
        up = (left_eye + right_eye) / 2 - mouth
        up = up - (up @ left) * left
        up /= max(float(np.linalg.norm(up)), SMALLEST)
        return cls(left, up, np.cross(left, up), size)
