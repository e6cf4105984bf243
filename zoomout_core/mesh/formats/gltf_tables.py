# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of the specification of glTF 2.0: the values of its JSON, and the tables that they refer to.

A path such as `nodes[].children[]` leads to each item of each list; `*` leads to each value of an object.
"""

from __future__ import annotations

from collections.abc import Container

from zoomout_core.mesh.formats.compression.decompress_gltf import DRACO, MESHOPT, MODES
from zoomout_core.mesh.formats.compression.meshopt_filters import STRIDES

# The size in bytes and numpy's code of each type of number, and the count of numbers of each type of element.
COMPONENT_SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
COMPONENT_TYPES = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
FLOATS = 5126
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
UNSIGNED = (5121, 5123, 5125)
# The types of elements that each attribute of a vertex may have, by the beginning of its name.
ATTRIBUTE_TYPES = {
    "POSITION": ("VEC3",),
    "NORMAL": ("VEC3",),
    "TEXCOORD_": ("VEC2",),
    "COLOR_": ("VEC3", "VEC4"),
    "JOINTS_": ("VEC4",),
    "WEIGHTS_": ("VEC4",),
}

# Where compressed data is described.
OF_DRACO = f"meshes[].primitives[].extensions.{DRACO}"
OF_MESHOPT = tuple(f"bufferViews[].extensions.{name}" for name in MESHOPT)
# The table that each number refers to.
REFERENCES = {
    "scene": "scenes",
    "scenes[].nodes[]": "nodes",
    "nodes[].children[]": "nodes",
    "nodes[].mesh": "meshes",
    "nodes[].skin": "skins",
    "nodes[].camera": "cameras",
    "nodes[].extensions.EXT_mesh_gpu_instancing.attributes.*": "accessors",
    "meshes[].primitives[].attributes.*": "accessors",
    "meshes[].primitives[].targets[].*": "accessors",
    "meshes[].primitives[].indices": "accessors",
    "meshes[].primitives[].material": "materials",
    "skins[].joints[]": "nodes",
    "skins[].skeleton": "nodes",
    "skins[].inverseBindMatrices": "accessors",
    "animations[].samplers[].input": "accessors",
    "animations[].samplers[].output": "accessors",
    "animations[].channels[].target.node": "nodes",
    "accessors[].bufferView": "bufferViews",
    "accessors[].sparse.indices.bufferView": "bufferViews",
    "accessors[].sparse.values.bufferView": "bufferViews",
    "bufferViews[].buffer": "buffers",
    "images[].bufferView": "bufferViews",
    "textures[].source": "images",
    "textures[].sampler": "samplers",
    "textures[].extensions.*.source": "images",
    "materials[].pbrMetallicRoughness.baseColorTexture.index": "textures",
    "materials[].pbrMetallicRoughness.metallicRoughnessTexture.index": "textures",
    "materials[].normalTexture.index": "textures",
    "materials[].occlusionTexture.index": "textures",
    "materials[].emissiveTexture.index": "textures",
    "meshes[].primitives[].extensions.KHR_materials_variants.mappings[].material": "materials",
    f"{OF_DRACO}.bufferView": "bufferViews",
    **{f"{view}.buffer": "buffers" for view in OF_MESHOPT},
}
# Lists of the root.
TABLES = sorted({"animations", "accessors", "images", "meshes", *REFERENCES.values()})
# Parts that are counted against the limit.
PARTS = (
    *(f"{table}[]" for table in TABLES),
    "animations[].channels[]",
    "animations[].samplers[]",
    "meshes[].primitives[]",
)
# Whole numbers from 0.
COUNTS = (
    "accessors[].byteOffset",
    "accessors[].sparse.count",
    "accessors[].sparse.indices.byteOffset",
    "accessors[].sparse.values.byteOffset",
    "bufferViews[].byteLength",
    "bufferViews[].byteOffset",
    "bufferViews[].byteStride",
    f"{OF_DRACO}.attributes.*",
    *(f"{view}.{name}" for view in OF_MESHOPT for name in ("byteLength", "byteOffset", "byteStride", "count")),
)
# Lists of numbers, and their lengths.
VECTORS = {
    "nodes[].matrix": 16,
    "nodes[].rotation": 4,
    "nodes[].scale": 3,
    "nodes[].translation": 3,
    "materials[].pbrMetallicRoughness.baseColorFactor": 4,
}
# Strings.
TEXTS = (
    "accessors[].type",
    "animations[].name",
    "animations[].channels[].target.path",
    "buffers[].uri",
    "extensionsRequired[]",
    "extensionsUsed[]",
    "images[].mimeType",
    "images[].name",
    "images[].uri",
    "materials[].name",
    "meshes[].name",
    "nodes[].name",
    "skins[].name",
)
# Names that an object must have.
REQUIRED = {
    "accessors[]": ("componentType", "count", "type"),
    "accessors[].sparse": ("count", "indices", "values"),
    "accessors[].sparse.indices": ("bufferView", "componentType"),
    "accessors[].sparse.values": ("bufferView",),
    "animations[]": ("channels", "samplers"),
    "animations[].channels[]": ("sampler", "target"),
    "animations[].samplers[]": ("input", "output"),
    "bufferViews[]": ("buffer", "byteLength"),
    "materials[].pbrMetallicRoughness.baseColorTexture": ("index",),
    "meshes[]": ("primitives",),
    "meshes[].primitives[]": ("attributes",),
    "skins[]": ("joints",),
    OF_DRACO: ("attributes", "bufferView"),
    **dict.fromkeys(OF_MESHOPT, ("buffer", "byteLength", "byteStride", "count", "mode")),
}
# Values that are allowed.
CHOICES: dict[str, Container[object]] = {
    "accessors[].componentType": COMPONENT_SIZES,
    "accessors[].type": WIDTHS,
    "accessors[].sparse.indices.componentType": UNSIGNED,
    "meshes[].primitives[].mode": range(7),
    **{f"{view}.mode": MODES for view in OF_MESHOPT},
    **{f"{view}.filter": tuple(STRIDES) for view in OF_MESHOPT},
}
# Objects, besides those of `TABLES`.
OBJECTS = (
    "asset",
    "extensions",
    "accessors[].sparse",
    "animations[].channels[].target",
    "animations[].channels[].target.extensions",
    "animations[].channels[].target.extensions.KHR_animation_pointer",
    "materials[].pbrMetallicRoughness",
    "meshes[].primitives[].extensions",
    OF_DRACO,
    f"{OF_DRACO}.attributes",
    *OF_MESHOPT,
    *(f"{table}[].extensions" for table in TABLES),
)
# Finite numbers.
NUMBERS = ("meshes[].weights[]", "nodes[].weights[]")
# Booleans.
SWITCHES = ("accessors[].normalized",)
