# SPDX-License-Identifier: GPL-3.0-or-later
"""The map that an asset was made by, stored in its file, so that changes of its source can be carried to it later."""

from __future__ import annotations

from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.rules import Match

# Triangles are stored as single floats, which are exact up to here.
MAX_TRIANGLES = 1 << 24
# Vertices at a smaller distance, relative to the extent of the surface, are the same: files store single floats.
SAME_PLACE = 1e-6
# Stored in place of the confidence of a vertex without a partner.
WITHOUT_PARTNER = -1.0


@dataclass(frozen=True, eq=False)
class StoredMap:
    """The points of a source that the vertices of an asset received their data from.

    Attributes:
        triangle: (n,) triangles of the source.
        barycentric: (n, 3) coordinates in them.
        confidence: (n,) confidence of the map, in [0, 1].
        has_partner: (n,) whether each vertex has a partner on the source.
        source: the digest of the source's surface.
        kinds: the kinds of data that were received.
        fitted: whether the weights were fitted to the source in poses, as those of levels of detail are.
        max_weights: how many joints a vertex may have; None if this was not limited.
    """

    triangle: Integers
    barycentric: Floats
    confidence: Floats
    has_partner: Booleans
    source: str
    kinds: tuple[str, ...]
    fitted: bool = False
    max_weights: int | None = None

    @property
    def rows(self) -> Floats:
        """(n, 4) for each vertex its triangle, two barycentric coordinates, and its confidence, for a file."""
        confidence = np.where(self.has_partner, self.confidence, WITHOUT_PARTNER)
        return np.column_stack([self.triangle, self.barycentric[:, 1:], confidence])

    @property
    def description(self) -> dict[str, Any]:
        """The values that belong to all vertices, for a file."""
        found = {"source": self.source, "kinds": list(self.kinds), "fitted": self.fitted}
        return found if self.max_weights is None else {**found, "max_weights": self.max_weights}

    def on(self, source: Surface) -> MapOfSource:
        """The map onto a surface with the triangles of the source."""
        return MapOfSource(
            SurfaceMap(self.triangle, self.barycentric, source.triangles), self.confidence, self.has_partner
        )


@dataclass(frozen=True, eq=False)
class MapOfSource:
    """A stored map as a `Match`."""

    surface_map: SurfaceMap
    confidence: Floats
    has_partner: Booleans


def stored_map_of(
    match: Match,
    source: Surface,
    kinds: tuple[str, ...],
    fitted: bool = False,
    max_weights: int | None = None,
) -> StoredMap:
    """The map of a match, to be stored with the asset that received data of some kinds, see `StoredMap`.

    Raises:
        MeshError: the source has too many triangles for their numbers to be stored.
    """
    if len(source.triangles) > MAX_TRIANGLES:
        raise MeshError(
            f"The source has {len(source.triangles):,} triangles, but a file can store the numbers of "
            f"{MAX_TRIANGLES:,}: leave out --keep-map."
        )
    found, confidence = match.surface_map, np.asarray(match.confidence)
    has_partner = np.ones(len(confidence), dtype=bool) if match.has_partner is None else np.asarray(match.has_partner)
    return StoredMap(
        found.triangle, found.barycentric, confidence, has_partner, digest_of(source), kinds, fitted, max_weights
    )


def stored_map_from(rows: Floats, description: Any) -> StoredMap | None:
    """The map from the rows (n, 4) and the description in a file, see `StoredMap`; None if they are damaged."""
    if not isinstance(description, dict) or rows.shape[1:] != (4,) or not np.isfinite(rows).all():
        return None
    source, kinds = description.get("source"), description.get("kinds")
    if not isinstance(source, str) or not isinstance(kinds, list) or not all(isinstance(each, str) for each in kinds):
        return None
    inner = np.clip(rows[:, 1:3], 0, 1)
    barycentric = np.column_stack([np.maximum(1 - inner.sum(axis=1), 0), inner])
    barycentric /= barycentric.sum(axis=1, keepdims=True)
    has_partner = rows[:, 3] >= 0
    confidence = np.clip(rows[:, 3], 0, 1)
    triangle, fitted, limit = rows[:, 0].astype(np.int64), description.get("fitted") is True, None
    if type(description.get("max_weights")) is int and description["max_weights"] > 0:
        limit = description["max_weights"]
    return StoredMap(triangle, barycentric, confidence, has_partner, source, tuple(kinds), fitted, limit)


def digest_of(source: Surface) -> str:
    """A digest of the vertices and triangles of a surface."""
    digest = blake2b(np.ascontiguousarray(source.vertices, np.float32).tobytes(), digest_size=16)
    digest.update(np.ascontiguousarray(source.triangles, np.int64).tobytes())
    return digest.hexdigest()


def follow_triangles(stored: StoredMap, before: Surface, now: Surface) -> StoredMap:
    """The same map onto an edited source, whose triangles may have other numbers and begin at other corners.

    Args:
        stored: the map onto the source before.
        before: the source before, in a pose that it shares with the source now.
        now: the source now.

    Raises:
        MeshError: the map is of another source, or leads to triangles that the source has lost.
    """
    if len(stored.triangle) and not 0 <= stored.triangle.min() <= stored.triangle.max() < len(before.triangles):
        raise MeshError("Its stored map is of another source: transfer the data again.")
    triangle, position = same_triangles(before, now)
    found = triangle[stored.triangle]
    if (found < 0).any():
        raise MeshError(
            f"The shape of the source was edited where {(found < 0).sum():,} vertices received their data: transfer "
            "the data again, with a new match."
        )
    barycentric = np.empty_like(stored.barycentric)
    np.put_along_axis(barycentric, position[stored.triangle], stored.barycentric, axis=1)
    return replace(stored, triangle=found, barycentric=barycentric)


def same_triangles(before: Surface, now: Surface) -> tuple[Integers, Integers]:
    """Find the triangles of a surface in an edited file of it, by the places of their corners.

    Returns:
        (m,) the present number of each triangle of `before`, -1 if it is gone; and (m, 3) the positions of its corners
        in the present triangle.
    """
    places, of_before = np.unique(before.vertices, axis=0, return_inverse=True)
    reach = SAME_PLACE * float(np.ptp(places, axis=0).max())
    _, of_now = cKDTree(places).query(now.vertices, distance_upper_bound=reach)  # the number of places for none
    first, second = of_before.ravel()[before.triangles], np.asarray(of_now)[now.triangles]
    order, other = (np.argsort(each, axis=1, kind="stable") for each in (first, second))
    keys = [np.take_along_axis(each, at, axis=1) for each, at in ((first, order), (second, other))]
    _, same = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    old, new = np.split(same.ravel(), [len(first)])
    number = np.full(int(same.max(initial=0)) + 1, -1)
    number[new[::-1]] = np.arange(len(new))[::-1]  # the first of several in one place
    triangle = number[old]
    position = np.empty_like(order)
    np.put_along_axis(position, order, other[triangle], axis=1)
    return triangle, position
