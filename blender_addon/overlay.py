"""Colours drawn over objects in the 3D views: nothing of the file is touched, so nothing has to be put back.

A coat of colour lies over an object as its modifiers leave it, a hair nearer to the eye, whatever the viewport's
shading is; it follows the object and its pose.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import bpy
import gpu
import numpy as np
from bpy.types import Mesh, Object
from mathutils import Vector

from zoomout_core.arrays import Floats

from .mesh_data.arrays import read_array

# By how much of the depth range a coat is nearer than what it covers.
NEARER = 2e-5
# Squares of the checker across the UV map.
SQUARES = 16

VERTEX = """
void main()
{
  shade = abs(dot(normalize(normal), towards));
  paint = color;
  gl_Position = ModelViewProjectionMatrix * vec4(position, 1.0);
  gl_Position.z -= nearer * gl_Position.w;
}
"""
# Colours are UVs where there are squares: dark and light ones take turns, and the hue tells where in the map.
FRAGMENT = """
void main()
{
  vec3 seen = paint;
  if (squares > 0.0) {
    vec2 square = floor(paint.xy * squares);
    float light = mod(square.x + square.y, 2.0);
    seen = mix(vec3(0.12 + 0.55 * paint.x, 0.16, 0.12 + 0.55 * paint.y),
               vec3(0.95, 0.95 - 0.4 * paint.x, 0.95 - 0.4 * paint.y), light);
  }
  seen *= 0.45 + 0.55 * shade;
  result = vec4(srgbTarget ? pow(seen, vec3(2.2)) : seen, 1.0);
}
"""


@dataclass(frozen=True, eq=False)
class Coat:
    """Colours for one object.

    Attributes:
        object_name: of the object.
        values: (n, 3) colours of vertices, or (c, 2) UVs of face corners, of the mesh that its modifiers leave.
    """

    object_name: str
    values: Floats

    @property
    def on_corners(self) -> bool:
        """Whether values are UVs, of face corners."""
        return self.values.shape[1] == 2


_coats: tuple[Coat, ...] = ()
# What is drawn of each coat, by the object's name; None where it does not fit the object.
_batches: dict[str, gpu.types.GPUBatch | None] = {}
_handler: Any = None


def show(coats: Sequence[Coat]) -> None:
    """Draw coats, in place of others."""
    global _coats, _handler
    _coats = tuple(coats)
    _batches.clear()
    if _handler is None:
        _handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")
    _redraw()


def clear() -> None:
    """Draw none."""
    global _coats, _handler
    if _handler is None:
        return
    bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
    _coats, _handler = (), None
    _batches.clear()
    _redraw()


def shown() -> tuple[Coat, ...]:
    """What is drawn."""
    return _coats


def repose(names: Iterable[str] | None = None) -> None:
    """Have coats of objects, or of all, laid on anew: their modifiers move them."""
    for name in list(_batches) if names is None else names:
        _batches.pop(name, None)


def surface_of(mesh: Mesh, coat: Coat) -> dict[str, np.ndarray] | None:
    """What is drawn of a mesh, as arrays: `position`, `normal` and `color` (p, 3), and `triangles` (m, 3) of these.

    None where the coat is one of another mesh.
    """
    vertices, corners = len(mesh.vertices), len(mesh.loops)
    if len(coat.values) != (corners if coat.on_corners else vertices):
        return None
    mesh.calc_loop_triangles()
    position = read_array(mesh.vertices, "co", np.float32, 3)
    normal = read_array(mesh.vertex_normals, "vector", np.float32, 3)
    color = coat.values.astype(np.float32)
    if coat.on_corners:
        vertex = read_array(mesh.loops, "vertex_index", np.int32)
        position, normal = position[vertex], normal[vertex]
        color = np.column_stack([color, np.zeros(corners, np.float32)])
    triangles = read_array(mesh.loop_triangles, "loops" if coat.on_corners else "vertices", np.int32, 3)
    return {"position": position, "normal": normal, "color": color, "triangles": triangles}


def _draw() -> None:
    context = bpy.context
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.depth_mask_set(True)
    for coat in _coats:
        obj = context.view_layer.objects.get(coat.object_name)
        if obj is not None and obj.mode != "EDIT" and obj.visible_in_viewport_get(context.space_data):
            _draw_coat(coat, obj.evaluated_get(context.evaluated_depsgraph_get()))
    gpu.state.depth_mask_set(False)
    gpu.state.depth_test_set("NONE")


def _draw_coat(coat: Coat, evaluated: Object) -> None:
    if coat.object_name not in _batches:
        surface = surface_of(evaluated.data, coat)
        _batches[coat.object_name] = None if surface is None else _batch(surface)
    batch = _batches[coat.object_name]
    if batch is None:
        return
    shader, view = _shader(), bpy.context.region_data
    seen_from = view.view_rotation @ Vector((0, 0, 1))
    towards = (evaluated.matrix_world.to_3x3().transposed() @ seen_from).normalized()
    with gpu.matrix.push_pop():
        gpu.matrix.multiply_matrix(evaluated.matrix_world)
        shader.bind()
        shader.uniform_float("towards", towards)
        shader.uniform_float("nearer", NEARER)
        shader.uniform_float("squares", SQUARES if coat.on_corners else 0)
        batch.draw(shader)


def _batch(surface: dict[str, np.ndarray]) -> gpu.types.GPUBatch:
    layout = gpu.types.GPUVertFormat()
    for name in ("position", "normal", "color"):
        layout.attr_add(id=name, comp_type="F32", len=3, fetch_mode="FLOAT")
    vertices = gpu.types.GPUVertBuf(layout, len(surface["position"]))
    for name in ("position", "normal", "color"):
        vertices.attr_fill(name, np.ascontiguousarray(surface[name]))
    triangles = gpu.types.GPUIndexBuf(type="TRIS", seq=np.ascontiguousarray(surface["triangles"]))
    return gpu.types.GPUBatch(type="TRIS", buf=vertices, elem=triangles)


@cache
def _shader() -> gpu.types.GPUShader:
    passed = gpu.types.GPUStageInterfaceInfo("zoomout_coat")
    passed.smooth("VEC3", "paint")
    passed.smooth("FLOAT", "shade")
    info = gpu.types.GPUShaderCreateInfo()
    info.push_constant("MAT4", "ModelViewProjectionMatrix")
    info.push_constant("BOOL", "srgbTarget")  # which Blender sets: whether it turns colours into sRGB itself
    info.push_constant("VEC3", "towards")
    info.push_constant("FLOAT", "nearer")
    info.push_constant("FLOAT", "squares")
    for slot, name in enumerate(("position", "normal", "color")):
        info.vertex_in(slot, "VEC3", name)
    info.vertex_out(passed)
    info.fragment_out(0, "VEC4", "result")
    info.vertex_source(VERTEX)
    info.fragment_source(FRAGMENT)
    return gpu.shader.create_from_info(info)


def _redraw() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
