# SPDX-License-Identifier: GPL-3.0-or-later
"""The match stored on a target, with its objects as they are now."""

from __future__ import annotations

from bpy.types import Context

import zoomout_core as zo

from ..mesh_data import ObjectPair
from ..storage.stored_match import StoredMatch, description, others, read
from .pair import find_mesh, fingerprint_source, read_pair
from .selection import choose_source


async def stored_pair(context: Context, source_name: str, target_name: str) -> ObjectPair:
    """`read_pair`, with the further sources of the match stored on the target.

    Raises:
        MeshError: an object cannot be used, or the target cannot be written to.
    """
    stored = description(find_mesh(context, target_name).data)
    if stored is None:
        return await read_pair(context, source_name, target_name)
    digests = {other["name"]: other["fingerprint"] for other in others(stored)}
    if stored["source"] != source_name and not _is_same(context, source_name, stored["source_fingerprint"]):
        digests = {}
    names = list(digests)
    digests[source_name] = stored["source_fingerprint"]
    at_base = [name for name, digest in digests.items() if _is_at_base(context, name, digest)]
    return await read_pair(context, source_name, target_name, names, at_base)


def _is_same(context: Context, name: str, digest: str) -> bool:
    """Whether an object has the stored fingerprint, either evaluated or at its base."""
    return digest in {fingerprint_source(context, name, at_base).digest for at_base in (False, True)}


def _is_at_base(context: Context, name: str, digest: str) -> bool:
    """Whether only the object's own mesh has the stored fingerprint, because modifiers were added since."""
    return fingerprint_source(context, name).digest != digest and _is_same(context, name, digest)


async def read_stored_match(context: Context, target_name: str) -> tuple[ObjectPair, StoredMatch]:
    """The match stored on a target, and its objects as they are now.

    Raises:
        MeshError: no match is stored, or an object was edited since.
    """
    target = find_mesh(context, target_name)
    stored = description(target.data)
    if stored is None:
        raise zo.MeshError("'{target}' was not matched yet: match it first.", target=target_name)
    renamed = stored["source"] not in context.scene.objects
    source_name = choose_source(context, target).name if renamed else stored["source"]
    pair = await stored_pair(context, source_name, target_name)
    match = read(find_mesh(context, target_name).data, pair)
    if match is None:
        raise zo.MeshError(
            "'{source}' is not the source that '{target}' was matched with: match again.",
            source=source_name,
            target=target_name,
        )
    return pair, match
