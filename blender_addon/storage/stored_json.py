# SPDX-License-Identifier: GPL-3.0-or-later
"""Descriptions stored on meshes as JSON, which may be damaged, or changed by other scripts."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, TypeAlias

from bpy.types import Mesh

from zoomout_core.messages import from_json

# The kind of a value: a type; of a dictionary the kinds of its entries, which are required unless they may be None; of
# a list the kind of all elements, or the kind of each; a tuple for one of several kinds, None for a missing value.
Kind: TypeAlias = "type | Mapping[str, Kind] | list[Kind] | tuple[Kind, ...] | None"


def read_json(mesh: Mesh, name: str, kinds: Mapping[str, Kind]) -> dict[str, Any] | None:
    """A description stored on a mesh, or None if it is missing or damaged.

    Args:
        mesh: the mesh.
        name: name of the custom property.
        kinds: kinds of its entries, by their keys.
    """
    text = mesh.get(name)
    try:
        stored = from_json(json.loads(text)) if isinstance(text, str) else None
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return stored if is_of_kind(stored, kinds) else None


def is_of_kind(value: Any, kind: Kind) -> bool:
    """Whether a value read from JSON is of a kind."""
    if isinstance(kind, Mapping):
        return isinstance(value, dict) and all(is_of_kind(value.get(key), each) for key, each in kind.items())
    if isinstance(kind, list):
        kinds = kind * len(value) if isinstance(value, list) and len(kind) == 1 else kind
        return isinstance(value, list) and len(value) == len(kinds) and all(map(is_of_kind, value, kinds))
    if isinstance(kind, tuple):
        return any(is_of_kind(value, each) for each in kind)
    return value is None if kind is None else isinstance(value, kind)
