# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours drawn over objects in the 3D views, without changing the file.

An overlay is drawn on the evaluated mesh of an object, with a small depth offset towards the viewer, in any viewport
shading. It follows the object's transform, pose and name. If modifiers change the vertices, they compute its colours,
too, see `evaluated_values.py`. It is hidden with the viewport's other overlays, outside Object Mode, and while any mesh
differs from the one that its overlay was computed for.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import bpy
import gpu
import numpy as np
from bpy.types import Mesh, Object
from mathutils import Vector

from ..mesh_data.arrays import read_array
from ..scene.mesh_facts import facts
from ..scene.redraw import redraw_views
from . import evaluated_values

if TYPE_CHECKING:
    from zoomout_core.arrays import Floats, Integers
    from zoomout_core.transfer.uv.seam_cut import SeamCut

# Depth offset of overlays towards the viewer, as a fraction of the depth range.
NEARER = 2e-5
# Number of checker squares across the UV map.
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
# Letters for the columns of the checker and digits for its rows: five rows of three dots, from the top.
GLYPHS = [
    "010101111101101",
    "110101110101110",
    "011100100100011",
    "110101101101110",
    "111100110100111",
    "111100110100100",
    "011100101101011",
    "101101111101101",
    "111010010010111",
    "001001001101010",
    "101101110101101",
    "100100100100111",
    "101111111101101",
    "110101101101101",
    "010101101101010",
    "110101110100100",
    "111101101101111",
    "010110010010111",
    "110001010100111",
    "110001010001110",
    "101101111001001",
    "111100110001110",
    "011100111101111",
    "111001010010010",
    "111101111101111",
    "111101111001110",
]
_CASES = "\n".join(f"  if (number == {number}) {{ return {int(dots, 2)}; }}" for number, dots in enumerate(GLYPHS))
# With `squares` above 0, colours are UVs, drawn as a checker whose hue varies with the position in the UV map.
# Squares that appear large enough have a letter and a digit, or an arrow to the top of the UV map with one barb on its
# right. These turn and mirror with the UVs.
FRAGMENT = """
int glyph(int number)
{
GLYPHS
  return 0;
}

bool inked(vec2 place, vec2 square, bool lettered)
{
  int x = int(place.x), y = int(place.y);
  if (!lettered) {
    return (x == 4 && y > 0 && y < 8) || (x == 5 && y == 6) || (x == 6 && y == 5);
  }
  if (y < 2 || y > 6 || x < 1 || x > 7 || x == 4) {
    return false;
  }
  int number = x < 4 ? int(mod(square.x, 16.0)) : 16 + int(mod(square.y, 10.0));
  int column = x < 4 ? x - 1 : x - 5;
  return ((glyph(number) >> ((y - 2) * 3 + 2 - column)) & 1) == 1;
}

void main()
{
  vec3 seen = paint;
  if (squares > 0.0) {
    vec2 square = floor(paint.xy * squares);
    float light = mod(square.x + square.y, 2.0);
    vec2 dots = paint.xy * squares * 9.0;
    vec2 wide = fwidth(dots);
    if (max(wide.x, wide.y) < 1.0 && inked(mod(floor(dots), 9.0), square, light < 0.5)) {
      light = 1.0 - light;
    }
    seen = mix(vec3(0.12 + 0.55 * paint.x, 0.16, 0.12 + 0.55 * paint.y),
               vec3(0.95, 0.95 - 0.4 * paint.x, 0.95 - 0.4 * paint.y), light);
  }
  seen *= 0.45 + 0.55 * shade;
  result = vec4(srgbTarget ? pow(seen, vec3(2.2)) : seen, 1.0);
}
""".replace("GLYPHS", _CASES)


@dataclass(frozen=True, eq=False)
class Divided:
    """A mesh as a cut would divide its faces.

    Attributes:
        cut: the cut, which gives the positions of new vertices.
        corner_vertex: (c,) vertex of each corner after the cut.
        triangle_corners: (m, 3) corners of the triangles after the cut.
    """

    cut: SeamCut
    corner_vertex: Integers
    triangle_corners: Integers


@dataclass(frozen=True, eq=False)
class Overlay:
    """Colours for one object.

    Attributes:
        object_uid: `session_uid` of the object, which renaming does not change.
        values: (n, 3) colours of vertices, or (c, 2) UVs of face corners, of the object's own or its evaluated mesh.
        content: hash of the object's own mesh, see `mesh_data.content_hash`.
        divided: the mesh after a cut, if the values are of its corners; None to draw the mesh as it is.
    """

    object_uid: int
    values: Floats
    content: str
    divided: Divided | None = None

    @property
    def on_corners(self) -> bool:
        """Whether values are UVs of face corners."""
        return self.values.shape[1] == 2


_overlays: tuple[Overlay, ...] = ()
# GPU batches of overlays, by the object's `session_uid`.
_batches: dict[int, gpu.types.GPUBatch] = {}
# Last known names of objects, by their `session_uid`.
_names: dict[int, str] = {}
_handler: Any = None


def show(overlays: Sequence[Overlay]) -> None:
    """Draw overlays, and no others."""
    global _overlays, _handler
    _overlays = tuple(overlays)
    _batches.clear()
    evaluated_values.clear()
    if _handler is None:
        _handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")
    redraw_views()


def clear() -> None:
    """Stop drawing overlays."""
    global _overlays, _handler
    if _handler is None:
        return
    bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
    _overlays, _handler = (), None
    _batches.clear()
    _names.clear()
    evaluated_values.clear()
    redraw_views()


def overlays() -> tuple[Overlay, ...]:
    """The current overlays."""
    return _overlays


def find(uid: int) -> Object | None:
    """The object in the view layer with a `session_uid`, or None."""
    objects = bpy.context.view_layer.objects  # contains None for each object that was just removed
    obj = objects.get(_names.get(uid, ""))
    if obj is None or obj.session_uid != uid:
        obj = next((one for one in objects if one is not None and one.session_uid == uid), None)
    if obj is not None:
        _names[uid] = obj.name
    return obj


def repose(uids: Iterable[int] | None = None) -> None:
    """Rebuild the batches of some or all objects, because their modifiers may have moved them."""
    for uid in list(_batches) if uids is None else uids:
        _batches.pop(uid, None)


def visible() -> list[tuple[Overlay, Object]]:
    """The visible overlays, each with its object; none if one is outdated."""
    return [] if is_outdated() else [(overlay, obj) for overlay, obj in _find_overlays() if obj.mode == "OBJECT"]


def is_hidden() -> bool:
    """Whether an object is in a mode that hides its overlay."""
    return any(obj.mode != "OBJECT" for _, obj in _find_overlays())


def is_lost() -> bool:
    """Whether the modifiers of an object are known to lose its overlay's values."""
    return any(evaluated_values.is_lost(obj) for _, obj in _find_overlays())


def is_outdated() -> bool:
    """Whether a mesh is known to differ from the one that its overlay was computed for."""
    return any(
        (known := facts(obj)) is not None and known.content != overlay.content for overlay, obj in _find_overlays()
    )


def visible_surface(overlay: Overlay, obj: Object, evaluated: Object) -> dict[str, np.ndarray] | None:
    """`surface_of` the evaluated mesh of an object, even if its vertices are not the overlay's."""
    if overlay.divided is not None:  # modifiers cannot compute values of faces that do not exist yet
        same = len(evaluated.data.vertices) == len(obj.data.vertices)
        return _divided_surface(evaluated.data if same else obj.data, overlay.divided, overlay.values)
    values = evaluated_values.values_on(obj, evaluated, overlay.values)
    return None if values is None else surface_of(evaluated.data, replace(overlay, values=values))


def surface_of(mesh: Mesh, overlay: Overlay) -> dict[str, np.ndarray] | None:
    """Arrays to draw a mesh: `position`, `normal` and `color` (p, 3), and `triangles` (m, 3) of these.

    None if the overlay belongs to another mesh.
    """
    vertices, corners = len(mesh.vertices), len(mesh.loops)
    if len(overlay.values) != (corners if overlay.on_corners else vertices):
        return None
    mesh.calc_loop_triangles()
    position = read_array(mesh.vertices, "co", np.float32, 3)
    normal = read_array(mesh.vertex_normals, "vector", np.float32, 3)
    color = overlay.values.astype(np.float32)
    if overlay.on_corners:
        vertex = read_array(mesh.loops, "vertex_index", np.int32)
        position, normal = position[vertex], normal[vertex]
        color = np.column_stack([color, np.zeros(corners, np.float32)])
    triangles = read_array(mesh.loop_triangles, "loops" if overlay.on_corners else "vertices", np.int32, 3)
    return {"position": position, "normal": normal, "color": color, "triangles": triangles}


def _divided_surface(mesh: Mesh, divided: Divided, uv: Floats) -> dict[str, np.ndarray]:
    """The arrays of `surface_of` for a mesh after a cut."""
    position, normal = (
        divided.cut.interpolate(values)[divided.corner_vertex].astype(np.float32)
        for values in (
            read_array(mesh.vertices, "co", np.float32, 3),
            read_array(mesh.vertex_normals, "vector", np.float32, 3),
        )
    )
    color = np.column_stack([uv, np.zeros(len(uv))]).astype(np.float32)
    triangles = divided.triangle_corners.astype(np.int32)
    return {"position": position, "normal": normal, "color": color, "triangles": triangles}


def _find_overlays() -> list[tuple[Overlay, Object]]:
    return [(overlay, obj) for overlay in _overlays if (obj := find(overlay.object_uid)) is not None]


def _draw() -> None:
    context = bpy.context
    if not context.space_data.overlay.show_overlays:
        return
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.depth_mask_set(True)
    for overlay, obj in visible():
        if obj.visible_in_viewport_get(context.space_data):
            _draw_overlay(overlay, obj, obj.evaluated_get(context.evaluated_depsgraph_get()))
    gpu.state.depth_mask_set(False)
    gpu.state.depth_test_set("NONE")


def _draw_overlay(overlay: Overlay, obj: Object, evaluated: Object) -> None:
    if overlay.object_uid not in _batches:
        surface = visible_surface(overlay, obj, evaluated)
        if surface is None:
            return
        _batches[overlay.object_uid] = _batch(surface)
    batch = _batches[overlay.object_uid]
    seen_from = bpy.context.region_data.view_rotation @ Vector((0, 0, 1))
    with gpu.matrix.push_pop():
        gpu.matrix.multiply_matrix(evaluated.matrix_world)
        _draw_batch(batch, overlay, evaluated.matrix_world.to_3x3().transposed() @ seen_from)


def _draw_batch(batch: gpu.types.GPUBatch, overlay: Overlay, towards: Vector) -> None:
    """Draw the batch of an overlay, seen from a direction in the object's space."""
    shader = _shader()
    shader.bind()
    shader.uniform_float("towards", towards.normalized())
    shader.uniform_float("nearer", NEARER)
    shader.uniform_float("squares", SQUARES if overlay.on_corners else 0)
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
    info.push_constant("BOOL", "srgbTarget")  # set by Blender: whether it converts colours to sRGB itself
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
