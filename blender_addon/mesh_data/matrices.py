# SPDX-License-Identifier: GPL-3.0-or-later
"""Where objects stand in the world, in double precision.

Blender keeps positions and matrices in single precision: at a million units from the world's origin these are 0.06
apart. What lies there is read relative to its object, so that nothing is lost as long as sums are in double precision.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from bpy.types import Object

from zoomout_core.arrays import Floats

# What an entry of a product of matrices may be off by in single precision, for each factor, over what its terms add up
# to without their signs.
ROUNDING = 4 * float(np.finfo(np.float32).eps)
# How an object hangs from its parent's matrix alone.
BY_MATRIX = frozenset({"OBJECT", "ARMATURE"})


def world_matrix(obj: Object) -> Floats:
    """(4, 4) from an object's own space into the world's, as the product of its own and its parents' matrices.

    It is Blender's product, in single precision, where something else moves the object: constraints, the bone or the
    vertices that it hangs from, or physics.
    """
    seen = np.array(obj.matrix_world, np.float64)
    parts = _parts(obj)
    product = reduce(np.matmul, parts)
    most = ROUNDING * len(parts) * reduce(np.matmul, [np.abs(part) for part in parts])
    return product if (np.abs(product - seen) <= most).all() else seen


def transform_points(matrix: Floats, positions: Floats) -> Floats:
    """Positions (..., 3), moved by a matrix (4, 4)."""
    with np.errstate(invalid="ignore"):  # of positions that are not finite, which surfaces refuse
        return np.asarray(positions @ matrix[:3, :3].T + matrix[:3, 3])


def _parts(obj: Object) -> list[Floats]:
    """The matrices (4, 4) whose product moves an object to where it is, if nothing else does."""
    if obj.constraints or (obj.parent is not None and obj.parent_type not in BY_MATRIX):
        return [np.array(obj.matrix_world, np.float64)]
    own = np.array(obj.matrix_basis, np.float64)
    if obj.parent is None:
        return [own]
    return [*_parts(obj.parent), np.array(obj.matrix_parent_inverse, np.float64), own]
