# SPDX-License-Identifier: GPL-3.0-or-later
"""Add meshes with their joints and materials to a glTF document; all that it has stays as it is, byte for byte.

New rows of its tables follow the old ones, so that the numbers that its extensions refer to remain valid.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import Asset
from zoomout_core.assets.gltf.avatars import is_row, list_at, object_at, objects_at
from zoomout_core.assets.gltf.keep_avatars import PLAIN_MATERIAL
from zoomout_core.assets.gltf.meshes import write_meshes
from zoomout_core.assets.gltf.springs import Partner, copy_springs
from zoomout_core.assets.gltf.write import extensions_in
from zoomout_core.mesh.formats.glb import pack_glb
from zoomout_core.mesh.formats.gltf_document import VRM_0, VRM_1, Buffer, Document, free_name, is_file, library
from zoomout_core.mesh.formats.image_types import TEXTURE_EXTENSIONS, image_type
from zoomout_core.messages import message
from zoomout_core.runtime.version import package_version


@dataclass(frozen=True, eq=False)
class NewJoint:
    """A joint to add.

    Attributes:
        name: its name.
        parent: the number of the node above it: one of the document, or an earlier new joint, whose numbers follow; -1
            for none.
        matrix: (4, 4) its transform relative to that node.
        origin: the number of the node that it is a copy of, in the document of the asset's materials; -1 for none.
        axes: (4, 4) transform of places from the axes of that node to those of the joint.
    """

    name: str
    parent: int
    matrix: Floats
    origin: int = -1
    axes: Floats = field(default_factory=partial(np.eye, 4))


def append_to_gltf(
    base: Document,
    joints: Sequence[NewJoint],
    added: Asset,
    path: Path,
    partners: Mapping[int, Partner] = MappingProxyType({}),
) -> tuple[str, ...]:
    """Write a document, and an asset in addition, to a .glb or .vrm file; returns sentences about what was left out.

    Each object of the asset becomes a mesh on a node of its own. Expressions of an avatar that move a morph target also
    move that of the same name of an added mesh.

    Args:
        base: the document.
        joints: joints to add.
        added: the asset. The nodes of its skin are numbers of the document's nodes, and then of the new joints. Its
            materials are those of its look, as are the spring bones of the joints.
        path: the file.
        partners: the document's node for other nodes of the asset's look, which colliders of springs are on.
    """
    made = _Made.of(base)
    for joint in joints:
        made.add_node({"name": joint.name, "matrix": joint.matrix.T.ravel().tolist()}, joint.parent)
    notes = list[str]()
    if added.look is not None:
        numbered = enumerate(joints, len(made.rows("nodes")) - len(joints))
        copies = {each.origin: Partner(number, each.axes) for number, each in numbered if each.origin >= 0}
        notes += copy_springs(made.tree, added.look.tree, copies, partners)
    first = len(made.rows("nodes"))
    shell = _shell(made, added)
    drawn = deepcopy(shell.gltf)
    drawn.accessors = []
    buffer = Buffer(drawn)
    placed = replace(added, document=shell, nodes=tuple(range(first, first + len(added.objects))))
    _, lost = write_meshes(drawn, placed, None, buffer, path.stem)
    buffer.finish()
    copier = _Copier(made, Document.from_gltf(drawn))
    look = _LookCopier(made, added.look) if added.look is not None else None
    known = 0 if added.look is None else len(added.look.notes)
    meshes = [_copy_mesh(mesh, copier, look) for mesh in copier.tree["meshes"]]
    skins = [copier.skin(number) for number in range(len(copier.tree.get("skins", ())))]
    for mesh, (name, _) in zip(meshes, added.objects, strict=True):
        made.add_node({"name": name, "mesh": mesh, **({"skin": skins[0]} if skins else {})}, -1)
    _move_by_expressions(made, meshes)
    made.declare_extensions(() if look is None else look.required)
    path.write_bytes(made.pack())
    if added.look is not None and look is not None:
        notes += [*added.look.notes[known:], *look.notes]
    return (*lost, *notes)


def append_materials(base: Document, look: Document, numbers: Iterable[int]) -> Document:
    """A copy of a document, with materials of another one, which have these numbers there, in addition."""
    made = _Made.of(base)
    copier = _LookCopier(made, look)
    for number in numbers:
        copier.material(number)
    made.declare_extensions(copier.required)
    joined = made.document()
    joined.notes += dict.fromkeys([*base.notes, *look.notes, *copier.notes])
    return joined


def _shell(made: _Made, added: Asset) -> Document:
    """A document with the nodes of another one, and for each object of an asset an empty mesh on a node of its own."""
    gltf = library()
    shell = gltf.GLTF2(asset=gltf.Asset(version="2.0"), extensions=made.tree.get("extensions") or {})
    shell.nodes = [gltf.Node() for _ in made.rows("nodes")]
    skin = None if added.skin is None else 0
    for number, (name, _) in enumerate(added.objects):
        shell.nodes.append(gltf.Node(mesh=number, skin=skin))
        shell.meshes.append(gltf.Mesh(name=name))
    if added.skin is not None:
        shell.skins = [gltf.Skin(joints=added.skin.nodes.tolist())]
    shell.set_binary_blob(b"")
    return Document.from_gltf(shell)


def _copy_mesh(mesh: dict[str, Any], copier: _Copier, look: _LookCopier | None) -> int:
    """Copy a mesh; returns its number."""
    copied = deepcopy(mesh)
    for primitive in copied["primitives"]:
        for part in (primitive["attributes"], *primitive.get("targets", ())):
            part.update({name: copier.accessor(number) for name, number in part.items()})
        primitive["indices"] = copier.accessor(primitive["indices"])
        material = primitive.pop("material", None)
        if material is not None and look is not None:
            primitive["material"] = look.material(material)
    return copier.made.add("meshes", copied)


@dataclass(frozen=True, eq=False)
class _Made:
    """A document that is written: its JSON, and the content of its only buffer."""

    tree: dict[str, Any]
    content: bytearray

    @classmethod
    def of(cls, document: Document) -> _Made:
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
        """Add bytes, with what else their view has; returns its number."""
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


class _Copier:
    """Copies rows of a document to another one, each once."""

    def __init__(self, made: _Made, document: Document) -> None:
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


class _LookCopier(_Copier):
    """Copies materials with their textures and images.

    Attributes:
        required: extensions that a reader must know to see the textures.
        notes: sentences about what a material loses.
    """

    def __init__(self, made: _Made, document: Document) -> None:
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


def _move_by_expressions(made: _Made, meshes: Sequence[int]) -> None:
    """Let expressions of an avatar that move a morph target also move those of the same name of new meshes."""
    rows, extensions = made.rows("meshes"), made.tree.get("extensions", {})
    places: dict[str, list[tuple[int, int]]] = {}
    for mesh in meshes:
        for index, name in enumerate(_key_names(rows[mesh])):
            places.setdefault(name, []).append((mesh, index))
    for group in objects_at(object_at(object_at(extensions, VRM_0), "blendShapeMaster"), "blendShapeGroups"):
        for bind in objects_at(group, "binds"):
            for mesh, index in places.get(_key_of(rows, bind.get("mesh"), bind.get("index")), ()):
                group["binds"].append({**bind, "mesh": mesh, "index": index})
    bearers = {node["mesh"]: number for number, node in enumerate(made.rows("nodes")) if "mesh" in node}
    expressions = object_at(object_at(extensions, VRM_1), "expressions")
    for kind in ("preset", "custom"):
        for name in object_at(expressions, kind):
            expression = object_at(expressions[kind], name)
            for bind in objects_at(expression, "morphTargetBinds"):
                node = bind.get("node")
                of_node = made.rows("nodes")[int(node or 0)].get("mesh") if is_row(node, made.rows("nodes")) else None
                for mesh, index in places.get(_key_of(rows, of_node, bind.get("index")), ()):
                    expression["morphTargetBinds"].append({**bind, "node": bearers[mesh], "index": index})


def _key_names(mesh: dict[str, Any]) -> list[str]:
    """The names of a mesh's morph targets, from its free data or that of a primitive."""
    for part in (mesh, *mesh["primitives"]):
        names = object_at(part, "extras").get("targetNames")
        if isinstance(names, list):
            return [str(name) for name in names]
    return []


def _key_of(meshes: Sequence[dict[str, Any]], mesh: Any, index: Any) -> str:
    """The name of a morph target; empty if there is none."""
    names = _key_names(meshes[mesh]) if is_row(mesh, meshes) else []
    return names[index] if is_row(index, names) else ""
