"""What users write of a match in words and text files: how to begin, directions, landmarks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from zoomout_core.arrays import Floats, RealsOrIntegers
from zoomout_core.matching.constraints import checked_axes
from zoomout_core.mesh.surface import MeshError

STARTS = ("auto", "landmarks", "proximity")
AXES = {"x": "1,0,0", "y": "0,1,0", "z": "0,0,1", "-x": "-1,0,0", "-y": "0,-1,0", "-z": "0,0,-1"}


def read_axis(text: str, option: str = "--common-axis") -> Floats:
    """The direction (3,) that `x`, `-y` or three numbers with commas stand for, of unit length.

    Raises:
        MeshError: it is no direction.
    """
    try:
        return checked_axes([float(number) for number in AXES.get(text.lower(), text).split(",")])[0]
    except ValueError:
        raise MeshError(f"{option} is {text!r}: give x, -x, y, -y, z, -z, or a direction such as 0,0,1.") from None


def read_landmarks(path: str) -> tuple[RealsOrIntegers, RealsOrIntegers]:
    """Source and target vertices (m,), or points (m, 3), from a text file with a pair a line.

    Raises:
        MeshError: a line is neither a pair of vertex numbers nor one of points, or unlike the others.
    """
    try:
        lines = [line.partition("#")[0].split() for line in Path(path).read_text(encoding="utf-8").splitlines()]
        rows = list(filter(None, lines))
        columns = 6 if len(rows[0]) == 6 else 2
        table = np.array(rows).reshape(len(rows), columns).astype(np.float64 if columns == 6 else np.int64)
    except (ValueError, OverflowError, IndexError):
        raise MeshError(
            f"{path} is no list of landmarks: give two vertex numbers a line, source and target, or six coordinates, "
            "of a point on the source and of one on the target."
        ) from None
    source, target = np.split(table, 2, axis=1)
    return (source, target) if columns == 6 else (source[:, 0], target[:, 0])
