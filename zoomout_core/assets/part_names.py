# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of the parts of a file, from its objects and materials."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np

from zoomout_core.assets.asset import MATERIALS, Asset
from zoomout_core.assets.files import READERS, read_asset
from zoomout_core.mesh.named_parts import NamedParts, name_parts
from zoomout_core.mesh.surface import MeshError, Surface


def parts_of(asset: Asset) -> NamedParts:
    """The parts of an asset's surface."""
    surface, materials = asset.surface, asset.find(MATERIALS)
    ends = np.cumsum([count for _, count in asset.objects], dtype=np.int64)
    return name_parts(
        surface,
        [name for name, _ in asset.objects],
        np.searchsorted(ends, surface.triangles[:, 0], side="right") if len(ends) else -1,
        [material.name for material in asset.materials],
        -1 if materials is None else materials.values[surface.triangle_face],
    )


def parts_of_file(path: str | Path, surface: Surface) -> NamedParts:
    """The parts of a surface that was read from a file, perhaps by another program; its loose parts without names.

    A file whose shape can be read, but not its materials, counts as one without names.
    """
    if Path(path).suffix.lower() in READERS and surface.components.max() > 0:
        with suppress(MeshError, ImportError):
            parts = parts_of(read_asset(path))
            if len(parts.number) == len(surface.triangles):
                return parts
    return name_parts(surface)
