# SPDX-License-Identifier: GPL-3.0-or-later
"""How a target was linked to its source, stored on its mesh as a custom property, so that the link can be updated."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from bpy.types import Mesh, Object

from ..mesh_data import link_modifier
from . import stored_match
from .stored_json import Kind, read_json

PROPERTY = "zoomout_linked"
ENTRIES: dict[str, Kind] = {"source": str, "data": [str], "settings": dict, "layers": dict, "entries": str}


def write(
    mesh: Mesh, source: str, data: Sequence[str], settings: Mapping[str, Any], layers: Mapping[str, float], entries: str
) -> None:
    """Store a description of a link; it replaces an earlier one.

    Args:
        mesh: the target's mesh.
        source: name of the source.
        data: the kinds of data that were transferred.
        settings: the settings of the transfer, as JSON can store them.
        layers: the share of elements that follow the source, by the names of the linked layers.
        entries: the hash of the match that was used, see `stored_match`.
    """
    mesh[PROPERTY] = json.dumps(
        {"source": source, "data": list(data), "settings": dict(settings), "layers": dict(layers), "entries": entries}
    )


def description(mesh: Mesh) -> dict[str, Any] | None:
    """The description of the link on a mesh, with the arguments of `write`, or None if there is none."""
    return read_json(mesh, PROPERTY, ENTRIES)


def remove(mesh: Mesh) -> None:
    """Remove the description from a mesh, if it has one."""
    if PROPERTY in mesh:
        del mesh[PROPERTY]


def link_of(target: Object) -> dict[str, Any] | None:
    """How a target was linked; None if it is not linked, or its modifier was removed."""
    return description(target.data) if link_modifier(target) is not None else None


def has_older_match(target: Object) -> bool:
    """Whether a target was matched again since it was linked."""
    linked, match = link_of(target), stored_match.description(target.data)
    return linked is not None and match is not None and match.get("entries") != linked["entries"]
