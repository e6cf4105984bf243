# SPDX-License-Identifier: GPL-3.0-or-later
"""Copy accessors, skins and materials of a glTF document to another one, with all rows that they refer to."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from typing import Any

from zoomout_core.assets.gltf.avatars import is_row, list_at, object_at
from zoomout_core.assets.gltf.growing_document import GrowingDocument
from zoomout_core.assets.gltf.keep_avatars import PLAIN_MATERIAL
from zoomout_core.mesh.formats.gltf_document import VRM_0, Document
from zoomout_core.mesh.formats.image_types import TEXTURE_EXTENSIONS, image_type
from zoomout_core.messages import message


class RowCopier:
    """Copies rows of a document to another one, each once."""

    def __init__(self, made: GrowingDocument, document: Document) -> None:
        self.made, self.document, self.tree = made, document, document.tree
        self._copies: dict[tuple[str, int], int | None] = {}

    def accessor(self, number: int) -> int:
        """Copy an accessor with its data; returns its number."""
        return self._once("accessors", number) or 0

    def skin(self, number: int) -> int:
        """Copy a skin, whose joints keep their numbers; returns its number."""
        skin = deepcopy(self.tree["skins"][number])
        skin["inverseBindMatrices"] = self.accessor(skin["inverseBindMatrices"])
        return self.made.add("skins", skin)

    def _once(self, table: str, number: int) -> int | None:
        """The number of the copy of a row; None if it cannot be read."""
        if (table, number) not in self._copies:
            row = self._row(table, number)
            self._copies[table, number] = None if row is None else self.made.add(table, row)
        return self._copies[table, number]

    def _row(self, table: str, number: int) -> dict[str, Any] | None:
        row: dict[str, Any] = deepcopy(self.tree[table][number])
        view = self.tree["bufferViews"][row["bufferView"]]
        about = {name: view[name] for name in ("byteStride", "target") if name in view}
        row["bufferView"] = self.made.add_view(self.document.view(row["bufferView"]), about)
        return row


class LookCopier(RowCopier):
    """Copies materials with their textures and images.

    Attributes:
        required: extensions that a reader must know to see the textures.
        notes: sentences about lost properties of materials.
    """

    def __init__(self, made: GrowingDocument, document: Document) -> None:
        super().__init__(made, document)
        self.required: list[str] = []
        self.notes: list[str] = []

    def material(self, number: int) -> int:
        """Copy a material; returns its number."""
        return self._once("materials", number) or 0

    def _row(self, table: str, number: int) -> dict[str, Any] | None:
        row: dict[str, Any] = deepcopy(self.tree[table][number])
        if table == "materials":
            for part, name in list(_texture_slots(row)):
                texture = self._once("textures", part[name]["index"])
                if texture is None:
                    del part[name]
                else:
                    part[name]["index"] = texture
            row["name"] = self.made.free_name("materials", row.get("name") or f"Material {number + 1}")
            self._describe_material(number, row)
        elif table == "textures":
            sources = {
                name: self._once("images", part["source"]) for name, part in _parts_with_source(row) if "source" in part
            }
            if all(source is None for source in sources.values()):
                return None
            for name, part in list(_parts_with_source(row)):
                if sources.get(name) is None:
                    part.pop("source", None)
                else:
                    part["source"] = sources[name]
            if row.get("source") is None:
                self.required += sorted(set(row.get("extensions", ())) & set(TEXTURE_EXTENSIONS))
            if "sampler" in row:
                row["sampler"] = self._once("samplers", row["sampler"])
        elif table == "images":
            content = self.document.image(number)
            kind = None if content is None else image_type(content)
            if content is None or kind is None or not kind.mime:
                return None
            row.pop("uri", None)
            row |= {"bufferView": self.made.view_of_image(content), "mimeType": kind.mime}
        return row

    def _describe_material(self, number: int, row: dict[str, Any]) -> None:
        """Add the properties of a material in VRM 0, which are listed beside the materials."""
        given = list_at(object_at(object_at(self.tree, "extensions"), VRM_0), "materialProperties")
        own = given[number] if is_row(number, given) and isinstance(given[number], dict) else None
        avatar = object_at(object_at(self.made.tree, "extensions"), VRM_0)
        if not avatar:
            if own is not None and own.get("shader") != PLAIN_MATERIAL["shader"]:
                self.notes.append(
                    message("The shader of the material {name} is that of VRM 0, and was left out.", name=row["name"])
                )
            return
        made = {**(PLAIN_MATERIAL if own is None else deepcopy(own)), "name": row["name"]}
        textures = {
            name: self._once("textures", texture)
            for name, texture in object_at(made, "textureProperties").items()
            if is_row(texture, self.tree.get("textures", ()))
        }
        made["textureProperties"] = {name: texture for name, texture in textures.items() if texture is not None}
        described = avatar.setdefault("materialProperties", [])
        described += [
            {**PLAIN_MATERIAL, "name": each.get("name", "")} for each in self.made.rows("materials")[len(described) :]
        ]
        described.append(made)


def _texture_slots(part: dict[str, Any]) -> Iterator[tuple[dict[str, Any], str]]:
    """The parts of a material that refer to textures, also in extensions: each part, and the name of the reference."""
    for name, value in part.items():
        if isinstance(value, dict) and name != "extras":
            if name.lower().endswith("texture") and isinstance(value.get("index"), int):
                yield part, name
            yield from _texture_slots(value)


def _parts_with_source(texture: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The parts of a texture that refer to an image, by the extension; "" for the texture itself."""
    yield "", texture
    for name in TEXTURE_EXTENSIONS:
        if isinstance(texture.get("extensions", {}).get(name), dict):
            yield name, texture["extensions"][name]
