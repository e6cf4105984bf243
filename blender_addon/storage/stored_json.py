# SPDX-License-Identifier: GPL-3.0-or-later
"""Descriptions stored on meshes as JSON, which may be damaged, or changed by other scripts."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from bpy.types import Mesh

from zoomout_core.messages import from_json


def read_json(mesh: Mesh, name: str, kinds: Mapping[str, type]) -> dict[str, Any] | None:
    """A description stored on a mesh, or None if it is missing or damaged.

    Args:
        mesh: the mesh.
        name: name of the custom property.
        kinds: types of the required entries, by their keys.
    """
    text = mesh.get(name)
    try:
        stored = from_json(json.loads(text)) if isinstance(text, str) else None
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    if not isinstance(stored, dict) or not all(isinstance(stored.get(key), kind) for key, kind in kinds.items()):
        return None
    return stored
