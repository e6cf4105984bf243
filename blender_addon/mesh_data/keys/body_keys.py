# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys of a body that drive keys of the same names on worn objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from bpy.types import Key, Object

from zoomout_core.arrays import Booleans, Floats

from ..attributes.vertex_groups import read_mask
from ..surfaces.surfaces import directions_in_world
from .key_drivers import is_corrective
from .shape_keys import ShapeKey, read_own_shape_keys
from .write_keys import BASIS, path_of_key, write_shape_keys


@dataclass(frozen=True, eq=False)
class BodyKeys:
    """The shape keys of a body.

    Attributes:
        keys: the keys, without masks, relative to the Basis.
        offsets: (n, keys, 3) in world space, without the body's armature.
        values: (keys,) their present values, zero if muted.
        is_corrective: (keys,) whether bones drive them.
    """

    keys: tuple[ShapeKey, ...]
    offsets: Floats
    values: Floats
    is_corrective: Booleans

    @property
    def displacement(self) -> Floats:
        """(n, 3) displacement of the body by the present values."""
        return np.einsum("nkx,k->nx", self.offsets, self.values)

    @property
    def at_rest(self) -> Floats:
        """(n, 3) the same displacement in the rest pose, without correctives."""
        return np.einsum("nkx,k->nx", self.offsets, np.where(self.is_corrective, 0, self.values))


def read_body_keys(body: Object) -> BodyKeys | None:
    """The shape keys of a body; None if there are none, or they are absolute."""
    key = body.data.shape_keys
    if key is None or not key.use_relative or len(key.key_blocks) < 2:
        return None
    own = read_own_shape_keys(body.data)
    offsets = directions_in_world(body, own.offsets.values.astype(np.float64))
    for number, each in enumerate(own.keys):
        if each.settings["vertex_group"] in body.vertex_groups:
            offsets[:, number] *= read_mask(body, each.settings["vertex_group"])[:, None]
    # A key of the worn object's own Basis would be overwritten.
    chosen = [number for number, each in enumerate(own.keys) if each.name != BASIS]
    keys = [
        replace(own.keys[number], base=-1, relative_to=None, settings=own.keys[number].settings | {"vertex_group": ""})
        for number in chosen
    ]
    values = np.array([0.0 if each.settings["mute"] else each.settings["value"] for each in keys])
    driven = np.array([is_corrective(key, each.name) for each in keys], dtype=bool)
    return BodyKeys(tuple(keys), offsets[:, chosen], values, driven)


def write_body_keys(obj: Object, body: Object, keys: Sequence[ShapeKey], offsets: Floats, place: Floats) -> None:
    """Give an object keys that the keys of the body drive; those that would not move it are left out.

    Args:
        obj: the object; its own keys of the same names are overwritten.
        body: the body.
        keys: keys of the body.
        offsets: (n, keys, 3) offsets of the object's vertices, in world space.
        place: (4, 4) the object's world matrix.
    """
    moving = np.flatnonzero(offsets.any(axis=(0, 2)))
    if not len(moving):
        return
    chosen = [keys[number] for number in moving]
    write_shape_keys(obj, chosen, offsets[:, moving] @ np.linalg.inv(place[:3, :3]).T)
    for key in chosen:
        _drive(obj.data.shape_keys, body.data.shape_keys, key.name)


def _drive(driven: Key, driving: Key, name: str) -> None:
    """Drive a key by the key of the same name on another object, without an expression."""
    block = driven.key_blocks[name]
    block.driver_remove("value")
    driver = block.driver_add("value").driver
    driver.type = "AVERAGE"
    variable = driver.variables.new()
    variable.type = "SINGLE_PROP"
    end = variable.targets[0]
    end.id_type, end.id, end.data_path = "KEY", driving, f"{path_of_key(name)}value"
