# SPDX-License-Identifier: GPL-3.0-or-later
"""A glTF document that grows: rows and bytes are appended, and those that it has keep their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from zoomout_core.assets.gltf.write import extensions_in
from zoomout_core.mesh.formats.glb import pack_glb
from zoomout_core.mesh.formats.gltf_document import Document, free_name, is_file
from zoomout_core.mesh.formats.image_types import image_type
from zoomout_core.runtime.version import package_version


@dataclass(frozen=True, eq=False)
class GrowingDocument:
    """A document that is written: its JSON, and the content of its only buffer."""

    tree: dict[str, Any]
    content: bytearray

    @classmethod
    def of(cls, document: Document) -> GrowingDocument:
        """A copy of a document, with its buffers joined and its images inside."""
        made, starts = cls(document.tree, bytearray()), []
        for buffer in document.buffers:
            made.content.extend(bytes(-len(made.content) % 4))
            starts.append(len(made.content))
            made.content.extend(buffer)
        for view in made.rows("bufferViews"):
            view["byteOffset"] = view.get("byteOffset", 0) + starts[view["buffer"]]
            view["buffer"] = 0
        for number, image in enumerate(made.rows("images")):
            if is_file(image.get("uri")):
                content = document.image(number)
                kind = None if content is None else image_type(content)
                if content is not None and kind is not None and kind.mime:
                    del image["uri"]
                    image |= {"bufferView": made.view_of_image(content), "mimeType": kind.mime}
        made.tree["asset"]["generator"] = f"ZoomOut Transfer {package_version()}"
        return made

    def rows(self, table: str) -> list[Any]:
        """The rows of a table, which is added if it is missing."""
        rows: list[Any] = self.tree.setdefault(table, [])
        return rows

    def add(self, table: str, row: dict[str, Any]) -> int:
        """Add a row to a table; returns its number."""
        self.rows(table).append(row)
        return len(self.rows(table)) - 1

    def add_view(self, content: bytes, about: dict[str, Any] | None = None) -> int:
        """Add bytes as a view with further properties; returns its number."""
        self.content.extend(bytes(-len(self.content) % 4))
        view = {**(about or {}), "buffer": 0, "byteOffset": len(self.content), "byteLength": len(content)}
        self.content.extend(content)
        return self.add("bufferViews", view)

    def view_of_image(self, content: bytes) -> int:
        """The number of a view with the content of an image: images with the same content share it."""
        for image in self.rows("images"):
            number = image.get("bufferView")
            if number is not None and self._has_content(self.rows("bufferViews")[number], content):
                return int(number)
        return self.add_view(content)

    def _has_content(self, view: dict[str, Any], content: bytes) -> bool:
        """Whether a view has some content."""
        start = view.get("byteOffset", 0)
        return view["byteLength"] == len(content) and self.content[start : start + len(content)] == content

    def add_node(self, node: dict[str, Any], parent: int) -> None:
        """Add a node below another one, or at the top of the scene."""
        number = self.add("nodes", node)
        if parent >= 0:
            self.rows("nodes")[parent].setdefault("children", []).append(number)
            return
        if not self.rows("scenes"):
            self.tree["scene"] = self.add("scenes", {})
        self.rows("scenes")[self.tree.get("scene", 0)].setdefault("nodes", []).append(number)

    def free_name(self, table: str, name: str) -> str:
        """A name that no row of a table has."""
        return free_name(name, {row.get("name") for row in self.rows(table)})

    def declare_extensions(self, required: Sequence[str]) -> None:
        """Declare the extensions that occur, besides those that are declared already."""
        for table, names in (("extensionsUsed", extensions_in(self.tree)), ("extensionsRequired", required)):
            missing = sorted(set(names) - set(self.tree.get(table, ())))
            if missing:
                self.rows(table).extend(missing)

    def pack(self) -> bytes:
        """The content of a GLB file."""
        return pack_glb(self._finish(), bytes(self.content))

    def document(self) -> Document:
        """The written document."""
        tree = self._finish()
        return Document.from_tree(tree, bytes(self.content))

    def _finish(self) -> dict[str, Any]:
        """The JSON with its buffer."""
        self.content.extend(bytes(-len(self.content) % 4))
        self.tree["buffers"] = [{"byteLength": len(self.content)}]
        return {name: part for name, part in self.tree.items() if part != []}
