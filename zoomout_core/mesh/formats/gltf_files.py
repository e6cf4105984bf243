# SPDX-License-Identifier: GPL-3.0-or-later
"""The JSON and the buffers of glTF and GLB files, checked so that nothing in them refers to what does not exist.

The tables below follow the specification of glTF 2.0. A path such as `nodes[].children[]` leads to each item of each
list; `*` leads to each value of an object.
"""

from __future__ import annotations

import json
import math
from base64 import b64decode
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from zoomout_core.mesh.formats.compression.decompress_gltf import DRACO, MESHOPT, MODES, decompress_gltf
from zoomout_core.mesh.formats.compression.meshopt_filters import STRIDES
from zoomout_core.mesh.formats.glb import MAGIC, unpack_glb
from zoomout_core.mesh.formats.opening import file_bytes, outside, shown
from zoomout_core.mesh.surface import MeshError
from zoomout_core.runtime.input_files import FormatError, OutsideError, beside, read_whole, reason_of

# The size in bytes of each type of number, and the numbers of each type of element.
COMPONENT_SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
UNSIGNED = (5121, 5123, 5125)
# Elements that a file may have in memory, if its own bytes are fewer: nodes may share meshes, and primitives accessors.
MAX_ELEMENTS = 1 << 25

# Parts that a file may have, each of which takes a millisecond to read.
MAX_PARTS = 100_000
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
TABLES = sorted({"animations", "accessors", "images", "meshes", *REFERENCES.values()})
PARTS = (
    *(f"{table}[]" for table in TABLES),
    "animations[].channels[]",
    "animations[].samplers[]",
    "meshes[].primitives[]",
)
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
VECTORS = {
    "nodes[].matrix": 16,
    "nodes[].rotation": 4,
    "nodes[].scale": 3,
    "nodes[].translation": 3,
    "materials[].pbrMetallicRoughness.baseColorFactor": 4,
}
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
CHOICES: dict[str, Container[object]] = {
    "accessors[].componentType": COMPONENT_SIZES,
    "accessors[].type": WIDTHS,
    "accessors[].sparse.indices.componentType": UNSIGNED,
    "meshes[].primitives[].mode": range(7),
    **{f"{view}.mode": MODES for view in OF_MESHOPT},
    **{f"{view}.filter": tuple(STRIDES) for view in OF_MESHOPT},
}
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
NUMBERS = ("meshes[].weights[]", "nodes[].weights[]")
SWITCHES = ("accessors[].normalized",)


@dataclass(frozen=True, eq=False)
class GltfFile:
    """A checked file.

    Attributes:
        tree: its JSON.
        buffers: the content of its buffers.
        path: its path.
        folders: further folders in which its buffers and images may be.
    """

    tree: dict[str, Any]
    buffers: tuple[bytes, ...]
    path: Path
    folders: tuple[Path, ...] = ()

    def read_uri(self, uri: str) -> bytes:
        """The bytes of a URI: embedded data, or a file beside this one.

        Raises:
            OutsideError: the file is outside the folders.
            OSError: the file is missing or cannot be read.
            ValueError: the embedded data is damaged.
        """
        if uri.startswith("data:"):
            return data_of(uri)
        return read_whole(beside(unquote(uri), self.path.parent, self.folders))


def read_gltf_file(path: Path, folders: Iterable[Path] = ()) -> GltfFile:
    """Read a glTF or GLB file.

    Args:
        path: the file.
        folders: further folders in which its buffers and images may be.

    Raises:
        MeshError: it cannot be opened, it contradicts the specification, or a buffer cannot be read.
        ImportError: a package that decompresses it is not installed.
    """
    try:
        tree, binary = parse_gltf(file_bytes(path))
    except MeshError:
        raise
    except ValueError as error:
        raise _damage_error(path, error) from error
    file = GltfFile(tree, (), path, tuple(folders))
    buffers = _buffers(file, binary)
    try:
        buffers = decompress_gltf(tree, buffers)
        _check_views(tree, buffers)
    except FormatError as error:
        raise _damage_error(path, error) from error
    return GltfFile(tree, buffers, path, file.folders)


def parse_gltf(content: bytes) -> tuple[dict[str, Any], bytes]:
    """The checked JSON of a glTF or GLB file, and the binary data of a GLB file.

    Raises:
        ValueError: it is damaged, or contradicts the specification.
    """
    text, binary = unpack_glb(content) if content.startswith(MAGIC) else (content, b"")
    try:
        tree = json.loads(
            text.decode("utf-8-sig"), object_hook=_without_nulls, parse_constant=_finite, parse_float=_finite
        )
    except RecursionError:
        raise FormatError("it is nested too deeply") from None
    except UnicodeDecodeError:
        raise FormatError("its JSON is not UTF-8 text") from None
    except json.JSONDecodeError as error:
        raise FormatError(f"its JSON is damaged in line {error.lineno}, column {error.colno}") from None
    check_structure(tree, len(content))
    return tree, binary


def _without_nulls(part: dict[str, Any]) -> dict[str, Any]:
    """A JSON object without its null values, which mean missing ones."""
    return {name: value for name, value in part.items() if value is not None}


def _finite(text: str) -> float:
    """A number of JSON, which has no infinite ones."""
    value = float(text)
    if not math.isfinite(value):
        raise FormatError(f"it contains the number {text}")
    return value


def data_of(uri: str) -> bytes:
    """The bytes that a data URI contains.

    Raises:
        ValueError: they are damaged.
    """
    head, _, data = uri.partition(",")
    if not head.endswith(";base64"):
        return unquote_to_bytes(data)
    try:
        return b64decode(data)
    except ValueError as error:  # also of characters beyond ASCII
        raise FormatError("its embedded data is damaged") from error


def named_uris(tree: Any, tables: Iterable[str] = ("buffers", "images")) -> list[str]:
    """The names of the files to which the JSON of a glTF file refers."""
    return [uri for table in tables for uri in _values(tree, f"{table}[].uri") if not uri.startswith("data:")]


def _buffers(file: GltfFile, binary: bytes) -> tuple[bytes, ...]:
    """The content of all buffers; one that several entries name is read once."""
    read: dict[str, bytes] = {}
    for uri in dict.fromkeys(_values(file.tree, "buffers[].uri")):
        try:
            read[uri] = file.read_uri(uri)
        except OutsideError as error:
            raise outside(file.path, uri) from error
        except OSError as error:
            raise MeshError(
                "{path} refers to {name}, which could not be opened ({reason}): put it beside the file.",
                path=file.path,
                name=shown(uri),
                reason=error.strerror,
            ) from error
        except ValueError as error:
            raise _damage_error(file.path, error) from error
    return tuple(read.get(each.get("uri"), binary) for each in file.tree.get("buffers") or [])


def _damage_error(path: Path, error: ValueError) -> MeshError:
    reason = reason_of(error)
    return MeshError(f"{path} could not be read ({reason}): check that the file is complete, or export it again.")


# --- the structure ------------------------------------------------------------------------------------------


def check_structure(tree: Any, size: int = 0) -> None:
    """Check the JSON of a file: its types, the numbers by which it refers to its parts, and its tree of nodes.

    Args:
        tree: the JSON.
        size: bytes of the file.

    Raises:
        FormatError: it contradicts the specification.
    """
    parts = sum(1 for path in PARTS for _ in _values(tree, path))
    if parts > MAX_PARTS:
        raise FormatError(f"it has {parts} nodes, channels and other parts, and {MAX_PARTS} are allowed")
    _check_values(tree, (*OBJECTS, *(f"{table}[]" for table in TABLES)), _is_object, "an object")
    _check_values(tree, TEXTS, _is_text, "text")
    _check_values(tree, COUNTS, _is_count, "a number from 0")
    _check_values(tree, ("accessors[].count",), _is_positive, "a number from 1")
    _check_values(tree, NUMBERS, _is_finite, "a number")
    _check_values(tree, SWITCHES, _is_switch, "true or false")
    for path, width in VECTORS.items():
        _check_values(tree, (path,), partial(_is_vector, width), f"{width} numbers")
    for path, choices in CHOICES.items():
        _check_values(tree, (path,), partial(_is_choice, choices), "a value of the specification")
    for path, names in REQUIRED.items():
        for value in _values(tree, path):
            for name in names:
                _expect(_is_object(value) and name in value, path, value, f"an object with {name}")
    for path, table in REFERENCES.items():
        count = len(tree.get(table) or [])
        _check_values(tree, (path,), partial(_is_below, count), f"one of the {count} {table}")
    for animation in tree.get("animations") or []:
        count = len(animation["samplers"])
        _check_values(animation, ("channels[].sampler",), partial(_is_below, count), f"one of the {count} samplers")
    _check_tree_of_nodes(tree.get("nodes") or [])
    _check_types(tree)
    _check_elements(tree, size)
    _check_accessors(tree)


def _check_values(part: Any, paths: Iterable[str], is_right: Callable[[Any], bool], wanted: str) -> None:
    """Check the values at some paths; `wanted` describes the right ones."""
    for path in paths:
        for value in _values(part, path):
            _expect(is_right(value), path, value, wanted)


def _values(part: Any, path: str, whole: str = "") -> Iterator[Any]:
    """The values at a path; missing ones are skipped.

    Args:
        part: the object, list or value where the path begins.
        path: the path.
        whole: the path from the root, for errors.
    """
    whole = whole or path
    above = whole.removesuffix(path).rstrip(".") or "the file"
    name, _, rest = path.partition(".")
    if not path:
        yield part
    elif name == "[]":
        _expect(isinstance(part, list), above, part, "a list")
        for each in part:
            yield from _values(each, rest, whole)
    elif name == "*":
        _expect(isinstance(part, dict), above, part, "an object")
        for each in part.values():
            yield from _values(each, rest, whole)
    else:
        _expect(isinstance(part, dict), above, part, "an object")
        name = name.removesuffix("[]")
        if name in part:
            yield from _values(part[name], path.removeprefix(name).removeprefix("."), whole)


def _expect(is_right: bool, path: str, value: Any, wanted: str) -> None:
    if not is_right:
        found = json.dumps(value, default=str)
        shown = found if len(found) <= 40 else f"{found[:37]}..."
        raise FormatError(f"{path.replace('[]', '')} is {shown}, not {wanted}")


def _is_object(value: Any) -> bool:
    return isinstance(value, dict)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_switch(value: Any) -> bool:
    return isinstance(value, bool)


def _is_choice(choices: Container[object], value: Any) -> bool:
    return isinstance(value, int | str) and value in choices


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_positive(value: Any) -> bool:
    return _is_count(value) and value > 0


def _is_below(count: int, value: Any) -> bool:
    return _is_count(value) and value < count


def _is_vector(width: int, value: Any) -> bool:
    return isinstance(value, list) and len(value) == width and all(map(_is_finite, value))


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf and _is_float(value)


def _is_float(value: int | float) -> bool:
    try:
        return math.isfinite(float(value))
    except OverflowError:  # an integer of hundreds of digits
        return False


def _check_tree_of_nodes(nodes: list[dict[str, Any]]) -> None:
    """Check that each node has one parent at most, and that none is its own ancestor."""
    parent: dict[int, int] = {}
    for number, node in enumerate(nodes):
        for child in node.get("children") or []:
            if child in parent:
                raise FormatError(f"node {child} is a child of nodes {parent[child]} and {number}")
            parent[child] = number
    waiting = [number for number in range(len(nodes)) if number not in parent]
    visited = len(waiting)
    while waiting:
        children = nodes[waiting.pop()].get("children") or []
        visited += len(children)
        waiting.extend(children)
    if visited < len(nodes):
        raise FormatError("some of its nodes are their own ancestors")


def _check_types(tree: dict[str, Any]) -> None:
    """Check that the values of vertices, corners and joints have the types and the numbers that they need."""
    accessors = tree.get("accessors") or []
    for number, mesh in enumerate(tree.get("meshes") or []):
        for primitive in mesh["primitives"]:
            _check_primitive(accessors, primitive, f"mesh {number}")
    for number, skin in enumerate(tree.get("skins") or []):
        if (matrices := skin.get("inverseBindMatrices")) is not None:
            name, joints = "inverseBindMatrices", len(skin["joints"])
            _check_type(accessors[matrices], ("MAT4",), joints, f"{name} of skin {number}")


def _check_primitive(accessors: list[dict[str, Any]], primitive: dict[str, Any], owner: str) -> None:
    """Check the accessors of a primitive, which its owner names in errors."""
    position = primitive["attributes"].get("POSITION")
    count = None if position is None else accessors[position]["count"]
    for attributes in (primitive["attributes"], *(primitive.get("targets") or [])):
        for name, number in attributes.items():
            for known, types in ATTRIBUTE_TYPES.items():
                if name.startswith(known):
                    _check_type(accessors[number], types, count, f"{name} of {owner}")
    if primitive.get("indices") is not None:
        _check_type(accessors[primitive["indices"]], ("SCALAR",), None, f"indices of {owner}")


def _check_type(accessor: dict[str, Any], types: Sequence[str], count: int | None, name: str) -> None:
    """Check the type of an accessor's elements, and their number unless it is None."""
    if accessor["type"] not in types:
        raise FormatError(f"{name} has elements of type {accessor['type']}, not {' or '.join(types)}")
    if count is not None and accessor["count"] != count:
        raise FormatError(f"{name} has {accessor['count']} elements, and {count} are needed")


def _check_elements(tree: dict[str, Any], size: int) -> None:
    """Check how many elements the accessors have, and the meshes of all nodes together."""
    accessors = tree.get("accessors") or []
    total = sum(each["count"] for each in accessors)
    of_mesh = []
    for mesh in tree.get("meshes") or []:
        numbers = [number for path in ("attributes.*", "targets[].*", "indices") for number in _in(mesh, path)]
        of_mesh.append(sum(accessors[number]["count"] for number in numbers))
    total = max(total, sum(of_mesh[node["mesh"]] for node in tree.get("nodes") or [] if node.get("mesh") is not None))
    most = max(MAX_ELEMENTS, size)
    if total > most:
        raise FormatError(f"its meshes and accessors have {total} elements in all, and {most} are allowed")


def _check_accessors(tree: dict[str, Any]) -> None:
    """Check that the elements of accessors are within their views."""
    views = tree.get("bufferViews") or []
    for number, accessor in enumerate(tree.get("accessors") or []):
        count, width = accessor["count"], COMPONENT_SIZES[accessor["componentType"]] * WIDTHS[accessor["type"]]
        parts = [(accessor, count, width)]
        sparse = accessor.get("sparse")
        if sparse is not None:
            if sparse["count"] > count:
                raise FormatError(f"accessor {number} changes {sparse['count']} of {count} elements")
            size = COMPONENT_SIZES[sparse["indices"]["componentType"]]
            parts += [(sparse["indices"], sparse["count"], size), (sparse["values"], sparse["count"], width)]
        for part, elements, size in parts:
            if part.get("bufferView") is None or not elements:
                continue
            view = views[part["bufferView"]]
            stride = (view.get("byteStride") or size) if part is accessor else size
            if (part.get("byteOffset") or 0) + stride * (elements - 1) + size > view["byteLength"]:
                raise FormatError(f"accessor {number} has more elements than its view")


def _check_views(tree: dict[str, Any], buffers: Sequence[bytes]) -> None:
    """Check that views are within their buffers, and that sparse accessors change elements that they have."""
    views = tree.get("bufferViews") or []
    for number, view in enumerate(views):
        if (view.get("byteOffset") or 0) + view["byteLength"] > len(buffers[view["buffer"]]):
            raise FormatError(f"view {number} ends after its buffer")
    for number, accessor in enumerate(tree.get("accessors") or []):
        sparse = accessor.get("sparse")
        if sparse is not None:
            indices = sparse["indices"]
            view = views[indices["bufferView"]]
            start = (view.get("byteOffset") or 0) + (indices.get("byteOffset") or 0)
            kind = f"<u{COMPONENT_SIZES[indices['componentType']]}"
            changed = np.frombuffer(buffers[view["buffer"]], kind, sparse["count"], start)
            if changed.max(initial=0) >= max(accessor["count"], 1):
                raise FormatError(f"accessor {number} changes element {changed.max()} of {accessor['count']}")


def _in(mesh: dict[str, Any], path: str) -> Iterator[int]:
    return _values(mesh, f"primitives[].{path}")
