# SPDX-License-Identifier: GPL-3.0-or-later
"""Descriptions stored on meshes as JSON, which other scripts and damaged files may have changed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from bpy.types import Mesh

from zoomout_core.messages import from_json


def read_json(mesh: Mesh, name: str, kinds: Mapping[str, type]) -> dict[str, Any] | None:
    """What is stored on a mesh under a name, or None without it, or where it is damaged: as good as none.

    Args:
        mesh: has it.
        name: of the custom property.
        kinds: what it must hold, and of which types.
    """
    text = mesh.get(name)
    try:
        stored = from_json(json.loads(text)) if isinstance(text, str) else None
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    if not isinstance(stored, dict) or not all(isinstance(stored.get(key), kind) for key, kind in kinds.items()):
        return None
    return stored
