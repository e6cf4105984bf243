# SPDX-License-Identifier: GPL-3.0-or-later
"""Match again in a part of the target, and keep the match of the rest."""

from __future__ import annotations

import numpy as np
from bpy.types import Context

import zoomout_core as zo
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.maps.redo import redo_shares, redone
from zoomout_core.messages import message

from ... import mesh_data
from ...mesh_data import ObjectPair
from ...scene.pair import target_mesh
from ...storage import stored_match
from ...storage.stored_match import Match, StoredMatch

# From this share of the new match on, the new match determines whether a vertex has a partner.
MOSTLY = 0.5


def valid_match(context: Context, pair: ObjectPair) -> StoredMatch | None:
    """The match of these two stored on the target; None if there is none, or an object was edited since."""
    with target_mesh(context, pair) as (_, mesh):
        try:
            return stored_match.read(mesh, pair)
        except zo.MeshError:
            return None


def read_mask(context: Context, pair: ObjectPair, group: str, keeps: bool) -> Floats:
    """(n_t,) how far to replace the match, in [0, 1], by a vertex group of the target.

    Raises:
        MeshError: there is no such group, or it leaves nothing to replace.
    """
    with target_mesh(context, pair) as (target, _):
        weights = mesh_data.read_mask(target, group)
    mask = 1 - weights if keeps else weights
    if not mask.any() and keeps:
        raise zo.MeshError(
            "The vertex group '{group}' covers the whole mesh: remove the part to match again from it.", group=group
        )
    if not mask.any():
        raise zo.MeshError("The vertex group '{group}' is empty: paint the part to match again into it.", group=group)
    return mask


def redone_match(pair: ObjectPair, before: StoredMatch, after: Match, mask: Floats) -> StoredMatch:
    """Replace an earlier match by a new one where a mask (n_t,) is 1, with a blend between."""
    shares = redo_shares(mask, pair.target)
    surface_map = redone(before.surface_map, after.surface_map, shares, pair.source)
    has_partner, of_source = before.has_partner, before.source_has_partner
    new_of_source = None if isinstance(after, zo.ProximityMatch) else after.source_has_partner
    without = None
    if has_partner is None or of_source is None or after.has_partner is None or new_of_source is None:
        has_partner = of_source = None
    else:
        has_partner = np.where(shares >= MOSTLY, after.has_partner, has_partner)
        of_source = np.where(_rematched_vertices(pair, surface_map, shares), new_of_source, of_source)
        without = pair.target.share_of_area(~has_partner), pair.source.share_of_area(~of_source)
    note = message(
        "{share:.0%} of the area was matched again, and the rest was kept.", share=pair.target.share_of_area(shares > 0)
    )
    return StoredMatch(
        surface_map,
        (1 - shares) * before.confidence + shares * after.confidence,
        (note, *after.notes),
        has_partner=has_partner,
        source_has_partner=of_source,
        without_partner=without,
    )


def _rematched_vertices(pair: ObjectPair, surface_map: zo.SurfaceMap, shares: Floats) -> Booleans:
    """(n_s,) whether the target point with the nearest image to a source vertex was matched again."""
    return np.asarray(surface_map.invert(pair.source, pair.target).interpolate(shares) >= MOSTLY)
