# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the materials of glTF documents, with their textures and images."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from zoomout_core.assets.asset import Asset, one_line
from zoomout_core.assets.gltf.read_asset import materials_of
from zoomout_core.mesh.formats.gltf_buffer import Buffer
from zoomout_core.mesh.formats.gltf_document import VARIANTS, Document, is_file, library, sources_of
from zoomout_core.mesh.formats.image_types import TEXTURE_EXTENSIONS, ImageType, image_type
from zoomout_core.mesh.formats.opening import shown

if TYPE_CHECKING:
    from pygltflib import GLTF2, Texture


class ImageFiles:
    """The images of a written document, in its buffer or in files beside it.

    Args:
        made: the document; its images are replaced.
        buffer: its buffer.
        path: path of its file.

    Attributes:
        numbers: the number of each copied image by its number in the document of the materials.
    """

    def __init__(self, made: GLTF2, buffer: Buffer, path: Path) -> None:
        self.made, self.buffer, self.path = made, buffer, path
        self.numbers: dict[int, int] = {}
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
            else:
                texture.extensions[kind.extension] = {"source": number}
        if texture.source is None:
            for name in set(texture.extensions) & set(TEXTURE_EXTENSIONS) - set(self.made.extensionsRequired):
                self.made.extensionsRequired.append(name)


def full_look(asset: Asset) -> Document | None:
    """The document that has the materials of an asset in full; None if they are only what every format can store."""
    return asset.look if asset.look is not None and asset.materials == materials_of(asset.look) else None


def write_materials(made: GLTF2, asset: Asset, look: Document | None, files: ImageFiles) -> tuple[str, ...]:
    """Write the materials of an asset; returns notes.

    Args:
        made: the document to write.
        asset: the asset.
        look: the document that has its materials in full, see `full_look`.
        files: the images of the written document.
    """
    if look is None:
        return _write_simple_materials(made, asset, files)
    known = len(look.notes)
    if look is not asset.document:
        for table in ("materials", "textures", "samplers"):
            setattr(made, table, deepcopy(getattr(look.gltf, table)))
        _replace_variants(made, look)
    _copy_images(made, look, files)
    return tuple(look.notes[known:])


def _copy_images(made: GLTF2, look: Document, files: ImageFiles) -> None:
    """Copy the images of a document; textures no longer refer to those that could not be read."""
    added = {}
    for number, image in enumerate(look.gltf.images):
        content = look.image(number)
        found = None if content is None else files.add(content, image.name, is_file(image.uri))
        if found is not None:
            added[number] = found
    files.numbers = {number: new for number, (new, _) in added.items()}
    for texture in made.textures:
        files.refer(texture, [added[number] for number in sources_of(texture).values() if number in added])


def _replace_variants(made: GLTF2, look: Document | None) -> None:
    """Replace the names of the variants of materials by those of another document."""
    made.extensions = {name: each for name, each in (made.extensions or {}).items() if name != VARIANTS}
    variants = None if look is None else (look.gltf.extensions or {}).get(VARIANTS)
    if variants is not None:
        made.extensions[VARIANTS] = deepcopy(variants)


def _write_simple_materials(made: GLTF2, asset: Asset, files: ImageFiles) -> tuple[str, ...]:
    """Replace the document's materials by ones with a base colour and its image; returns notes."""
    gltf, notes = library(), []
    made.materials, made.textures, made.samplers = [], [], []
    _replace_variants(made, None)
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
