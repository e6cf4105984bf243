# SPDX-License-Identifier: GPL-3.0-or-later
"""Add meshes with their joints and materials to a glTF document, whose own data stay the same, byte for byte.

New rows of its tables follow the old ones, so that the numbers that its extensions refer to remain valid.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import Asset
from zoomout_core.assets.gltf.avatars import is_row, object_at, objects_at
from zoomout_core.assets.gltf.copy_rows import LookCopier, RowCopier
from zoomout_core.assets.gltf.growing_document import GrowingDocument
from zoomout_core.assets.gltf.meshes import write_meshes
from zoomout_core.assets.gltf.springs import Partner, copy_springs
from zoomout_core.mesh.formats.gltf_buffer import Buffer
from zoomout_core.mesh.formats.gltf_document import VRM_0, VRM_1, Document, library


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
    """Add an asset to a document, and write both to a .glb or .vrm file; returns sentences about lost data.

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
    made = GrowingDocument.of(base)
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
    copier = RowCopier(made, Document.from_gltf(drawn))
    look = LookCopier(made, added.look) if added.look is not None else None
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
    """A copy of a document with further materials, which have these numbers in another document."""
    made = GrowingDocument.of(base)
    copier = LookCopier(made, look)
    for number in numbers:
        copier.material(number)
    made.declare_extensions(copier.required)
    joined = made.document()
    joined.notes += dict.fromkeys([*base.notes, *look.notes, *copier.notes])
    return joined


def _shell(made: GrowingDocument, added: Asset) -> Document:
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


def _copy_mesh(mesh: dict[str, Any], copier: RowCopier, look: LookCopier | None) -> int:
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


def _move_by_expressions(made: GrowingDocument, meshes: Sequence[int]) -> None:
    """Extend expressions of an avatar to new meshes: they also move the morph targets of the same names."""
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
