# SPDX-License-Identifier: GPL-3.0-or-later
"""The kinds of data that can be chosen."""

from __future__ import annotations

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
