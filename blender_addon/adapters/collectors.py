# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions that choose the data of a transfer, one for each type."""

from __future__ import annotations

from collections.abc import Callable

from . import edges, layers, materials, normals, shape_keys, vertex_groups
from .adapter import Adapter, Remarks, TransferRequest

# In the order of reading and writing. Normals come after edges and faces, because their storage depends on which of
# these are sharp. Shape keys come last: reading them evaluates copies, which may invalidate meshes that were evaluated
# before.
COLLECTORS: tuple[Callable[[TransferRequest, Remarks], list[Adapter]], ...] = (
    layers.collect,
    edges.collect,
    vertex_groups.collect,
    materials.collect,
    normals.collect,
    shape_keys.collect,
)
