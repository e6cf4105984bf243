# SPDX-License-Identifier: GPL-3.0-or-later
"""Limit a transfer to a part of a target, which keeps its own data elsewhere: several sources may share a target."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from zoomout_core.assets.asset import (
    COLOR,
    MATERIALS,
    NORMALS,
    SHAPE_KEYS,
    Asset,
    kind_of,
    material_numbers,
    on_corners,
)
from zoomout_core.assets.gltf.append import append_materials
from zoomout_core.assets.gltf.materials import full_look
from zoomout_core.assets.gltf.read_asset import materials_of
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.attribute import Attribute, Domain
from zoomout_core.transfer.blend import blend
from zoomout_core.transfer.blend_settings import Blend

SIMPLE = (
    "Only colors and images of materials were kept, because those of the source or of the target are not from glTF."
)


def keep_rest(target: Asset, received: Asset, names: Collection[str], part: Blend) -> tuple[Asset, list[str]]:
    """Limit received attributes to a part of a target, which keeps its own data elsewhere.

    Args:
        target: the target before the transfer.
        received: the same with the attributes everywhere, and their materials.
        names: names of these attributes.
        part: where it receives them.

    Returns:
        The target, and sentences for the user.

    Raises:
        ValueError: the mask does not fit the target.
    """
    made, notes = replace(target, notes=(), stored_map=None), list[str]()
    for name in names:
        new, own = received.find(name), target.find(name)
        assert new is not None
        if name == MATERIALS:
            made, notes = _share_materials(made, received, part)
            continue
        if own is not None:
            new, own = _alike(new, own, target.surface)
        blended = blend(new, own, target.surface, part)
        made = replace(made, attributes=(*(each for each in made.attributes if each.name != name), blended))
    return made, notes


def _alike(new: Attribute, own: Attribute, surface: Surface) -> tuple[Attribute, Attribute]:
    """Convert two attributes of one name to one format: keys of both, others on corners, colours with alpha."""
    if new.name == SHAPE_KEYS:
        values = np.zeros_like(new.values)
        values[:, [new.labels.index(label) for label in own.labels]] = own.values
        return new, replace(own, values=values, labels=new.labels)
    if new.name == NORMALS and new.domain != own.domain:
        new, own = (replace(each, values=on_corners(each, surface), domain=Domain.CORNER) for each in (new, own))
    if kind_of(new) == COLOR and (new.domain, np.shape(new.values)) != (own.domain, np.shape(own.values)):
        new, own = (
            _opaque(replace(each, values=on_corners(each, surface), domain=Domain.CORNER)) for each in (new, own)
        )
    return new, own


def _opaque(color: Attribute) -> Attribute:
    """A colour with alpha, which is 1 if it has none."""
    rgb = np.asarray(color.values)
    return replace(color, values=np.column_stack([rgb, np.ones((len(rgb), 4 - rgb.shape[1]))]))


def _share_materials(target: Asset, received: Asset, part: Blend) -> tuple[Asset, list[str]]:
    """The target with received materials in a part, which follow its own, and notes."""
    new, own = received.find(MATERIALS), target.find(MATERIALS)
    assert new is not None
    count, numbers = len(target.materials), np.asarray(new.values)
    shifted = replace(new, values=np.where(numbers < 0, numbers, numbers + count))
    if own is None:
        own = replace(new, values=np.full_like(numbers, -1))
    values = np.asarray(blend(shifted, own, target.surface, part).values)
    others = tuple(each for each in target.attributes if each is not own)
    if count == 0:
        made = replace(target, attributes=(*others, material_numbers(values)))
        return replace(made, materials=received.materials, look=received.look), []
    used = np.unique(values[values >= count])
    values = np.where(values < count, values, count + np.searchsorted(used, values))
    materials = (*target.materials, *(received.materials[number] for number in (used - count).tolist()))
    made = replace(target, attributes=(*others, material_numbers(values)), materials=materials, look=None)
    first, second = full_look(target), full_look(received)
    if first is None or second is None:
        return made, [SIMPLE]
    look = append_materials(first, second, (used - count).tolist())
    return replace(made, materials=materials_of(look), look=look), []
