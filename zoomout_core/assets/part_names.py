# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a file, by the names of its objects, materials and joints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.assets.asset import MATERIALS, Asset, Skin
from zoomout_core.assets.files import READERS, read_asset
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.opening import shown
from zoomout_core.mesh.named_parts import NamedParts, name_parts
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.rigging.poses import parents_first

# Maximum number of names in a sentence.
LISTED = 12


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
    """The parts of a surface that was read from a file, perhaps by another program; without names, its loose parts.

    A file whose shape can be read, but not its materials, counts as one without names.
    """
    if Path(path).suffix.lower() in READERS and surface.components.max() > 0:
        with suppress(MeshError, ImportError):
            parts = parts_of(read_asset(path))
            if len(parts.number) == len(surface.triangles):
                return parts
    return name_parts(surface)


def matches(names: Iterable[str], patterns: Sequence[str]) -> bool:
    """Whether any of the names matches any of the patterns, such as `Body*`, regardless of case."""
    return any(fnmatchcase(name.lower(), pattern.lower()) for name in names for pattern in patterns)


def mask_of_parts(asset: Asset, patterns: Sequence[str]) -> Floats:
    """(n,) the degree, in [0, 1], to which vertices belong to parts whose names match patterns.

    Parts are objects, whose vertices have 1, and joints with those below them, whose vertices have the sum of their
    weights.

    Raises:
        MeshError: a pattern matches none, or these parts have no vertices.
    """
    skin, mask = asset.skin, np.zeros(len(asset.surface.vertices))
    joints, objects = () if skin is None else skin.names, [name for name, _ in asset.objects]
    for pattern in patterns:
        if not matches((*joints, *objects), [pattern]):
            names = [shown(name) for name in dict.fromkeys((*joints, *objects)) if name][:LISTED]
            choice = f"choose from {', '.join(names)}" if names else "transfer data with joints to it first"
            raise MeshError(f"The target has no joint or mesh {shown(pattern)}: {choice}.")
    if skin is not None:
        mask += skin.weights @ joints_below(skin, [matches([name], patterns) for name in joints]).astype(float)
    of_objects = np.array([matches([name], patterns) for name in objects], dtype=bool)
    mask[np.repeat(of_objects, [count for _, count in asset.objects])] = 1
    if not mask.any():
        raise MeshError(f"No vertex of the target belongs to {' or '.join(map(shown, patterns))}: choose other parts.")
    return np.clip(mask, 0, 1)


def joints_below(skin: Skin, chosen: Sequence[bool]) -> Booleans:
    """(b,) the chosen joints and all below them."""
    found = np.array(chosen, dtype=bool)
    for joint in parents_first(skin.parents):
        found[joint] |= skin.parents[joint] >= 0 and found[skin.parents[joint]]
    return found
