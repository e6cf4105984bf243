# SPDX-License-Identifier: GPL-3.0-or-later
"""World matrices of objects, in double precision.

Blender stores positions and matrices in single precision, with steps of 0.06 at a million units from the world's
origin. Positions are relative to their object, so sums in double precision lose nothing there.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from bpy.types import Object

from zoomout_core.arrays import Floats

# Maximum rounding error of an entry of a matrix product in single precision, per factor, over the sum of the absolute
# values of its terms.
ROUNDING = 4 * float(np.finfo(np.float32).eps)
# Types of parents that move an object by their matrix alone.
BY_MATRIX = frozenset({"OBJECT", "ARMATURE"})


def world_matrix(obj: Object) -> Floats:
    """(4, 4) from an object's own space to world space, as the product of its own and its parents' matrices.

    If anything else moves the object, such as constraints, a parent bone or vertices, or physics, it is Blender's own
    matrix, in single precision.
    """
    seen = np.array(obj.matrix_world, np.float64)
    parts = _parts(obj)
    product = reduce(np.matmul, parts)
    most = ROUNDING * len(parts) * reduce(np.matmul, [np.abs(part) for part in parts])
    return product if (np.abs(product - seen) <= most).all() else seen


def transform_points(matrix: Floats, positions: Floats) -> Floats:
    """Positions (..., 3), transformed by a matrix (4, 4)."""
    with np.errstate(invalid="ignore"):  # positions that are not finite are rejected by surfaces
        return np.asarray(positions @ matrix[:3, :3].T + matrix[:3, 3])


def _parts(obj: Object) -> list[Floats]:
    """The matrices (4, 4) whose product is an object's world matrix; only that if something else moves it."""
    if obj.constraints or (obj.parent is not None and obj.parent_type not in BY_MATRIX):
        return [np.array(obj.matrix_world, np.float64)]
    own = np.array(obj.matrix_basis, np.float64)
    if obj.parent is None:
        return [own]
    return [*_parts(obj.parent), np.array(obj.matrix_parent_inverse, np.float64), own]
