# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture of a checker texture on a limb with a seam: the source, our result, and Data Transfer's."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector
from PIL import Image

import zoomout_core as zo
from benchmarks.transfer.cases import rigid_motion, seams
from blender_addon import jobs, mesh_data
from blender_addon.demo import Size, make_demo_objects
from blender_addon.demo.baseline import transfer_best
from blender_addon.demo.picture import FAINT, INK, checker_material, ink, light, link, render, write
from blender_addon.scene.pair import read_pair
from blender_addon.services.matching.match import match_objects
from blender_addon.services.matching.seam_cut import cut_seams
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_match
from zoomout_core.arrays import Booleans, Floats

# A coarse target, which shows how a seam crosses faces.
SIZE = Size(cell=0.0134, voxel=0.0125, target_vertices=7000)
LIMB = ("upper_arm.L", "forearm.L", "hand.L", "thumb.L", "index.L", "middle.L", "ring.L")
# At rest an arm is parallel to the x axis; it is seen from below, where its seam is, with the front up.
FROM_BELOW = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
# Distances in metres, and the size of the picture.
DOWN, ACROSS, SEAM = 0.245, 0.76, 0.0014
WIDTH, SAMPLES, COLORS = 940, 24, 256


def draw(path: Path, size: Size = SIZE, width: int = WIDTH) -> None:
    """Match and transfer the demo's character in Blender, and render an arm of each result to a PNG file."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    demo = make_demo_objects(size)
    character, truth = demo.character, demo.truth.surface_map
    match_objects(bpy.context, character, demo.target)
    opened = demo.target.copy()
    opened.data = demo.target.data.copy()
    bpy.context.scene.collection.objects.link(opened)
    opened_map = _cut_along_seams(character, opened)
    for target in (demo.target, opened):
        transfer_objects(bpy.context, character, target, ("uv_maps",))
    transfer_best(character, demo.baseline, demo.truth)

    weights = mesh_data.read_weights(character, character.data)
    columns = [weights.labels.index(name) for name in LIMB]
    share, rest = weights.values[:, columns].sum(axis=1), demo.source_surface.vertices
    middle = rest[share > 0.5].mean(axis=0)
    rows = (
        (character, None, "Source", "its checker, and its seams in black"),
        (demo.target, truth, "ZoomOut", "another pose and mesh: each face in one island"),
        (opened, opened_map, "ZoomOut, cut along the seams", "the same, with new vertices where seams cross its edges"),
        (demo.baseline, truth, "Blender’s Data Transfer", "the same: what is nearest in space"),
    )
    objects = list(bpy.context.scene.objects)
    material = checker_material()
    for row, (figure, surface_map, title, subtitle) in enumerate(rows):
        place = Vector((0, 0, -row * DOWN))
        chosen = (share if surface_map is None else surface_map.interpolate(share)) > 0.5
        images = rest if surface_map is None else surface_map.interpolate(rest)
        positions = mesh_data.read_positions(figure.data).astype(float)
        motion = rigid_motion(positions[chosen], images[chosen])
        points = (positions @ motion[:3, :3].T + motion[:3, 3] - middle) @ FROM_BELOW.T
        _show(figure, points, chosen, material, place)
        write(title, place + Vector((0, -0.3, 0.108)), 0.022, INK)
        write(subtitle, place + Vector((0, -0.3, 0.088)), 0.0125, FAINT)
    for obj in objects:
        obj.hide_render = True
    light()
    _aim_camera(len(rows))
    render(path, width, SAMPLES)
    Image.open(path).quantize(COLORS).save(path, optimize=True)


def _cut_along_seams(character: bpy.types.Object, target: bpy.types.Object) -> zo.SurfaceMap:
    """Cut the target along the seams of the matched character, and return the map of the cut target."""
    cut_seams(bpy.context, character, target)
    kept = stored_match.read(target.data, jobs.run(read_pair(bpy.context, character.name, target.name)))
    assert kept is not None, "a mesh that was cut keeps its match"
    return kept.surface_map


def _show(
    figure: bpy.types.Object, points: Floats, chosen: Booleans, material: bpy.types.Material, place: Vector
) -> None:
    """Add the selected part of a figure at new positions, with its seams as lines."""
    surface = mesh_data.read_surface_at_rest(figure)
    mesh = figure.data.copy()
    mesh.vertices.foreach_set("co", points.astype(np.float32).ravel())
    mesh.materials.clear()
    mesh.materials.append(material)
    limb = link(f"Limb of {figure.name}", mesh, place)
    group = limb.vertex_groups.new(name="Limb")
    group.add(np.flatnonzero(chosen).tolist(), 1, "REPLACE")
    limb.modifiers.new("Limb", "MASK").vertex_group = group.name

    curve = bpy.data.curves.new("Seams", "CURVE")
    curve.dimensions, curve.bevel_depth = "3D", SEAM
    for ends in seams(figure, surface):
        if chosen[ends].all():
            spline = curve.splines.new("POLY")
            spline.points.add(1)
            spline.points.foreach_set("co", np.column_stack([points[ends], [1, 1]]).ravel())
    curve.materials.append(ink((0, 0, 0)))
    link("Seams", curve, place)


def _aim_camera(rows: int) -> None:
    """Add an orthographic camera in front of the rows."""
    scene = bpy.context.scene
    height = rows * DOWN
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, round(WIDTH * height / ACROSS)
    lens = bpy.data.cameras.new("Camera")
    lens.type, lens.ortho_scale = "ORTHO", max(ACROSS, height)
    camera = link("Camera", lens, Vector((0, -5, 0.13 - height / 2)))
    camera.matrix_world = Matrix.Translation(camera.location) @ Matrix.Rotation(np.pi / 2, 4, "X")
    scene.camera = camera
