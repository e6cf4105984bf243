"""Select the symmetry line of the active mesh, and name its sides by vertex groups."""

from __future__ import annotations

import numpy as np
from bpy.types import Context, Object
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.arrays import Booleans
from zoomout_core.runtime.stepping import Progress, Steps
from zoomout_core.symmetry.self_map import SelfMap
from zoomout_core.transfer import Attribute, Domain, Kind

from ... import mesh_data
from ...properties.settings import take_settings
from ...properties.symmetry import SideOptions
from ...storage import stored_symmetry
from .base import SymmetryOperator, writable_mesh

# Names of the vertex groups, which change sides as others do.
LEFT, RIGHT, MIDDLE = "Side.L", "Side.R", "Side Middle"


class ZOOMOUT_OT_select_symmetry_line(SymmetryOperator):
    bl_idname = "zoomout.select_symmetry_line"
    bl_label = "Select Symmetry Line"
    bl_description = "Select the vertices and edges that lie nearest to the line between left and right"
    bl_options = {"REGISTER", "UNDO"}

    def steps(self, context: Context) -> Steps[str]:
        obj = writable_mesh(context, context.active_object.name)
        yield Progress(0.0, "Selecting")
        told = select_symmetry_line(obj)
        if not context.tool_settings.mesh_select_mode[0]:  # Edit Mode would let go of vertices
            context.tool_settings.mesh_select_mode = (True, False, False)
        return told


class ZOOMOUT_OT_name_sides(SideOptions, SymmetryOperator):
    bl_idname = "zoomout.name_sides"
    bl_label = "Name Sides"
    bl_description = f"Make vertex groups of the left side, the right side and the middle: {LEFT}, {RIGHT}, {MIDDLE}"
    bl_options = {"REGISTER", "UNDO"}

    def steps(self, context: Context) -> Steps[str]:
        take_settings(self, context.scene.zoomout.symmetry)
        obj = writable_mesh(context, context.active_object.name)
        yield Progress(0.0, "Naming")
        return name_sides(obj, self.middle_width)


def select_symmetry_line(obj: Object) -> str:
    """Select what lies nearest to the symmetry line that is kept on an object's mesh, and nothing else.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: there is no symmetry, or no line; nothing was selected.
    """
    symmetry = _with_sides(obj)
    chosen = vertices_on_line(symmetry)
    mesh_data.write_selection(obj.data, Attribute("selection", Domain.POINT, Kind.BOOLEAN, chosen))
    faces = np.zeros(len(obj.data.polygons), dtype=bool)
    mesh_data.write_selection(obj.data, Attribute("selection", Domain.FACE, Kind.BOOLEAN, faces))
    obj.data.update()
    return f"Selected {int(chosen.sum())} vertices on the symmetry line of '{obj.name}'"


def vertices_on_line(symmetry: SelfMap) -> Booleans:
    """(n,) of each edge that the symmetry line crosses the end that lies nearer to it."""
    ends = symmetry.surface.edges
    distance = symmetry.distance[ends]
    crossed = distance[:, 0] * distance[:, 1] <= 0
    nearer = np.where(np.abs(distance[:, 0]) <= np.abs(distance[:, 1]), ends[:, 0], ends[:, 1])
    chosen = np.zeros(len(symmetry.distance), dtype=bool)
    chosen[nearer[crossed & distance.any(axis=1)]] = True
    return chosen


def name_sides(obj: Object, width: float) -> str:
    """Make vertex groups of the sides of an object's mesh, in place of those of the same names.

    Args:
        obj: a mesh object.
        width: how far from the line the middle reaches, over the square root of the surface's area.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: there is no symmetry, or there are no sides; nothing was written.
    """
    symmetry = _with_sides(obj)
    side = symmetry.sides(width * np.sqrt(symmetry.surface.area))
    members = np.column_stack([side > 0, side < 0, side == 0])
    weights = csr_array(members.astype(np.float32))
    mesh_data.write_weights(obj, Attribute("sides", Domain.POINT, Kind.WEIGHT, weights, (LEFT, RIGHT, MIDDLE)))
    obj.data.update()
    left, right, middle = members.sum(axis=0)
    return f"'{obj.name}': {left} vertices on the left, {right} on the right, {middle} in the middle"


def _with_sides(obj: Object) -> SelfMap:
    symmetry = stored_symmetry.read(obj)
    if not symmetry.has_sides:
        raise zo.MeshError("This symmetry has no left and right side: choose a reflection.")
    return symmetry
