"""Colours that show something on a mesh for a while: a colour attribute that leaves no trace when it is removed."""

from __future__ import annotations

import json

import numpy as np
from bpy.types import Context, Mesh, SpaceView3D

from zoomout_core.arrays import Floats
from zoomout_core.transfer import Attribute, Domain, Kind

from .mesh_data import PREVIEW, Layer, Role, write_layer

PROPERTY = "zoomout_preview"
# Scene-linear colours of a heat map, from nothing to its highest value.
HEAT = np.array([[0.03, 0.04, 0.16], [0.02, 0.26, 0.42], [0.16, 0.55, 0.16], [0.9, 0.55, 0.03], [0.8, 0.03, 0.01]])


def is_shown(mesh: Mesh) -> bool:
    """Whether there are such colours on a mesh."""
    return PROPERTY in mesh


def show(context: Context, mesh: Mesh, colours: Floats, what: str) -> None:
    """Show colours (n, 3), scene-linear, at the vertices of a mesh, in place of what it shows.

    Args:
        context: Blender's; its 3D view, if there is one, is made to show them.
        mesh: receives them.
        colours: from 0 to 1.
        what: they say, for `shown`.
    """
    view = _view(context)
    if PROPERTY in mesh:
        before = json.loads(mesh[PROPERTY])
    else:
        before = {"active": mesh.attributes.active_color_name, "rendered": mesh.attributes.default_color_name}
    if view is not None and view.shading.color_type != "VERTEX":
        before["shading"] = view.shading.color_type
        view.shading.color_type = "VERTEX"
    values = np.column_stack([colours, np.ones(len(colours))])
    write_layer(mesh, Layer(Attribute(PREVIEW, Domain.POINT, Kind.COLOR, values), Role.COLOR, "FLOAT_COLOR"))
    mesh.attributes.active_color_name = PREVIEW
    mesh[PROPERTY] = json.dumps(before | {"what": what})
    mesh.update()


def shown(mesh: Mesh) -> str:
    """What the colours on a mesh say."""
    return str(json.loads(mesh[PROPERTY])["what"])


def remove(context: Context, mesh: Mesh) -> None:
    """Take the colours of a mesh away, and show what was shown before."""
    before = json.loads(mesh[PROPERTY])
    del mesh[PROPERTY]
    if PREVIEW in mesh.attributes:
        mesh.attributes.remove(mesh.attributes[PREVIEW])
    mesh.attributes.active_color_name = before["active"]
    mesh.attributes.default_color_name = before["rendered"]
    view = _view(context)
    if view is not None and "shading" in before:
        view.shading.color_type = before["shading"]
    mesh.update()


def heat(values: Floats, most: float) -> Floats:
    """(n, 3) colours of a heat map of values (n,), those of `most` and more the hottest."""
    at = np.clip(values / most, 0, 1) * (len(HEAT) - 1)
    return np.column_stack([np.interp(at, np.arange(len(HEAT)), channel) for channel in HEAT.T])


def _view(context: Context) -> SpaceView3D | None:
    space = context.space_data
    return space if space is not None and space.type == "VIEW_3D" else None
