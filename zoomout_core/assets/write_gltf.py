# SPDX-License-Identifier: GPL-3.0-or-later
"""Write assets as glTF and GLB files: one mesh, with the nodes, animations and materials of its document."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.asset import COLOR, MATERIALS, NORMALS, SHAPE_KEYS, UV, Asset, Skin, on_corners, one_line
from zoomout_core.assets.gltf import (
    ARRAY_BUFFER,
    ELEMENT_ARRAY_BUFFER,
    INSTANCES,
    Buffer,
    Document,
    is_file,
    library,
    sources_of,
)
from zoomout_core.assets.images import TEXTURE_EXTENSIONS, ImageType, image_type
from zoomout_core.assets.read_gltf import materials_of
from zoomout_core.mesh.opening import shown
from zoomout_core.mesh.triangles import unit_vectors, vertex_normals
from zoomout_core.runtime.version import package_version
from zoomout_core.transfer.skinning import normalise, row_of

if TYPE_CHECKING:
    from pygltflib import GLTF2, Primitive, Texture

# Joints per vertex in a set.
INFLUENCES = 4
# The extension of glTF for materials to choose from.
VARIANTS = "KHR_materials_variants"


@np.errstate(over="ignore")  # what overflows is refused in a sentence
def write_gltf(asset: Asset, path: Path) -> tuple[str, ...]:
    """Write an asset to a .glb or .gltf file; its skin provides the rest positions of its vertices.

    The asset's surface replaces all meshes of its document. A .gltf file has its buffer and images in files of their
    own if its document has.

    Returns:
        A sentence for each kind of data that was left out.

    Raises:
        ImportError: pygltflib is not installed.
    """
    gltf = library()
    document = asset.document
    made: GLTF2 = gltf.GLTF2(asset=gltf.Asset(version="2.0")) if document is None else deepcopy(document.gltf)
    made.asset.generator = f"ZoomOut Transfer {package_version()}"
    buffer = _without_meshes(made, document)
    files = _ImageFiles(made, buffer, path)
    keeps_materials = document is not None and asset.materials == materials_of(document)
    if document is not None and keeps_materials:
        known = len(document.notes)
        _keep_images(made, document, files)
        variants, notes = _variants(document)
        notes += tuple(document.notes[known:])
    else:
        variants, notes = {}, _write_materials(made, asset, files)
    extras, lost = _extras(document)
    notes += lost
    weighed = _nodes_with_weights(document)
    keys = asset.find(SHAPE_KEYS)
    mesh = gltf.Mesh(name=path.stem, primitives=_primitives(asset, buffer), extras=extras)
    for primitive in mesh.primitives:
        if primitive.material in variants:
            primitive.extensions = {VARIANTS: variants[primitive.material]}
    if keys is not None and keys.labels:
        mesh.weights, mesh.extras = [0.0] * len(keys.labels), {**mesh.extras, "targetNames": list(keys.labels)}
    made.meshes = [mesh]
    node = gltf.Node(name=path.stem, mesh=0)
    if asset.skin is not None:
        made.skins = [_skin(asset.skin, buffer)]
        node.skin = 0
    made.nodes.append(node)
    if not made.scenes:
        made.scenes, made.scene = [gltf.Scene(nodes=[])], 0
    made.scenes[made.scene or 0].nodes.append(len(made.nodes) - 1)
    _animate_weights(made, weighed if keys is not None and keys.labels else [], len(made.nodes) - 1)
    buffer.finish()
    if path.suffix.lower() == ".glb":
        path.write_bytes(b"".join(made.save_to_bytes()))
        return notes
    if document is not None and document.has_buffer_files:
        place = path.with_name(f"{one_line(path.stem)}.bin")
        place.write_bytes(buffer.content)
        made.buffers[0].uri = quote(place.name)
    else:
        made.convert_buffers(gltf.BufferFormat.DATAURI)
    path.write_text(made.to_json(), encoding="utf-8")
    return notes


def _without_meshes(made: GLTF2, document: Document | None) -> Buffer:
    """Remove the meshes and skins from a document, and make a buffer of the remaining data."""
    accessors, made.accessors = made.accessors, []
    buffer = Buffer(made)
    made.meshes, made.skins = [], []
    for node in made.nodes:
        node.mesh = node.skin = None
        node.weights = []
        (node.extensions or {}).pop(INSTANCES, None)
    if document is None:
        return buffer
    anew: dict[int, int] = {}
    for animation in made.animations:
        for sampler in animation.samplers:
            for end in ("input", "output"):
                number = getattr(sampler, end)
                if number not in anew:
                    old, values = accessors[number], document.array(number).astype("<f4")
                    anew[number] = buffer.add(values, bounded=old.min is not None)
                setattr(sampler, end, anew[number])
    return buffer


class _ImageFiles:
    """The images of a written document, in its buffer or in files beside it.

    Args:
        made: the document; its images are replaced.
        buffer: its buffer.
        path: path of its file.
    """

    def __init__(self, made: GLTF2, buffer: Buffer, path: Path) -> None:
        self.made, self.buffer, self.path = made, buffer, path
        made.images = []

    def add(self, content: bytes, name: str | None = None, in_file: bool = False) -> tuple[int, ImageType] | None:
        """Add an image; returns its number and type, or None if glTF cannot store its type.

        Args:
            content: its file.
            name: its name in the document.
            in_file: whether to write it to a file beside a .gltf file.
        """
        kind = image_type(content)
        if kind is None or not kind.mime:
            return None
        image = library().Image(name=name, mimeType=kind.mime)
        if in_file and self.path.suffix.lower() == ".gltf":
            place = self.path.with_name(f"{one_line(self.path.stem)}_{len(self.made.images)}{kind.suffix}")
            place.write_bytes(content)
            image.uri = quote(place.name)
        else:
            image.bufferView = self.buffer.add_view(content)
        self.made.images.append(image)
        return len(self.made.images) - 1, kind

    def refer(self, texture: Texture, images: Sequence[tuple[int, ImageType]]) -> None:
        """Make a texture refer to images; types that few programs read need an extension of glTF."""
        others = {name: each for name, each in (texture.extensions or {}).items() if name not in TEXTURE_EXTENSIONS}
        texture.source, texture.extensions = None, others
        for number, kind in images:
            if not kind.extension:
                texture.source = number
                continue
            texture.extensions[kind.extension] = {"source": number}
            _declare(self.made.extensionsUsed, kind.extension)
        if texture.source is None:
            for name in set(texture.extensions) & set(TEXTURE_EXTENSIONS):
                _declare(self.made.extensionsRequired, name)


def _declare(extensions: list[str], name: str) -> None:
    if name not in extensions:
        extensions.append(name)


def _keep_images(made: GLTF2, document: Document, files: _ImageFiles) -> None:
    """Copy the images of a document; textures no longer refer to those that could not be read."""
    added = {}
    for number, image in enumerate(document.gltf.images):
        content = document.image(number)
        found = None if content is None else files.add(content, image.name, is_file(image.uri))
        if found is not None:
            added[number] = found
    for texture in made.textures:
        files.refer(texture, [added[number] for number in sources_of(texture).values() if number in added])


def _variants(document: Document) -> tuple[dict[int | None, Any], tuple[str, ...]]:
    """The mappings of material variants by material, and notes; primitives with one material become one."""
    found: dict[int | None, list[Any]] = {}
    for mesh in document.gltf.meshes:
        for primitive in mesh.primitives:
            mapping = (primitive.extensions or {}).get(VARIANTS)
            if mapping not in found.setdefault(primitive.material, []):
                found[primitive.material].append(mapping)
    lost = any(len(mappings) > 1 for mappings in found.values())
    note = (
        "Some parts with the same material have different material variants, which are left out: give these parts "
        "materials of their own."
    )
    kept = {material: one for material, (one, *more) in found.items() if one is not None and not more}
    return kept, (note,) if lost else ()


def _extras(document: Document | None) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The free data of a document's mesh; if it has several with such data, a note instead."""
    meshes = [] if document is None else document.gltf.meshes
    parts = [each.extras or {} for mesh in meshes for each in (mesh, *mesh.primitives)]
    found = [{name: value for name, value in extras.items() if name != "targetNames"} for extras in parts]
    if len(meshes) == 1 and not any(found[1:]):
        return found[0], ()
    note = "The meshes have free data (extras) of their own, which was left out, because they were joined."
    return {}, (note,) if any(found) else ()


def _write_materials(made: GLTF2, asset: Asset, files: _ImageFiles) -> tuple[str, ...]:
    """Replace the document's materials by ones with a base colour and its image; returns notes."""
    gltf, notes = library(), []
    made.materials, made.textures, made.samplers = [], [], []
    (made.extensions or {}).pop(VARIANTS, None)
    made.extensionsUsed = [name for name in made.extensionsUsed if name != VARIANTS]
    for material in asset.materials:
        look = gltf.PbrMetallicRoughness(baseColorFactor=list(material.color), metallicFactor=0.0)
        found = None if material.image is None else files.add(material.image)
        if found is not None:
            made.textures.append(gltf.Texture())
            files.refer(made.textures[-1], [found])
            look.baseColorTexture = gltf.TextureInfo(index=len(made.textures) - 1)
        elif material.image is not None:
            notes.append(
                f"The image of the material {shown(material.name)} is of a type that glTF cannot store, and was left "
                "out: convert it to PNG."
            )
        made.materials.append(gltf.Material(name=material.name, pbrMetallicRoughness=look))
    return tuple(notes)


def _nodes_with_weights(document: Document | None) -> list[int]:
    """The nodes of a document whose meshes have morph targets."""
    if document is None:
        return []
    nodes = ((number, node.mesh) for number, node in enumerate(document.gltf.nodes) if node.mesh is not None)
    return [number for number, mesh in nodes if any(each.targets for each in document.gltf.meshes[mesh].primitives)]


def _animate_weights(made: GLTF2, weighed: list[int], node: int) -> None:
    """Redirect morph target animations to a node if only one mesh had morph targets; else remove them."""
    for animation in made.animations:
        kept = []
        for channel in animation.channels:
            if channel.target.path != "weights":
                kept.append(channel)
            elif len(weighed) == 1 and channel.target.node == weighed[0]:
                channel.target.node = node
                kept.append(channel)
        animation.channels = kept
    made.animations = [animation for animation in made.animations if animation.channels]


# --- the mesh -----------------------------------------------------------------------------------------------


def _primitives(asset: Asset, buffer: Buffer) -> list[Primitive]:
    """Make a primitive for each material, with vertices split where corners differ."""
    gltf = library()
    surface, materials = asset.surface, asset.find(MATERIALS)
    positions = surface.vertices if asset.skin is None else asset.skin.rest
    rows, corners = _corner_rows(asset, positions)
    number = np.full(len(surface.face_start) - 1, -1) if materials is None else np.asarray(materials.values)
    primitives = []
    for material in np.unique(number[surface.triangle_face]):
        chosen = surface.triangle_corners[number[surface.triangle_face] == material]
        split, triangles = np.unique(corners[chosen], return_inverse=True)
        # Use one corner of each vertex for all.
        example = np.empty(len(split), dtype=np.int64)
        example[triangles.ravel()] = chosen.ravel()
        vertex = surface.corner_vertex[example]
        columns = {name: values[example] for name, values in rows.items()}
        attributes = gltf.Attributes(
            POSITION=buffer.add(positions[vertex].astype("<f4"), ARRAY_BUFFER, bounded=True),
            **{name: buffer.add(values.astype("<f4"), ARRAY_BUFFER) for name, values in columns.items()},
        )
        if asset.skin is not None:
            _add_influences(attributes, asset.skin, vertex, buffer)
        primitive = gltf.Primitive(attributes=attributes, mode=4)
        primitive.indices = buffer.add(triangles.ravel().astype("<u4"), ELEMENT_ARRAY_BUFFER)
        if material >= 0:
            primitive.material = int(material)
        keys = asset.find(SHAPE_KEYS)
        if keys is not None and keys.labels:
            offsets = np.asarray(keys.values)[vertex]
            if asset.skin is not None:
                offsets = np.einsum("nxy,nky->nkx", asset.skin.linear[vertex], offsets)
            offsets = offsets.astype("<f4")
            primitive.targets = [
                gltf.Attributes(POSITION=buffer.add(offsets[:, key], ARRAY_BUFFER, bounded=True))
                for key in range(offsets.shape[1])
            ]
        primitives.append(primitive)
    return primitives


def _corner_rows(asset: Asset, positions: Floats) -> tuple[dict[str, Floats], Integers]:
    """Corner data (c, w) by glTF's names, and (c,) the number of each corner's split vertex."""
    surface = asset.surface
    normals = asset.find(NORMALS)
    if normals is None:
        of_corner = vertex_normals(positions, surface.triangles)[surface.corner_vertex]
    else:
        of_corner = np.asarray(normals.values)
        if asset.skin is not None:
            inverse = np.linalg.pinv(asset.skin.linear)[surface.corner_vertex]
            of_corner = unit_vectors(np.einsum("cyx,cy->cx", inverse, of_corner))
    of_corner = np.where(np.linalg.norm(of_corner, axis=1, keepdims=True) > 0.5, of_corner, [0, 0, 1])
    rows = {"NORMAL": of_corner}
    for kind, name in ((UV, "TEXCOORD"), (COLOR, "COLOR")):
        found = [attribute for attribute in asset.attributes if attribute.name.startswith(f"{kind} ")]
        for number, attribute in enumerate(sorted(found, key=lambda each: each.name)):
            values = on_corners(attribute, surface)
            rows[f"{name}_{number}"] = values * [1, -1] + [0, 1] if kind == UV else _rgba(values)
    key = np.column_stack([surface.corner_vertex, *rows.values()]).astype(np.float32)
    # Single floats cannot represent vertex numbers above 2^24.
    whole = np.column_stack([surface.corner_vertex, np.ascontiguousarray(key[:, 1:]).view(np.int32)])
    return rows, np.asarray(np.unique(whole, axis=0, return_inverse=True)[1]).ravel()


def _rgba(colors: Floats) -> Floats:
    return np.clip(np.column_stack([colors, np.ones((len(colors), 4 - colors.shape[1]))]), 0, 1)


def _add_influences(attributes: Any, skin: Skin, vertex: Integers, buffer: Buffer) -> None:
    """Add joints and weights of vertices, the largest weights first, in sets of four."""
    weights = normalise(skin.weights)
    row, count = row_of(weights), np.diff(weights.indptr)
    order = np.lexsort((weights.indices, -weights.data, row))
    rank = np.arange(len(row)) - np.repeat(weights.indptr[:-1], count)
    sets = max(-(-int(count.max(initial=1)) // INFLUENCES), 1)
    joint = np.zeros((weights.shape[0], sets * INFLUENCES), "<u1" if weights.shape[1] <= 256 else "<u2")
    share = np.zeros(joint.shape, "<f4")
    joint[row, rank], share[row, rank] = weights.indices[order], weights.data[order]
    # Readers expect single floats that sum to one.
    share[:, 0] += 1 - share.sum(axis=1, dtype=np.float64)
    for number in range(sets):
        columns = slice(number * INFLUENCES, (number + 1) * INFLUENCES)
        setattr(attributes, f"JOINTS_{number}", buffer.add(joint[vertex, columns], ARRAY_BUFFER))
        setattr(attributes, f"WEIGHTS_{number}", buffer.add(share[vertex, columns], ARRAY_BUFFER))


def _skin(skin: Skin, buffer: Buffer) -> Any:
    matrices = skin.inverse_bind.transpose(0, 2, 1).reshape(-1, 16).astype("<f4")
    return library().Skin(joints=skin.nodes.tolist(), inverseBindMatrices=buffer.add(matrices))
