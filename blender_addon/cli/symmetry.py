# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `symmetry`."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo

from .. import jobs
from ..services.symmetry.check import Checked, measure_asymmetry
from ..services.symmetry.detect import choose_symmetry, detect_symmetry, found_summary, swap_sides
from ..services.symmetry.layers import mirror_attributes
from ..services.symmetry.mesh_access import writable_mesh
from ..services.symmetry.shape_keys import mirror_shape_key
from ..services.symmetry.sides import name_sides
from ..services.symmetry.weights import symmetrise_weights
from ..storage import stored_symmetry


def run(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Find symmetries, do the requested work along them, and report on each object by name."""
    report: dict[str, Any] = {}
    for name in dict.fromkeys(options.objects):
        entry = report[name] = {"done": []}
        try:
            obj = writable_mesh(context, name)
            try:
                _work(context, obj, options, entry["done"])
            finally:  # list the symmetries even after an error, so that the user can choose another
                entry |= _describe(obj) if _is_known(obj) else {}
            entry["asymmetry"] = {check: _asymmetry(context, name, check) for check in options.check}
        except zo.MeshError as error:
            entry["error"] = str(error)
    return report


def _work(context: Context, obj: Object, options: argparse.Namespace, done: list[str]) -> None:
    """Do the requested steps in turn, and add a sentence about each to `done`, so that it has those before an error."""
    if options.detect_again or not _is_known(obj):
        found = detect_symmetry(context, obj, options.left.upper())
        done.append(found_summary(obj.name, found))
    if options.use:
        done.append(choose_symmetry(context, obj, options.use - 1))
    if options.swap_sides:
        done.append(swap_sides(context, obj))
    if options.name_sides:
        done.append(name_sides(obj, options.middle_width))
    if options.symmetrise_weights:
        done.append(symmetrise_weights(context, obj, options.direction))
    for key in options.mirror_shape_keys:
        done.append(mirror_shape_key(context, obj, key, options.key_mode, options.direction, options.blend))
    if options.mirror_attributes:
        done.append(mirror_attributes(context, obj, options.mirror_attributes, options.direction, options.uv_layout))


def _is_known(obj: Object) -> bool:
    """Whether the object's mesh has a stored symmetry that is still valid."""
    try:
        stored_symmetry.read(obj)
    except zo.MeshError:  # none is stored, or the mesh was edited since
        return False
    return True


def _describe(obj: Object) -> dict[str, Any]:
    """The symmetries stored on an object's mesh, and the number of the used one, from 1."""
    stored = stored_symmetry.description(obj.data)
    assert stored is not None  # it was found before
    return {"vertices": stored["vertices"], "candidates": stored["candidates"], "used": stored["chosen"] + 1}


def _asymmetry(context: Context, name: str, check: Checked) -> dict[str, float]:
    """Difference between the sides: a length in the mesh's own units, or the share of weights in other groups."""
    values = jobs.run(measure_asymmetry(context, name, check))
    return {"mean": float(np.mean(values)), "most": float(np.max(values, initial=0))}
