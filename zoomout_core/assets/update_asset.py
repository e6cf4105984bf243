# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer what changed on a source to an asset that was made from it, along the map stored in the asset."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.asset import MATERIALS, WEIGHTS, Asset, at_rest, kind_of
from zoomout_core.assets.stored_map import digest_of, follow_triangles, same_triangles
from zoomout_core.assets.transfer_asset import KINDS, TransferredAsset, skin_weights, transfer_asset
from zoomout_core.mesh.surface import MeshError, Surface
from zoomout_core.transfer.attribute import Attribute, Domain
from zoomout_core.transfer.rules import map_target

# Values that differ by less, relative to the largest one, are equal: files store single floats, or fewer digits.
SAME = 1e-5

# (m, 3) corresponding corners of the triangles of two surfaces.
Corners: TypeAlias = tuple[Integers, Integers]


def update_asset(before: Asset, now: Asset, derived: Asset, kinds: Collection[str] = KINDS) -> TransferredAsset:
    """Transfer what changed on a source to an asset that received its data from it.

    Data that did not change on the source stays as it is on the asset, with later edits of it.

    Args:
        before: the source that the asset was made from.
        now: the source as it is now; it has the shape of before.
        derived: the asset, with its stored map.
        kinds: the kinds to update, of those that the asset received.

    Returns:
        The asset; `received` is empty if nothing changed.

    Raises:
        MeshError: the asset has no stored map, the map is of another source, or the shape or the joints of the source
            were edited.
    """
    stored = derived.stored_map
    if stored is None:
        raise MeshError(
            "It stores no map of its source: make it with `zoomout transfer --keep-map`, as .glb or .gltf file."
        )
    if stored.source != digest_of(before.surface):
        raise MeshError("Its stored map is of another source: check which file was the source.")
    moved = replace(
        follow_triangles(stored, at_rest(before).surface, at_rest(now).surface), source=digest_of(now.surface)
    )
    changed = changed_kinds(before, now, [kind for kind in kinds if kind in stored.kinds])
    updated, received, notes = derived, list[str](), list[str]()
    match = moved.on(now.surface)
    if others := [kind for kind in changed if kind != WEIGHTS]:
        made = transfer_asset(now, derived, match, others)
        updated, received, notes = made.asset, [*made.received], [*made.notes]
    if WEIGHTS in changed:
        if now.skin is None or derived.skin is None or set(now.skin.names) != set(derived.skin.names):
            raise MeshError("The joints of the source have changed: transfer the data again.")
        columns = [now.skin.names.index(name) for name in derived.skin.names]
        weights = skin_weights(
            now.skin, map_target(match, now.surface, derived.surface), _weight_limit(before, derived)
        )
        updated = replace(updated, skin=replace(derived.skin, weights=csr_array(weights[:, columns])))
        received.append("skin weights")
    return TransferredAsset(replace(updated, stored_map=moved), tuple(received), tuple(notes))


def _weight_limit(before: Asset, derived: Asset) -> int | None:
    """The largest number of joints of a vertex of an asset, if its source has more; None if it has not."""
    own, given = (
        0 if each.skin is None else int(np.diff(csr_array(each.skin.weights).indptr).max(initial=0))
        for each in (derived, before)
    )
    return own if own < given else None


def changed_kinds(before: Asset, now: Asset, kinds: Collection[str]) -> list[str]:
    """The kinds of data, of some kinds, that differ between two states of an asset, in the order of `KINDS`.

    They are compared in the rest pose of their joints: another pose in the file changes no shape keys and no normals.

    Raises:
        MeshError: the two have no triangle in common.
    """
    before, now = at_rest(before), at_rest(now)
    triangle, position = same_triangles(before.surface, now.surface)
    kept = triangle >= 0
    if not kept.any():
        raise MeshError("The two sources have no triangle in common: transfer the data again, with a new match.")
    corners = (
        before.surface.triangle_corners[kept],
        np.take_along_axis(now.surface.triangle_corners[triangle[kept]], position[kept], axis=1),
    )
    compared = {MATERIALS: _materials_differ, WEIGHTS: _weights_differ}
    return [kind for kind in KINDS if kind in kinds and compared.get(kind, _differs(kind))(before, now, corners)]


def _differs(kind: str) -> Callable[[Asset, Asset, Corners], bool]:
    """A function that compares the attributes of a kind at corresponding corners of two assets."""

    def compare(before: Asset, now: Asset, corners: Corners) -> bool:
        of_each = [{each.name: each for each in asset.attributes if kind_of(each) == kind} for asset in (before, now)]
        if of_each[0].keys() != of_each[1].keys():
            return True
        for name, attribute in of_each[0].items():
            other = of_each[1][name]
            if attribute.labels != other.labels:
                return True
            first, second = (
                _at_corners(each, asset.surface, at)
                for each, asset, at in zip((attribute, other), (before, now), corners, strict=True)
            )
            if first.shape != second.shape or _are_apart(first, second):
                return True
        return False

    return compare


def _materials_differ(before: Asset, now: Asset, corners: Corners) -> bool:
    """Whether faces have other materials, or a material looks different."""
    return _differs(MATERIALS)(before, now, corners) or before.materials != now.materials or _look(before) != _look(now)


def _look(asset: Asset) -> list[Any]:
    """The materials of an asset in full, with their images, to be compared."""
    if asset.look is None:
        return []
    gltf = asset.look.gltf
    return [gltf.materials, gltf.textures, [asset.look.image(number) for number in range(len(gltf.images))]]


def _weights_differ(before: Asset, now: Asset, corners: Corners) -> bool:
    """Whether joints have other weights; new or lost joints without any weight do not count."""
    if before.skin is None or now.skin is None:
        return before.skin is not now.skin
    names = tuple(dict.fromkeys((*before.skin.names, *now.skin.names)))
    rows = []
    for asset, at in zip((before, now), corners, strict=True):
        skin = asset.skin
        assert skin is not None
        column = np.array([names.index(name) for name in skin.names])
        own = csr_array(skin.weights)
        wide = csr_array((own.data, column[own.indices], own.indptr), shape=(own.shape[0], len(names)))
        rows.append(wide[asset.surface.corner_vertex[at.ravel()]])
    return float(abs(rows[0] - rows[1]).max()) > SAME


def _at_corners(attribute: Attribute, surface: Surface, corners: Integers) -> Floats:
    """(m, 3, ...) values at corners (m, 3)."""
    elements = {
        Domain.POINT: surface.corner_vertex,
        Domain.FACE: surface.corner_face,
        Domain.CORNER: np.arange(len(surface.corner_vertex)),
    }
    return np.asarray(attribute.values, dtype=np.float64)[elements[attribute.domain][corners]]


def _are_apart(first: Floats, second: Floats) -> bool:
    """Whether values differ by more than rounding."""
    largest = max(1.0, float(np.abs(first).max(initial=0)))
    return bool(np.abs(first - second).max(initial=0) > SAME * largest)
