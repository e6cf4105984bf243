# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake the image textures of a source's materials into the target's UV map, along their match."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import bpy
import numpy as np
from bpy.types import Context, Image, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats, Integers
from zoomout_core.messages import message, plural, plural_warning, sentences, warning
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.transfer import Attribute, map_target, transfer_along
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.uv.bake import CornerNormals, Picture, bake, tiles_of
from zoomout_core.transfer.uv.texels import Pixels

from .. import mesh_data
from ..adapters import FILL_BELOW
from ..jobs import compute, pause, run
from ..mesh_data import ImageRole, ImageUse, ObjectPair
from ..scene.pair import check_not_edited, evaluated_sources, name_of, target_mesh
from ..scene.stored_pair import read_stored_match
from .targets import Write

# Fraction of the progress for reading.
READ = 0.1
# UDIM tiles of an atlas: ten in a row, and as many rows.
TILES = 10
# Key of a custom property of images and materials made by baking, with the name of the target.
BAKED_FOR = "zoomout_baked_for"

Tile = tuple[int, int]


@dataclass(frozen=True)
class Baking:
    """How textures are baked.

    Attributes:
        size: width and height of the new images, in texels.
        relief: whether normal maps include relief of the source's mesh that the target's lacks.
        save: whether the images are saved beside the .blend file, in the folder "textures", instead of packed.
        uv_map: the name of the target's UV map; the active one if empty.
    """

    size: int = 2048
    relief: bool = False
    save: bool = False
    uv_map: str = ""


@dataclass(frozen=True, eq=False)
class _Textures:
    """The textures of a source of f faces and m triangles, and the target's atlas.

    Attributes:
        materials: names of the materials, None where a slot is empty.
        face_slots: (f,) numbers of these.
        uses: the image textures of each.
        pictures: the images of each role.
        normals: the normals of both surfaces.
        rest: (n_t, 3) vertices of the target at rest, which its normals refer to.
        uv_map: the name of the target's UV map.
        atlas: (c_t, 2) its UVs.
        left_out: reasons why images are not baked, by their names.
    """

    materials: list[str | None]
    face_slots: Attribute
    uses: list[list[ImageUse]]
    pictures: dict[ImageRole, Picture]
    normals: CornerNormals
    rest: Floats
    uv_map: str
    atlas: Floats
    left_out: dict[str, str]


def bake_textures(context: Context, target: Object, baking: Baking | None = None) -> dict[str, Any]:
    """Bake the textures of the source that a target was matched with into the target's UV map.

    The target gets copies of the source's materials, whose image textures show the new images. Normal maps are rebuilt
    for the target's tangent space. Images of a role, such as Base Color, in several materials become one image.

    Args:
        context: Blender's; the target is in its scene.
        target: the object with a UV map that receives the textures.
        baking: how to bake them.

    Returns:
        A report: `source` and `target` are names, `images` has the names of the new images by their roles, `materials`
        the new materials by the source's, `notes` are sentences.

    Raises:
        MeshError: the target was not matched or has no UV map, or the source has no textures; nothing was written.
    """
    return run(prepare_bake(context, name_of(target), baking or Baking()))()


async def prepare_bake(context: Context, target_name: str, baking: Baking) -> Write[dict[str, Any]]:
    """`bake_textures` without writing: returns a function that writes."""
    folder = _folder() if baking.save else None
    pair, match = await read_stored_match(context, target_name)
    with portion(0, READ), stage("Reading the images", 0, 0):
        textures = await _read_textures(context, pair, baking)
        await pause()
    mapped = map_target(match, pair.source, pair.target, FILL_BELOW)
    with portion(READ, 1):
        images, face_slots, notes = await compute(partial(_bake, mapped, textures, baking.size))

    def write() -> dict[str, Any]:
        _, target = check_not_edited(context, pair)
        beside = None if folder is None else folder.parent
        with mesh_data.all_or_nothing(target) as writing, TemporaryDirectory(dir=beside) as place:
            writing.replace(*_find_baked(target))
            made = _write_images(target, images, None if folder is None else Path(place))
            materials = _write_materials(target, textures, face_slots, made)
            if folder is not None:
                mesh_data.move_images(made.values(), folder)
        return {
            "source": pair.source_name,
            "target": target_name,
            "images": {_label(role): image.name for role, image in made.items()},
            "materials": materials,
            "notes": [*notes, *_notes_on_left_out(textures.left_out)],
        }

    return write


def summary(report: Mapping[str, Any]) -> str:
    """The report in one sentence."""
    done = message(
        "Baked {images} of '{source}' for '{target}'",
        images=plural(len(report["images"]), "{count} image", "{count} images"),
        source=report["source"],
        target=report["target"],
    )
    return sentences(message("{done}.", done=done), *report["notes"]) if report["notes"] else done


def _folder() -> Path:
    """The folder for saved images, which need not exist yet.

    Raises:
        MeshError: the .blend file has no place yet, or the folder cannot be made.
    """
    if not bpy.data.filepath:
        raise zo.MeshError("Save the .blend file first: the images are saved beside it.")
    folder = Path(bpy.data.filepath).parent / "textures"
    try:
        with TemporaryDirectory(dir=folder.parent):
            is_free = folder.is_dir() or not folder.exists()
    except OSError as error:
        raise mesh_data.folder_error(folder) from error
    if not is_free:
        raise mesh_data.folder_error(folder)
    return folder


async def _read_textures(context: Context, pair: ObjectPair, baking: Baking) -> _Textures:
    with target_mesh(context, pair) as (target, mesh):
        layer = _atlas_of(target, baking.uv_map)
        atlas = np.asarray(layer.values, dtype=np.float64)
        rest = mesh_data.positions_in_world(target, mesh_data.read_rest_positions(mesh))
        of_target = mesh_data.read_normals(target, mesh).values
    left_out = dict[str, str]()
    with evaluated_sources(context, pair) as sources:
        materials, face_slots, _ = mesh_data.read_joined_materials(sources)
        uses = [_uses_of(name, left_out) for name in materials]
        of_source = np.concatenate([mesh_data.read_normals(each.evaluated, each.mesh).values for each in sources])
        names = {use.uv_map for each in uses for use in each}
        maps = {name: mesh_data.read_joined_uv(sources, name) for name in names}
    images = dict[str, dict[Tile, Pixels]]()
    for name in dict.fromkeys(use.image for each in uses for use in each):
        images[name] = mesh_data.read_tiles(_by_full_name(bpy.data.images, name))
        await pause()
    if not images:
        raise zo.MeshError(
            "The materials of '{source}' have no image textures to bake: choose another source.",
            source=pair.source_name,
        )
    pictures = _pictures(pair.source, face_slots.values, uses, maps, images)
    normals = CornerNormals(of_source, of_target, baking.relief)
    return _Textures(materials, face_slots, uses, pictures, normals, rest, layer.name, atlas, left_out)


def _atlas_of(target: Object, name: str) -> Attribute:
    """The UV map of a target to bake to.

    Raises:
        MeshError: it has none of this name, or none at all.
    """
    if name and name not in target.data.uv_layers:
        raise zo.MeshError("'{target}' has no UV map '{name}': choose another one.", target=target.name, name=name)
    found = name or mesh_data.read_active_layers(target.data).uv
    if not found:
        raise zo.MeshError("'{target}' has no UV map to bake to: unwrap it first.", target=target.name)
    return mesh_data.read_layer(target.data, found, mesh_data.Role.UV_MAP).attribute


def _uses_of(material: str | None, left_out: dict[str, str]) -> list[ImageUse]:
    """The image textures of a material; those that cannot be baked are added to `left_out`."""
    if material is None:
        return []
    uses, reasons = mesh_data.read_image_uses(_by_full_name(bpy.data.materials, material))
    left_out |= reasons
    return uses


def _by_full_name(blocks: Any, name: str) -> Any:
    """A data-block by its full name, which includes its library's."""
    return next(block for block in blocks if block.name_full == name)


def _pictures(
    source: zo.Surface,
    face_slots: Integers,
    uses: Sequence[Sequence[ImageUse]],
    maps: Mapping[str | None, Floats],
    images: Mapping[str, Mapping[Tile, Pixels]],
) -> dict[ImageRole, Picture]:
    """The picture of each role, from UV maps (c, 2) and images by their names."""
    of_triangle = face_slots[source.corner_face[source.triangle_corners[:, 0]]]
    of_corner = face_slots[source.corner_face]
    found = {}
    for role in dict.fromkeys(use.role for each in uses for use in each):
        number = np.full(len(source.triangles), -1)
        uv, texels = np.zeros((len(source.corner_vertex), 2)), list[Pixels]()
        for slot, each in enumerate(uses):
            for use in (use for use in each if use.role == role):
                here = of_corner == slot
                uv[here] = maps[use.uv_map][here] @ use.placing[:, :2].T + use.placing[:, 2]
                tiles = tiles_of(source, uv)
                for tile, of_tile in images[use.image].items():
                    inside = of_triangle == slot
                    if len(images[use.image]) > 1 or tile != (0, 0):  # an image without tiles repeats
                        inside &= (tiles == tile).all(axis=1)
                    number[inside] = len(texels)
                    texels.append(of_tile)
        found[role] = Picture(texels, number, uv, role.normals)
    return found


def _bake(
    mapped: MappedTarget, textures: _Textures, size: int
) -> tuple[dict[ImageRole, dict[Tile, Pixels]], Attribute, list[str]]:
    """Bake all tiles; returns the images of each role by tiles, the target's materials, and notes."""
    mapped = replace(mapped, target=mapped.target.with_vertices(textures.rest))
    wanted = tiles_of(mapped.target, textures.atlas)
    inside = ((wanted >= 0) & (wanted < TILES)).all(axis=1)
    tiles: list[Tile] = [(column, row) for column, row in np.unique(wanted[inside], axis=0)] or [(0, 0)]
    images: dict[ImageRole, dict[Tile, Pixels]] = {role: {} for role in textures.pictures}
    outside = np.ones(len(wanted), dtype=bool)
    for number, tile in enumerate(tiles):
        with portion(number / len(tiles), (number + 1) / len(tiles)):
            baked = bake(mapped, [*textures.pictures.values()], textures.atlas - tile, size, size, textures.normals)
        outside &= baked.outside
        for role, texels in zip(images, baked.images, strict=True):
            if texels is not None:
                images[role][tile] = texels
    for role, of_role in images.items():
        if of_role:  # a tile without this role is neutral
            blank = np.zeros((size, size, 4), next(iter(of_role.values())).dtype)
            images[role] = {tile: of_role.get(tile, blank) for tile in tiles}
    slots = transfer_along(textures.face_slots, mapped)
    notes = list[str]()
    if outside.any():
        notes.append(
            plural_warning(
                int(outside.sum()),
                "1 triangle is outside of every UDIM tile, and was not baked: move its UVs.",
                "{count:,} triangles are outside of every UDIM tile, and were not baked: move their UVs.",
            )
        )
    return {role: of_role for role, of_role in images.items() if of_role}, slots, notes


def _find_baked(target: Object) -> list[Any]:
    """The materials and images of an earlier bake."""
    return [
        block
        for blocks in (bpy.data.materials, bpy.data.images)
        for block in blocks
        if block.get(BAKED_FOR) == target.name and block.library is None
    ]


def _write_images(
    target: Object, images: Mapping[ImageRole, Mapping[Tile, Pixels]], folder: Path | None
) -> dict[ImageRole, Image]:
    made = {}
    for role, of_role in images.items():
        made[role] = mesh_data.write_image(f"{target.name} {_label(role)}", of_role, role.format, folder)
        made[role][BAKED_FOR] = target.name
    return made


def _write_materials(
    target: Object, textures: _Textures, face_slots: Attribute, images: Mapping[ImageRole, Image]
) -> dict[str, str]:
    """Give the target copies of the source's materials that show the new images; returns their names."""
    used = set(np.unique(face_slots.values).tolist())
    names, made = list[str | None](), dict[str, str]()
    for number, (name, uses) in enumerate(zip(textures.materials, textures.uses, strict=True)):
        shown = {use.node: images[use.role] for use in uses if use.role in images}
        if name is None or number not in used or not shown:
            names.append(name)
            continue
        material = _by_full_name(bpy.data.materials, name)
        copy = mesh_data.copy_with_images(material, f"{material.name} on {target.name}", shown, textures.uv_map)
        copy[BAKED_FOR] = target.name
        names.append(copy.name_full)
        made[material.name] = copy.name
    for slot in target.material_slots:
        slot.link = "DATA"
    target.data.materials.clear()
    mesh_data.write_materials(target, names, face_slots)
    target.data.update()
    return made


def _label(role: ImageRole) -> str:
    """The purpose of images, such as "Base Color"; a number distinguishes several."""
    name = " ".join(role.inputs)
    return f"{name} {role.number + 1}" if role.number else name


def _notes_on_left_out(left_out: Mapping[str, str]) -> list[str]:
    return [
        warning("The image '{name}' was not baked: {reason}.", name=name, reason=reason)
        for name, reason in left_out.items()
    ]
