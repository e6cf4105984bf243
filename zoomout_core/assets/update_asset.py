# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer what changed on a source to an asset that was made from it, along the map stored in the asset.

Everything else is kept, with later edits of the asset: other layers, other shape keys, and weights where the source's
are the same. Where weights of levels of detail change, they are fitted to the source again.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from itertools import chain
from typing import Any, TypeAlias

import numpy as np
from scipy.sparse import csr_array, diags_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.assets.asset import MATERIALS, SHAPE_KEYS, WEIGHTS, Asset, at_rest, kind_of
from zoomout_core.assets.bind_asset import skin_weights
from zoomout_core.assets.given_levels import refit_weights
from zoomout_core.assets.stored_map import MapOfSource, digest_of, follow_triangles, same_triangles
from zoomout_core.assets.transfer_asset import KINDS, TransferredAsset, transfer_asset
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import enumeration, message
from zoomout_core.transfer.attribute import Attribute, Domain
from zoomout_core.transfer.rules import map_target

# Values that differ by less, relative to the largest one, are equal: files store single floats, or fewer digits.
SAME = 1e-5

# (m, 3) corresponding corners of the triangles of two surfaces.
Corners: TypeAlias = tuple[Integers, Integers]


def update_asset(before: Asset, now: Asset, derived: Asset, kinds: Collection[str] = KINDS) -> TransferredAsset:
    """Transfer what changed on a source to an asset that received its data from it.

    Data that did not change on the source is kept on the asset, with later edits: each layer, each shape key, and the
    weights of each vertex. Data that the source lost is kept, too.

    Args:
        before: the source that the asset was made from.
        now: the source as it is now, with the same shape.
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
    part, lost = _changed_part(before, now, changed)
    if part.attributes:
        made = transfer_asset(part, derived, match, list(dict.fromkeys(map(kind_of, part.attributes))))
        names = [each.name for each in made.asset.attributes]
        kept = (each for each in derived.attributes if each.name not in names)
        updated = replace(made.asset, attributes=(*made.asset.attributes, *kept))
        received, notes = [*made.received], [*made.notes]
    if lost:
        notes.append(message("The source no longer has {names}: the updated file still does.", names=enumeration(lost)))
    if WEIGHTS in changed:
        weights = _update_weights(before, now, derived, stored.on(before.surface), match)
        if stored.fitted:
            weights = _fit_changes(now, derived, match, weights)
        assert derived.skin is not None
        updated = replace(updated, skin=replace(derived.skin, weights=weights))
        received.append("skin weights")
    return TransferredAsset(replace(updated, stored_map=moved), tuple(received), tuple(notes))


def _changed_part(before: Asset, now: Asset, kinds: Collection[str]) -> tuple[Asset, list[str]]:
    """Find the differences between two states of a source.

    Returns:
        The source now, restricted to attributes and shape keys of some kinds that differ or are new, and the names of
        those that it lost.
    """
    rest = at_rest(before), at_rest(now)
    corners = _same_corners(*rest)
    changed = {kind: _changes(kind, *rest, corners) for kind in kinds}
    kept, found = list[Attribute](), set[str]()
    for each in now.attributes:
        names = changed.get(kind_of(each), set())
        if each.name == SHAPE_KEYS:
            found.update(each.labels)
            columns = [number for number, label in enumerate(each.labels) if label in names]
            labels = tuple(each.labels[number] for number in columns)
            if columns:
                kept.append(replace(each, values=np.asarray(each.values)[:, columns], labels=labels))
        else:
            found.add(each.name)
            if each.name in names or (each.name == MATERIALS and MATERIALS in kinds):
                kept.append(each)
    return replace(now, attributes=tuple(kept)), sorted({*chain(*changed.values())} - found)


def _update_weights(before: Asset, now: Asset, derived: Asset, there: MapOfSource, here: MapOfSource) -> csr_array:
    """(k, b) weights of an asset's joints: its own, or the source's where these have changed.

    Args:
        before: the source that the asset was made from.
        now: the source as it is now.
        derived: the asset.
        there: its map to the source before.
        here: its map to the source now.

    Raises:
        MeshError: the joints of the source were edited.
    """
    skin, limit, states = derived.skin, _weight_limit(before, derived), list[csr_array]()
    for source, match in ((before, there), (now, here)):
        if skin is None or source.skin is None or set(source.skin.names) != set(skin.names):
            raise MeshError("The joints of the source have changed: transfer the data again.")
        columns = [source.skin.names.index(name) for name in skin.names]
        mapped = map_target(match, source.surface, derived.surface)
        states.append(csr_array(skin_weights(source.skin, mapped, limit)[:, columns]))
    assert skin is not None
    changed = abs(states[1] - states[0]).max(axis=1).toarray().ravel() > SAME
    # Include neighbours: weights that were transferred in another pose are spread a little differently.
    triangles = derived.surface.triangles
    changed[triangles[changed[triangles].any(axis=1)]] = True
    return _take_rows(states[1], skin.weights, changed)


def _fit_changes(now: Asset, level: Asset, match: MapOfSource, weights: csr_array) -> csr_array:
    """Fit weights (k, b) of a level of detail to the source where they differ from the level's own."""
    assert level.skin is not None
    assert now.skin is not None
    own, names = csr_array(level.skin.weights), level.skin.names
    there = [names.index(name) for name in now.skin.names]
    at_rest_now, surface = at_rest(now), level.surface.with_vertices(level.skin.rest)
    fitted = refit_weights(at_rest_now, surface, match.surface_map, csr_array(weights[:, there]))
    fitted = csr_array(fitted[:, np.argsort(there)])
    return _take_rows(fitted, own, abs(weights - own).max(axis=1).toarray().ravel() > SAME)


def _take_rows(first: csr_array, second: csr_array, chosen: Booleans) -> csr_array:
    """The chosen rows (k,) of the first array, and the others of the second."""
    return csr_array(diags_array(chosen.astype(float)) @ first + diags_array((~chosen).astype(float)) @ second)


def _weight_limit(before: Asset, derived: Asset) -> int | None:
    """The largest number of joints that a vertex of an asset may have. None if this is not limited.

    It is the limit that the asset was made with. Weights are also limited if its vertices have fewer joints than the
    source's.
    """
    own, given = (
        0 if each.skin is None else int(np.diff(csr_array(each.skin.weights).indptr).max(initial=0))
        for each in (derived, before)
    )
    assert derived.stored_map is not None
    limits = [] if derived.stored_map.max_weights is None else [derived.stored_map.max_weights]
    return min([*limits, own] if own < given else limits, default=None)


def changed_kinds(before: Asset, now: Asset, kinds: Collection[str]) -> list[str]:
    """The kinds of data, of some kinds, that differ between two states of an asset, in the order of `KINDS`.

    They are compared in the rest pose of their joints, so that another pose in the file does not count as a change of
    shape keys and normals.

    Raises:
        MeshError: the two have no triangle in common.
    """
    before, now = at_rest(before), at_rest(now)
    corners = _same_corners(before, now)
    return [kind for kind in KINDS if kind in kinds and _has_changed(kind, before, now, corners)]


def _same_corners(before: Asset, now: Asset) -> Corners:
    """Corresponding corners of the triangles that two states of an asset at rest share.

    Raises:
        MeshError: the two have no triangle in common.
    """
    triangle, position = same_triangles(before.surface, now.surface)
    kept = triangle >= 0
    if not kept.any():
        raise MeshError("The two sources have no triangle in common: transfer the data again, with a new match.")
    return (
        before.surface.triangle_corners[kept],
        np.take_along_axis(now.surface.triangle_corners[triangle[kept]], position[kept], axis=1),
    )


def _has_changed(kind: str, before: Asset, now: Asset, corners: Corners) -> bool:
    """Whether data of a kind differs at corresponding corners of two states of an asset at rest."""
    if kind == WEIGHTS:
        return _weights_differ(before, now, corners)
    if kind == MATERIALS and (before.materials != now.materials or _look(before) != _look(now)):
        return True
    return bool(_changes(kind, before, now, corners))


def _changes(kind: str, before: Asset, now: Asset, corners: Corners) -> set[str]:
    """Names of the attributes of a kind, or of shape keys, that differ at corresponding corners, or that one lacks."""
    first, second = (_named_values(kind, each, at) for each, at in zip((before, now), corners, strict=True))
    return {
        name
        for name in {*first, *second}
        if name not in first
        or name not in second
        or first[name].shape != second[name].shape
        or _are_apart(first[name], second[name])
    }


def _named_values(kind: str, asset: Asset, corners: Integers) -> dict[str, Floats]:
    """The values at corners (m, 3) of an asset's attributes of a kind by their names, and of shape keys by theirs."""
    found = dict[str, Floats]()
    for each in asset.attributes:
        if kind_of(each) == kind:
            values = _at_corners(each, asset.surface, corners)
            if each.name == SHAPE_KEYS:
                found |= {label: values[:, :, number] for number, label in enumerate(each.labels)}
            else:
                found[each.name] = values
    return found


def _look(asset: Asset) -> list[Any]:
    """The complete materials of an asset with their images, for a comparison."""
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
