# SPDX-License-Identifier: GPL-3.0-or-later
"""The avatar of a glTF document, by the extensions of VRM 0 and 1.

Version 0 is the extension VRM, version 1 VRMC_vrm and VRMC_springBone: https://github.com/vrm-c/vrm-specification
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from zoomout_core.mesh.formats.gltf_document import VRM_0, VRM_1, Document

SPRINGS = "VRMC_springBone"
# Terms of the licence. Version 1 has values for missing terms.
TERMS_0 = (
    "licenseName",
    "allowedUserName",
    "violentUssageName",
    "sexualUssageName",
    "commercialUssageName",
    "otherPermissionUrl",
    "otherLicenseUrl",
)
TERMS_1 = {
    "licenseUrl": "",
    "avatarPermission": "onlyAuthor",
    "allowExcessivelyViolentUsage": False,
    "allowExcessivelySexualUsage": False,
    "commercialUsage": "personalNonProfit",
    "allowPoliticalOrReligiousUsage": False,
    "allowAntisocialOrHateUsage": False,
    "creditNotation": "required",
    "allowRedistribution": False,
    "modification": "prohibited",
    "otherLicenseUrl": "",
    "copyrightInformation": "",
    "thirdPartyLicenses": "",
}


# Bones of a thumb in VRM 0, by their names in VRM 1.
THUMBS = {"ThumbProximal": "ThumbMetacarpal", "ThumbIntermediate": "ThumbProximal"}


@dataclass(frozen=True)
class Avatar:
    """The avatar that a VRM file describes.

    Attributes:
        version: the version of VRM.
        title: its name.
        authors: their names.
        licence: terms by the names of the specification.
        bones: the name of the node of each humanoid bone, by the name of the bone.
        expressions: names of the expressions.
        springs: the name and the number of joints of each spring chain.
    """

    version: str
    title: str
    authors: tuple[str, ...]
    licence: dict[str, str | bool]
    bones: dict[str, str]
    expressions: tuple[str, ...]
    springs: tuple[tuple[str, int], ...]

    @property
    def humanoid(self) -> dict[str, str]:
        """The same as `bones`, by the names of VRM 1, in which the bones of thumbs have other names than in VRM 0."""
        renamed = THUMBS if self.version.startswith("0") else {}
        return {
            next((bone.replace(old, new) for old, new in renamed.items() if bone.endswith(old)), bone): name
            for bone, name in self.bones.items()
        }


def is_avatar(document: Document | None) -> bool:
    """Whether a document has the extension of VRM 0 or 1."""
    extensions = {} if document is None else document.gltf.extensions or {}
    return any(isinstance(extensions.get(name), dict) for name in (VRM_0, VRM_1))


def read_avatar(document: Document | None) -> Avatar | None:
    """Read the avatar of a document, without values of a wrong type; None if it has no avatar."""
    if document is None or not is_avatar(document):
        return None
    extensions = document.gltf.extensions
    return _read_1(extensions, document) if VRM_1 in extensions else _read_0(extensions[VRM_0], document)


def _read_0(tree: dict[str, Any], document: Document) -> Avatar:
    meta = object_at(tree, "meta")
    author = _text(meta.get("author"))
    groups = objects_at(object_at(tree, "blendShapeMaster"), "blendShapeGroups")
    bones = objects_at(object_at(tree, "humanoid"), "humanBones")
    roots = [
        root
        for spring in objects_at(object_at(tree, "secondaryAnimation"), "boneGroups")
        for root in list_at(spring, "bones")
        if _name_of(root, document)
    ]
    return Avatar(
        _text(tree.get("specVersion")) or "0",
        _text(meta.get("title")),
        (author,) if author else (),
        {term: _text(meta.get(term)) for term in TERMS_0 if _text(meta.get(term))},
        {_text(each.get("bone")): _name_of(each.get("node"), document) for each in bones},
        tuple(_text(each.get("name")) or _text(each.get("presetName")) for each in groups),
        tuple((_name_of(root, document), _count_joints(root, document)) for root in roots),
    )


def _read_1(extensions: dict[str, Any], document: Document) -> Avatar:
    tree = object_at(extensions, VRM_1)
    meta, expressions = object_at(tree, "meta"), object_at(tree, "expressions")
    terms = {term: meta.get(term, default) for term, default in TERMS_1.items()}
    bones = object_at(object_at(tree, "humanoid"), "humanBones")
    springs = []
    for spring in objects_at(object_at(extensions, SPRINGS), "springs"):
        joints = objects_at(spring, "joints")
        root = _name_of(joints[0].get("node"), document) if joints else ""
        springs.append((_text(spring.get("name")) or root, len(joints)))
    return Avatar(
        _text(tree.get("specVersion")) or "1",
        _text(meta.get("name")),
        tuple(author for author in map(_text, list_at(meta, "authors")) if author),
        {term: value if isinstance(value, bool) else _text(value) for term, value in terms.items() if value != ""},
        {bone: _name_of(object_at(bones, bone).get("node"), document) for bone in bones},
        (*object_at(expressions, "preset"), *object_at(expressions, "custom")),
        tuple(springs),
    )


def object_at(part: dict[str, Any], name: str) -> dict[str, Any]:
    """The object of a name; empty if there is none, or a value of another type."""
    value = part.get(name)
    return value if isinstance(value, dict) else {}


def list_at(part: dict[str, Any], name: str) -> list[Any]:
    """The list of a name; empty if there is none, or a value of another type."""
    value = part.get(name)
    return value if isinstance(value, list) else []


def objects_at(part: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """The objects in the list of a name."""
    return [each for each in list_at(part, name) if isinstance(each, dict)]


def is_row(number: Any, table: Sequence[Any]) -> bool:
    """Whether a value is the number of a row."""
    return isinstance(number, int) and not isinstance(number, bool) and 0 <= number < len(table)


def _text(value: Any) -> str:
    """A text on one line; empty for values of other types."""
    return " ".join(value.split()) if isinstance(value, str) else ""


def _name_of(node: Any, document: Document) -> str:
    """The name of a node; empty if there is no such node."""
    nodes = document.gltf.nodes
    return (nodes[node].name or f"node {node}") if is_row(node, nodes) else ""


def _count_joints(root: int, document: Document) -> int:
    """The number of nodes in a chain: a node, and those below it."""
    count, waiting = 0, [root]
    while waiting:
        count += 1
        waiting += document.gltf.nodes[waiting.pop()].children or []
    return count
