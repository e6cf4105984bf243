# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked textures beside Cycles, which bakes from selected to active with a cage: where poses differ, and where not.

The source's image shows a color of the place at rest, so that the right color of each texel of the target is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from time import process_time
from typing import Any

import bpy
import numpy as np
from bpy.types import Image, Material, Node, Object
from PIL import Image as Picture
from scipy.ndimage import distance_transform_edt

import zoomout_core as zo
from blender_addon import mesh_data, registered
from blender_addon.demo.character import build_character, select_only
from blender_addon.demo.target import POSE, clear_pose, posed_copy, remeshed, set_pose
from blender_addon.demo.truth import find_truth
from blender_addon.services.bake import Baking, bake_textures
from blender_addon.services.matching.match import match_objects
from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.transfer.uv.texels import texels_of

Row = dict[str, Any]

# Width and height of all images, in texels.
SIZE = 512
# Wavelength of the colors on the character at rest, in metres, and the difference of a channel from which a texel is
# wrong: colors change by it within about 6 millimetres.
WAVELENGTH, WRONG = 0.2, 0.1
# Distances of the cage along the normals, in metres, of which the one with the best image is taken: an artist tries
# them, too.
CAGES = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)
# Distance from its centre, in texels, from which the place that a texel is read at is beyond its triangle.
ROUNDING = 1e-3
# Texels beyond the islands that Cycles fills.
MARGIN = 4


def bake_both(cell: float, voxel: float, vertices: int, pictures: Path | None = None) -> list[Row]:
    """Bake the character's colors onto remeshed copies in the same pose and in another one.

    Args:
        cell: edge length of the character, in metres.
        voxel: size of the voxels of which its copies are rebuilt, in metres.
        vertices: number of their vertices.
        pictures: a folder for images of the atlases: the truth, the two bakes, and their wrong texels.
    """
    rows = []
    poses: dict[str, Mapping[str, tuple[float, float, float]]] = {"the same": {}, "another": POSE}
    for name, pose in poses.items():
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        case = _Case(cell, voxel, vertices, pose)
        made = {"zoomout": case.bake(), **{f"Cycles, cage {each:g} m": case.bake_by_cycles(each) for each in CAGES}}
        errors = {way: case.compare(image) for way, (image, _) in made.items()}
        best = max((way for way in made if way != "zoomout"), key=lambda way: errors[way]["PSNR dB"])
        for way in ("zoomout", best):
            rows.append({"pose": name, "baked by": way, **errors[way], "CPU s": made[way][1]})
        if pictures is not None:
            pictures.mkdir(parents=True, exist_ok=True)
            case.draw([made[way][0] for way in ("zoomout", best)], pictures / f"bakes_{name.replace(' ', '_')}.png")
    return rows


class _Case:
    """The character with an image of its colors, and a copy of it with an atlas of its own.

    Attributes:
        row, column: (q,) the texels of the target's atlas, from the bottom.
        truth: (q, 3) their right colors.
        known: (q,) whether a triangle covers the texel's centre, at a place that is certain; in folds, surfaces that
            face different ways meet.
    """

    def __init__(
        self, cell: float, voxel: float, vertices: int, pose: Mapping[str, tuple[float, float, float]]
    ) -> None:
        self.source, rig = build_character(cell)
        set_pose(rig, pose)
        posed = posed_copy(self.source)
        self.target = remeshed(posed, voxel, vertices)
        positions = mesh_data.read_positions(posed.data).astype(float)
        bpy.data.meshes.remove(posed.data)
        clear_pose(rig)
        _unwrap(self.target)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        surface = mesh_data.read_source_surface(self.source, depsgraph)
        target = mesh_data.read_target_surface(self.target, depsgraph)
        truth = find_truth(self.source, surface, positions, target)

        colors, _ = _paint(surface, _uv_of(self.source), surface.vertices)
        self.material = _material(colors)
        self.source.data.materials.append(self.material)
        places = truth.surface_map.interpolate(surface.vertices)
        image, (self.row, self.column, triangle, covered) = _paint(target, _uv_of(self.target), places)
        self.truth = image[self.row, self.column]
        self.known: Booleans = covered & truth.known[target.triangles[triangle]].all(axis=1)
        self.image = image

    def bake(self) -> tuple[Floats, float]:
        """The image that a match and *Bake Textures* give, and processor seconds of both."""
        begin = process_time()
        with registered():
            match_objects(bpy.context, self.source, self.target)
            report = bake_textures(bpy.context, self.target, Baking(size=SIZE))
        found = _read(bpy.data.images[report["images"]["Base Color"]])
        return found, process_time() - begin

    def bake_by_cycles(self, cage: float) -> tuple[Floats, float]:
        """The image that Cycles bakes with a cage at a distance, and processor seconds."""
        image = bpy.data.images.new("Cycles", SIZE, SIZE, float_buffer=True)
        image.colorspace_settings.name = "Non-Color"
        self.target.data.materials.clear()
        material, node = _material_with(image)
        material.node_tree.nodes.active = node
        self.target.data.materials.append(material)
        select_only(self.target, self.source)
        scene = bpy.context.scene
        scene.render.engine, scene.cycles.samples = "CYCLES", 1
        begin = process_time()
        bpy.ops.object.bake(
            type="DIFFUSE",
            pass_filter={"COLOR"},
            use_selected_to_active=True,
            use_cage=True,
            cage_extrusion=cage,
            margin=MARGIN,
        )
        return _read(image), process_time() - begin

    def compare(self, image: Floats) -> Row:
        """The peak signal-to-noise ratio of an image, and the share of texels with a wrong color."""
        off = np.abs(image[self.row, self.column] - self.truth)[self.known]
        return {
            "PSNR dB": float(-10 * np.log10((off**2).mean())),
            "wrong texels %": 100 * float((off.max(axis=1) > WRONG).mean()),
            "texels": int(self.known.sum()),
        }

    def draw(self, images: list[Floats], path: Path) -> None:
        """Write the true atlas and the bakes side by side, and below each bake its wrong texels in red."""
        columns = [np.vstack([np.ones_like(self.image), self.image])]
        for image in images:
            wrong = np.ones_like(image)
            off = (np.abs(image[self.row, self.column] - self.truth).max(axis=1) > WRONG) & self.known
            wrong[self.row, self.column] = np.where(off[:, None], [0.85, 0.1, 0.1], 0.8)
            columns.append(np.vstack([wrong, image]))
        picture = np.hstack(columns)[::-1]
        Picture.fromarray(np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8)).save(path)


def _unwrap(obj: Object) -> None:
    """Give an object an atlas of its own."""
    select_only(obj)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(island_margin=0.005)
    bpy.ops.object.mode_set(mode="OBJECT")


def _uv_of(obj: Object) -> Floats:
    """(c, 2) the UVs of an object's only UV map."""
    (layer,) = obj.data.uv_layers
    return np.asarray(mesh_data.read_layer(obj.data, layer.name, mesh_data.Role.UV_MAP).attribute.values)


def _paint(
    surface: zo.Surface, uv: Floats, places: Floats
) -> tuple[Floats, tuple[Integers, Integers, Integers, Booleans]]:
    """(h, w, 3) an image, from the bottom, of the colors of the places (n, 3) at rest of a surface's vertices.

    Also the rows and columns of the texels in its atlas (c, 2), their triangles, and whether these cover their centres.
    """
    corners = uv[surface.triangle_corners]
    texel, triangle, weights = texels_of(corners, SIZE, SIZE)
    at = np.einsum("qc,qcx->qx", weights, places[surface.triangles[triangle]])
    row, column = np.divmod(texel, SIZE)
    image, empty = np.zeros((SIZE, SIZE, 3)), np.ones((SIZE, SIZE), dtype=bool)
    image[row, column] = 0.5 + 0.5 * np.sin(2 * np.pi * at / WAVELENGTH + [0, 1, 2])
    empty[row, column] = False
    nearest = distance_transform_edt(empty, return_distances=False, return_indices=True)
    centre = (np.column_stack([column, row]) + 0.5) / SIZE
    covered = np.abs(np.einsum("qc,qcx->qx", weights, corners[triangle]) - centre).max(axis=1) < ROUNDING / SIZE
    return image[tuple(nearest)], (row, column, triangle, covered)


def _material(colors: Floats) -> Material:
    """A material whose base color is an image (h, w, 3)."""
    image = bpy.data.images.new("Colors", SIZE, SIZE, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    values = np.concatenate([colors, np.ones((SIZE, SIZE, 1))], axis=2)
    image.pixels.foreach_set(values.astype(np.float32).ravel())
    material, node = _material_with(image)
    shader = next(each for each in material.node_tree.nodes if each.type == "BSDF_PRINCIPLED")
    material.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    return material


def _material_with(image: Image) -> tuple[Material, Node]:
    """A material with an image, and its node, which nothing uses yet."""
    material = bpy.data.materials.new(image.name)
    if bpy.app.version < (5, 0):  # later materials always use nodes
        material.use_nodes = True
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    return material, node


def _read(image: Image) -> Floats:
    """(h, w, 3) the texels of an image, from the bottom."""
    values = np.empty(4 * SIZE * SIZE, np.float32)
    image.pixels.foreach_get(values)
    return np.asarray(values.reshape(SIZE, SIZE, 4)[:, :, :3], dtype=np.float64)
