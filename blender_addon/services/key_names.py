# SPDX-License-Identifier: GPL-3.0-or-later
"""Rename the shape keys of a mesh to another convention of expression keys."""

from __future__ import annotations

from functools import lru_cache

from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.messages import Message, sentences
from zoomout_core.transfer.keys.key_names import describe
from zoomout_core.transfer.keys.key_table import CONVENTIONS

from .. import mesh_data
from ..scene.pair import check_writable


@lru_cache(maxsize=8)  # panels ask at every redraw
def convention_of(names: tuple[str, ...]) -> str:
    """The title of the convention that the names of keys follow; empty if none is clear."""
    found = zo.recognise_key_names(names)
    return CONVENTIONS[found].title if found else ""


def rename_shape_keys(context: Context, obj: Object, convention: str, compose: bool = True) -> Message:
    """Rename the shape keys of an object; animations and drivers follow.

    Args:
        context: Blender's; the object is in its scene.
        obj: a mesh object with shape keys.
        convention: the convention of the new names, see `zoomout_core.key_names`.
        compose: whether to add the keys that are sums of others, such as both sides.

    Returns:
        Sentences for the user, also about keys that are missing.

    Raises:
        MeshError: there are no shape keys, or they cannot be written; nothing was changed.
        ValueError: there is no such convention.
    """
    check_writable(obj)
    key = obj.data.shape_keys
    if key is None or len(key.key_blocks) < 2:
        raise zo.MeshError("'{name}' has no shape keys: add or transfer some first.", name=obj.name)
    basis = key.reference_key.name
    # The Basis is given as well, so that no key takes its name.
    keys = zo.translate_key_names([block.name for block in key.key_blocks], convention)
    renamed = {old: new for old, new in keys.renamed.items() if old != basis}
    with mesh_data.all_or_nothing(obj):
        if compose and keys.composed:
            offsets, rest = mesh_data.read_full_offsets(obj), mesh_data.read_rest_positions(obj.data)
            for name, parts in keys.composed.items():
                mesh_data.write_shape(obj, name, rest + sum(offsets[part] for part in parts))
        mesh_data.rename_shape_keys(obj.data.shape_keys, renamed)
        obj.data.update()
    return sentences(*describe(keys, compose))
