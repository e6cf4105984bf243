# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources with all kinds of data, and targets with known true data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import radians
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler
from scipy.sparse.csgraph import dijkstra

import zoomout_core as zo
from benchmarks.generate.remeshing import isotropic
from benchmarks.transfer.regions import bones, faces_of, islands, regions
from blender_addon import mesh_data
from blender_addon.demo.character import PAINT, UV_MAP, build_character, rig, unwrap_islands
from blender_addon.demo.target import clear_pose, posed_copy, set_pose
from blender_addon.demo.truth import Truth, find_truth
from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.triangles import edge_graph, triangle_areas, unique_edges, vertex_normals
from zoomout_core.transfer.uv.chart import uv_seams

# In folders of many shapes, every n-th one is used.
EVERY = 7
# Numbers of generated islands, bones and other data of a shape.
BONES, ISLANDS, MATERIALS, KEYS = 20, 14, 25, 3
# Maximum rotation of bones in degrees.
TURN = 30
# Maximum displacement of a shape key, relative to the square root of the area.
SWELLING = 0.03
# Edge length of the demo's character, in metres.
CELL = 0.02
# Ratio of the target's vertices to the source's.
THINNED = 0.6


@dataclass(frozen=True, eq=False)
class Case:
    """A source and a target.

    Attributes:
        name: name of the shape.
        pose: the target's pose, "same" or "other".
        source: the object with the data.
        target: an object without data, which is copied for each method.
        truth: the target's true UVs, weights and colours.
        material: (f,) the true material slot of each face of the target.
        keys: (n_t, keys, 3) the target's true offsets.
        seam: the length of the source's seams, measured in the target's pose.
        aligned: (4, 4) the rigid motion that best aligns the target with the source.
    """

    name: str
    pose: str
    source: bpy.types.Object
    target: bpy.types.Object
    truth: Truth
    material: Integers
    keys: Floats
    seam: float
    aligned: Floats


def make_cases(data: Path, max_count: int | None, seed: int = 0) -> Iterator[Case]:
    """The demo's character and the shapes of a folder, each with remeshed versions in its own and another pose."""
    shapes: list[tuple[Path | None, Path | None]] = [(None, None), *_same_vertices(data / "tosca_full")]
    for folder in ("faust_r", "tosca_r"):
        shapes += [(path, None) for path in sorted((data / folder).glob("*.off"))[::EVERY]]
    if max_count is not None and max_count < len(shapes):
        shapes = [shapes[i] for i in np.linspace(0, len(shapes) - 1, max_count).round().astype(int)]
    for path, other in shapes:
        for pose in ("other", "same"):
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            source, posed = _demo_character() if path is None else _shape(path, other, seed)
            name = "character" if path is None else path.stem
            yield _case(name, pose, source, posed if pose == "other" else mesh_data.read_positions(source.data))


def _same_vertices(folder: Path) -> Iterator[tuple[Path, Path]]:
    """Pairs of files whose names agree up to the first digit, each file once."""
    paths = sorted(folder.glob("*.off"))
    kinds = sorted({path.stem.rstrip("0123456789") for path in paths})
    for kind in kinds:
        members = [path for path in paths if path.stem.rstrip("0123456789") == kind]
        yield from zip(members[::2], members[1::2], strict=False)


# --- sources ------------------------------------------------------------------------------------------------


def _demo_character() -> tuple[bpy.types.Object, Floats]:
    """Build the demo's character at rest, and its vertices in the demo's pose."""
    character, armature = build_character(CELL)
    set_pose(armature)
    positions = _posed_positions(character)
    clear_pose(armature)
    _dress(character)
    return character, positions


def _shape(path: Path, other: Path | None, seed: int) -> tuple[bpy.types.Object, Floats]:
    """Load a shape of unit area, with UVs, weights and the other data, and its vertices in another pose.

    Args:
        path: file of the shape.
        other: file of the same mesh in another pose; without one, the bones are turned.
        seed: for the turns.
    """
    surface = zo.read_surface(path)
    scale = 1 / np.sqrt(surface.area)
    vertices = scale * (surface.vertices - surface.vertices.mean(axis=0))
    mesh = bpy.data.meshes.new(path.stem)
    mesh.from_pydata(vertices, [], surface.triangles)
    mesh.shade_smooth()
    obj = bpy.data.objects.new(path.stem, mesh)
    bpy.context.scene.collection.objects.link(obj)
    _unwrap(obj, vertices, surface.triangles)
    _paint(mesh, vertices)
    armature = rig(obj, bones(vertices, surface.triangles, regions(vertices, surface.triangles, BONES)))
    _dress(obj)
    if other is not None:
        positions = zo.read_surface(other).vertices
        return obj, scale * (positions - positions.mean(axis=0))
    random = np.random.default_rng(seed)
    for bone in armature.pose.bones[1:]:
        bone.rotation_mode = "QUATERNION"
        bone.rotation_quaternion = Euler([radians(a) for a in random.uniform(-TURN, TURN, 3)]).to_quaternion()
    bpy.context.view_layer.update()
    positions = _posed_positions(obj)
    for bone in armature.pose.bones:
        bone.rotation_quaternion = (1, 0, 0, 0)
    bpy.context.view_layer.update()
    return obj, positions


def _posed_positions(obj: bpy.types.Object) -> Floats:
    posed = posed_copy(obj)
    positions = mesh_data.read_positions(posed.data).astype(float)
    bpy.data.meshes.remove(posed.data)
    return positions


def _unwrap(obj: bpy.types.Object, vertices: Floats, triangles: Integers) -> None:
    """An atlas of a few islands."""
    edges, _ = unique_edges(triangles)
    seam = islands(vertices, triangles, faces_of(regions(vertices, triangles, ISLANDS), triangles))
    marked = {tuple(edge) for edge in edges[seam].tolist()}
    for edge in obj.data.edges:
        edge.use_seam = tuple(sorted(edge.vertices)) in marked
    unwrap_islands(obj)


def _paint(mesh: bpy.types.Mesh, vertices: Floats) -> None:
    """Paint smooth stripes in all three directions, eight over the shape's longest side."""
    wave = 2 * np.pi * 8 * vertices / np.ptp(vertices, axis=0).max()
    layer = mesh.color_attributes.new(PAINT, "FLOAT_COLOR", "POINT")
    layer.data.foreach_set("color", np.column_stack([0.5 + 0.5 * np.sin(wave), np.ones(len(wave))]).ravel())


def _dress(obj: bpy.types.Object) -> None:
    """Add materials in patches, and shape keys that each inflate one place."""
    vertices, triangles = _triangulate(obj)
    region = regions(vertices, triangles, MATERIALS)
    for i in range(MATERIALS):
        obj.data.materials.append(bpy.data.materials.new(f"Material {i}"))
    corner = np.empty(len(obj.data.polygons), dtype=np.int32)
    obj.data.polygons.foreach_get("loop_start", corner)
    vertex = np.empty(len(obj.data.loops), dtype=np.int32)
    obj.data.loops.foreach_get("vertex_index", vertex)
    obj.data.polygons.foreach_set("material_index", region[vertex[corner]].astype(np.int32))
    obj.shape_key_add(name="Basis")
    strength = _strengths(vertices, triangles)
    area = triangle_areas(vertices, triangles).sum()
    offsets = SWELLING * np.sqrt(area) * strength[:, :, None] * vertex_normals(vertices, triangles)[:, None]
    for i in range(KEYS):
        key = obj.shape_key_add(name=f"Swelling {i}")
        key.value = 0  # Blender 5 plays new keys
        key.data.foreach_set("co", (vertices + offsets[:, i]).astype(np.float32).ravel())


def _triangulate(obj: bpy.types.Object) -> tuple[Floats, Integers]:
    mesh = obj.data
    mesh.calc_loop_triangles()
    triangles = np.empty(3 * len(mesh.loop_triangles), dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    return mesh_data.read_positions(mesh).astype(np.float64), triangles.reshape(-1, 3).astype(np.int64)


def _strengths(vertices: Floats, triangles: Integers) -> Floats:
    """(n, keys) strength of each key at each vertex: 1 in the middle of a region, 0 at its border and outside."""
    region = regions(vertices, triangles, 2 * KEYS)
    graph = edge_graph(vertices, triangles)
    strength = np.zeros((len(vertices), KEYS))
    for i in range(KEYS):
        inwards = dijkstra(graph, indices=np.flatnonzero(region != i), min_only=True)
        part = np.where(np.isfinite(inwards), inwards, 0) / inwards[np.isfinite(inwards)].max()
        strength[:, i] = part * part * (3 - 2 * part)
    return strength


# --- targets ------------------------------------------------------------------------------------------------


def _case(name: str, pose: str, source: bpy.types.Object, posed: Floats) -> Case:
    """The case of a source whose vertices are at `posed` (n_s, 3) in the target's pose."""
    rest, triangles = _triangulate(source)
    count = round(THINNED * len(posed))
    remeshed = isotropic(zo.Surface(posed, triangles), count, np.random.default_rng(0))
    mesh = bpy.data.meshes.new("Target")
    mesh.from_pydata(remeshed.vertices, [], remeshed.triangles)
    mesh.shade_smooth()
    target = bpy.data.objects.new("Target", mesh)
    bpy.context.scene.collection.objects.link(target)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    source_surface = mesh_data.read_source_surface(source, depsgraph)
    target_surface = mesh_data.read_target_surface(target, depsgraph)
    truth = find_truth(source, source_surface, posed, target_surface)

    middle = target_surface.vertices[target_surface.triangles].mean(axis=1)
    triangle, _ = closest_points(middle, posed, source_surface.triangles)
    _, slots = mesh_data.read_materials(source, source.data)
    swelling = SWELLING * np.sqrt(source_surface.area) * _strengths(rest, triangles)[:, :, None]
    begin, end = seams(source, source_surface).T
    return Case(
        name=name,
        pose=pose,
        source=source,
        target=target,
        truth=truth,
        material=slots.values[source_surface.triangle_face[triangle]],
        keys=truth.surface_map.interpolate(swelling * vertex_normals(posed, triangles)[:, None]),
        seam=float(np.linalg.norm(posed[begin] - posed[end], axis=1).sum()),
        aligned=rigid_motion(posed, rest),
    )


def seams(obj: bpy.types.Object, surface: zo.Surface) -> Integers:
    """(s, 2) vertices of the edges that are seams of the object's UV map."""
    uv = mesh_data.read_layer(obj.data, UV_MAP).attribute.values.astype(float)
    return surface.edges[uv_seams(surface, uv)]


def rigid_motion(points: Floats, onto: Floats) -> Floats:
    """(4, 4) the least-squares rigid motion of points (n, 3) onto others (Kabsch 1976)."""
    centre, other = points.mean(axis=0), onto.mean(axis=0)
    u, _, v = np.linalg.svd((points - centre).T @ (onto - other))
    turn = (u * [1, 1, np.linalg.det(u @ v)]) @ v
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn.T, other - centre @ turn
    return motion
