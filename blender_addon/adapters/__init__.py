# SPDX-License-Identifier: GPL-3.0-or-later
"""Adapters between Blender's data and the core: a module for each kind, whose `collect` chooses what is transferred."""

from __future__ import annotations

from collections.abc import Callable

from . import edges, layers, materials, normals, shape_keys, vertex_groups
from .adapter import Adapter, Remarks, TransferJob, TransferRequest
from .scheduling import transfer_all
from .settings import DEFAULT, FILL_BELOW, Binding, Settings, parse_group_names, parse_names
from .shape_keys import check_takes_keys

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

# The kinds of data that can be chosen, by their names in options and reports, with singular and plural.
NOUNS = {
    "uv_maps": ("{count} UV map", "{count} UV maps"),
    "color_attributes": ("{count} color attribute", "{count} color attributes"),
    "attributes": ("{count} attribute", "{count} attributes"),
    "vertex_groups": ("{count} vertex group", "{count} vertex groups"),
    "shape_keys": ("{count} shape key", "{count} shape keys"),
    "materials": ("{count} material", "{count} materials"),
    "edges": ("{count} kind of edge mark", "{count} kinds of edge marks"),
    "custom_normals": ("{count} layer of custom normals", "{count} layers of custom normals"),
    "shape": ("{count} shape", "{count} shapes"),
}
DATA = tuple(NOUNS)
# Kinds that are transferred by default. The source's shape is not: a target has its own.
USUAL_DATA = tuple(kind for kind in DATA if kind != "shape")

__all__ = [
    "COLLECTORS",
    "DATA",
    "DEFAULT",
    "FILL_BELOW",
    "NOUNS",
    "USUAL_DATA",
    "Adapter",
    "Binding",
    "Remarks",
    "Settings",
    "TransferJob",
    "TransferRequest",
    "check_takes_keys",
    "parse_group_names",
    "parse_names",
    "transfer_all",
]
