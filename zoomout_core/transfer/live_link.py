# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfers as fixed mixtures of the source's values, which follow edits of these values without another transfer.

The places that a transfer reads depend on where values jump on the source: they are those of the values at the time of
picking. Values that a transfer fills in from their surroundings are no mixtures of three elements; `are_mixed` excludes
them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.interpolate import elect_corners, elect_points, pick_corners, vote_faces
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.picks import Picks
from zoomout_core.transfer.uv.transfer_uv import pick_uv

# Largest difference between a mixture and the transferred value, relative to the largest value. Programs store both in
# single precision, whose rounding is a tenth of this.
SAME_VALUE = 1e-6


def pick_points(attribute: Attribute, mapped: MappedTarget) -> Picks:
    """The vertices of the source's triangle that each vertex of the target is in."""
    surface_map = mapped.surface_map
    return Picks(surface_map.source_triangles[surface_map.triangle], surface_map.barycentric)


def pick_elected_points(attribute: Attribute, mapped: MappedTarget) -> Picks:
    """The vertex of the source whose label each vertex takes."""
    return Picks.single(elect_points(attribute, mapped))


def pick_elected_corners(attribute: Attribute, mapped: MappedTarget) -> Picks:
    """The corner of the source whose label each corner takes."""
    return Picks.single(elect_corners(attribute, mapped))


def pick_elected_faces(attribute: Attribute, mapped: MappedTarget) -> Picks:
    """The face of the source that covers most of each face, among those with its label; any if none covers it."""
    samples = mapped.samples(np.arange(len(mapped.target.face_start) - 1))
    face = mapped.source.triangle_face[samples.triangle]
    labels, elected = np.asarray(attribute.values), np.asarray(vote_faces(attribute, mapped).values)
    same = labels[face] == elected[samples.face]
    agrees = same if same.ndim == 1 else same.all(axis=1)
    return Picks.single(_heaviest_face(samples.face, face, samples.weight * agrees, len(elected)))


def _heaviest_face(owner: Integers, face: Integers, weight: Floats, count: int) -> Integers:
    """(count,) the face (q,) with the largest weight (q,), summed over its samples, of each owner (q,)."""
    faces = int(face.max()) + 1
    key, inverse = np.unique(owner * faces + face, return_inverse=True)
    total = np.bincount(inverse, weight)
    order = np.lexsort((total, key // faces))
    heaviest = np.zeros(count, dtype=np.int64)
    heaviest[key[order] // faces] = key[order] % faces  # the last one of each owner stays
    return heaviest


MIXED = {Domain.POINT: pick_points, Domain.CORNER: pick_corners}
ELECTED = {Domain.POINT: pick_elected_points, Domain.CORNER: pick_elected_corners, Domain.FACE: pick_elected_faces}
PICKS: dict[Kind, Mapping[Domain, Callable[[Attribute, MappedTarget], Picks]]] = {
    **dict.fromkeys((Kind.SCALAR, Kind.VECTOR, Kind.COLOR), MIXED),
    **dict.fromkeys((Kind.LABEL, Kind.BOOLEAN), ELECTED),
    Kind.UV: {Domain.CORNER: pick_uv},
}


def pick(attribute: Attribute, mapped: MappedTarget) -> Picks | None:
    """The elements of the source that a transfer of the attribute reads; None if it does more than mix three of them.

    Args:
        attribute: an attribute of the source.
        mapped: the target on the source.
    """
    function = PICKS.get(attribute.kind, {}).get(attribute.domain)
    return None if function is None else function(attribute, mapped)


def are_mixed(
    picks: Picks,
    attribute: Attribute,
    transferred: Attribute,
    tolerance: float = SAME_VALUE,
    encode: Callable[[Floats], Floats] = np.asarray,
) -> Booleans:
    """(q,) the elements of the target whose transferred values are those that `picks` reads from the source.

    Args:
        picks: what `pick` gave for the attribute.
        attribute: the source's values, dense.
        transferred: the target's.
        tolerance: largest difference of numbers that are the same, relative to the largest number above one.
        encode: how numbers are stored before they are rounded; as they are, when not given.
    """
    if attribute.kind in (Kind.LABEL, Kind.BOOLEAN):
        same = np.asarray(attribute.values)[picks.elements[:, 0]] == np.asarray(transferred.values)
    else:
        read = encode(picks.mix(np.asarray(attribute.values, dtype=np.float64)))
        off = np.abs(read - encode(np.asarray(transferred.values, dtype=np.float64)))
        same = off <= tolerance * max(1.0, float(np.abs(read).max(initial=0)))
    return np.asarray(same.reshape(len(same), -1).all(axis=1))
