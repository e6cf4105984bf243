# SPDX-License-Identifier: GPL-3.0-or-later
"""Check the JSON of glTF files: values, types, and references to other parts."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from zoomout_core.mesh.formats.gltf_tables import (
    ATTRIBUTE_TYPES,
    CHOICES,
    COMPONENT_SIZES,
    COUNTS,
    NUMBERS,
    OBJECTS,
    PARTS,
    REFERENCES,
    REQUIRED,
    SWITCHES,
    TABLES,
    TEXTS,
    VECTORS,
    WIDTHS,
)
from zoomout_core.runtime.input_files import FormatError

# Elements that a file may have in memory, if its own bytes are fewer: nodes may share meshes, and primitives accessors.
MAX_ELEMENTS = 1 << 25
# Maximum number of parts of a file: each takes a millisecond to read.
MAX_PARTS = 100_000


def check_structure(tree: Any, size: int) -> None:
    """Check the JSON of a file: its types, the numbers by which it refers to its parts, and its tree of nodes.

    Args:
        tree: the JSON.
        size: the size of the file in bytes, which limits the number of elements.

    Raises:
        FormatError: it contradicts the specification.
    """
    parts = sum(1 for path in PARTS for _ in values_at(tree, path))
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
        for value in values_at(tree, path):
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
        for value in values_at(part, path):
            _expect(is_right(value), path, value, wanted)


def values_at(part: Any, path: str, whole: str = "") -> Iterator[Any]:
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
            yield from values_at(each, rest, whole)
    elif name == "*":
        _expect(isinstance(part, dict), above, part, "an object")
        for each in part.values():
            yield from values_at(each, rest, whole)
    else:
        _expect(isinstance(part, dict), above, part, "an object")
        name = name.removesuffix("[]")
        if name in part:
            yield from values_at(part[name], path.removeprefix(name).removeprefix("."), whole)


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
        paths = (f"primitives[].{name}" for name in ("attributes.*", "targets[].*", "indices"))
        of_mesh.append(sum(accessors[number]["count"] for path in paths for number in values_at(mesh, path)))
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


def check_views(tree: dict[str, Any], buffers: Sequence[bytes]) -> None:
    """Check that views are within their buffers, and that sparse accessors change elements that they have.

    Args:
        tree: the checked JSON.
        buffers: the contents of its buffers.

    Raises:
        FormatError: they contradict each other.
    """
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
