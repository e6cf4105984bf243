# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure how asymmetric a mesh is, in its shape, its weights or a shape key, and show it by colours."""

from __future__ import annotations

from functools import partial
from typing import Literal, TypeAlias

import bpy
import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.messages import message
from zoomout_core.runtime.progress import stage
from zoomout_core.symmetry.flip_name import partner_of
from zoomout_core.symmetry.mirror import asymmetry
from zoomout_core.symmetry.offsets import mirror_offsets, shape_asymmetry
from zoomout_core.symmetry.self_map import SelfMap

from ... import mesh_data
from ...colors import RED_LENGTH, RED_WEIGHT
from ...jobs import compute, pause, run
from ...scene.pair import name_of
from ...storage import stored_symmetry
from ...viewport import preview
from ..matching import previews
from .mesh_access import READ, READING, find_not_edited, own_mesh, writable_mesh
from .shape_keys import read_key

Checked: TypeAlias = Literal["shape", "weights", "key"]


def check_symmetry(
    context: Context,
    obj: Object,
    check: Checked = "shape",
    key: str = "",
    red_length: float = RED_LENGTH,
    red_weight: float = RED_WEIGHT,
) -> str:
    """Show by colours how asymmetric an object's mesh is, along the symmetry stored on it.

    Args:
        context: Blender's; the object is in its scene.
        obj: a mesh object.
        check: the data to compare between the sides: the "shape", "weights", or a "key".
        key: the name of the key.
        red_length: the difference shown in red, over the square root of the area.
        red_weight: the same for weights, in [0, 1].

    Returns:
        A sentence for the user, with the mean and the largest value.

    Raises:
        MeshError: there is no symmetry, or no such key; nothing was written.
    """
    return run(check_symmetry_async(context, name_of(obj), check, key, red_length, red_weight))


async def check_symmetry_async(
    context: Context,
    name: str,
    check: Checked,
    key: str,
    red_length: float = RED_LENGTH,
    red_weight: float = RED_WEIGHT,
) -> str:
    """`check_symmetry` as a coroutine, which keeps no Blender data across an `await`."""
    values = await measure_asymmetry(context, name, check, key)
    obj = writable_mesh(context, name)
    red = red_weight if check == "weights" else red_length * np.sqrt(stored_symmetry.read(obj).surface.area)
    what = _describe(context, obj, check, key, values, red)
    context.view_layer.update()  # so that earlier changes do not count as later ones
    preview.show(previews.of_asymmetry(obj, values, red, what))
    return what


async def measure_asymmetry(context: Context, name: str, check: Checked, key: str = "") -> Floats:
    """The values (n,) that `check_symmetry` shows: lengths in the mesh's own units, or shares of weights.

    Raises:
        MeshError: there is no symmetry, or no such key.
    """
    obj = writable_mesh(context, name)
    symmetry = stored_symmetry.read(obj)
    if check == "weights" and not obj.vertex_groups:
        raise zo.MeshError("'{name}' has no vertex groups: add some, or check the shape instead.", name=name)
    with stage(READING, 0, READ):
        await pause()
        if check == "shape":
            work = partial(shape_asymmetry, symmetry)
        elif check == "weights":
            fetch = partial(own_mesh, context, name, symmetry.surface)
            work = partial(asymmetry, await mesh_data.read_weights_in_pieces(fetch), symmetry)
        else:
            with own_mesh(context, name, symmetry.surface) as (obj, mesh):
                _, own = read_key(obj, key)
                keys = mesh.shape_keys.key_blocks.keys()
                partner = partner_of(key, keys)
                work = partial(_key_asymmetry, own, read_key(obj, partner if partner in keys else key)[1], symmetry)
    with stage("Comparing the sides", READ, 1):
        values = np.nan_to_num(await compute(work))
    find_not_edited(context, name, symmetry.surface)
    return values


def _key_asymmetry(offsets: Floats, partner: Floats, symmetry: SelfMap) -> Floats:
    """(n,) distance between a key's displacements and the mirrored ones of its partner."""
    return np.asarray(np.linalg.norm(mirror_offsets(partner, symmetry) - offsets, axis=1))


def _describe(context: Context, obj: Object, check: Checked, key: str, values: Floats, red: float) -> str:
    """The values in words, and the value shown in red."""
    head = {"shape": message("Shape"), "weights": message("Weights"), "key": message("Shape key {key}", key=repr(key))}[
        check
    ]
    show = "{:.0%}".format if check == "weights" else partial(_length, context, obj)
    mean, largest, hottest = (show(value) for value in (values.mean(), values.max(initial=0), red))
    return message(
        "{what}: the sides differ by {mean} on average, at most {largest}; red is {red} and more",
        what=head,
        mean=mean,
        largest=largest,
        red=hottest,
    )


def _length(context: Context, obj: Object, value: float) -> str:
    """A length in a mesh's own units as text in the scene's units, with two significant digits."""
    units = context.scene.unit_settings
    length = float(f"{value * obj.matrix_world.median_scale * units.scale_length:.2g}")
    return bpy.utils.units.to_string(units.system, "LENGTH", length, precision=6).strip()
