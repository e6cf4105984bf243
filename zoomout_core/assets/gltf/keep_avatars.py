# SPDX-License-Identifier: GPL-3.0-or-later
"""Keep the extensions of VRM valid in a glTF document whose meshes and materials are rewritten.

Nodes keep their numbers, and with them bones, springs, colliders and constraints. Expressions and the display in first
person refer to meshes (VRM 0) or to their nodes (VRM 1), to morph targets and to materials.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from zoomout_core.assets.gltf.avatars import is_row, list_at, object_at, objects_at
from zoomout_core.assets.gltf.materials import ImageFiles
from zoomout_core.assets.gltf.meshes import Renumbering
from zoomout_core.mesh.formats.gltf_document import VRM_0, VRM_1, Document, library, morph_target_names
from zoomout_core.mesh.formats.opening import shown

if TYPE_CHECKING:
    from pygltflib import GLTF2

# The expressions that programs look for by their names.
PRESETS_0 = (
    *("neutral", "a", "i", "u", "e", "o", "blink", "blink_l", "blink_r", "joy", "angry", "sorrow", "fun"),
    *("lookup", "lookdown", "lookleft", "lookright"),
)
PRESETS_1 = (
    *("happy", "angry", "sad", "relaxed", "surprised", "aa", "ih", "ou", "ee", "oh", "blink", "blinkLeft"),
    *("blinkRight", "lookUp", "lookDown", "lookLeft", "lookRight", "neutral"),
)
# The strength of a morph target in an expression: per cent in VRM 0, a share in VRM 1.
FULL_0, FULL_1 = 100.0, 1.0
# The entry of VRM 0 for a material without a shader of its own.
PLAIN_MATERIAL: dict[str, Any] = {
    "shader": "VRM_USE_GLTFSHADER",
    "renderQueue": 2000,
    "floatProperties": {},
    "vectorProperties": {},
    "textureProperties": {},
    "keywordMap": {},
    "tagMap": {},
}


@dataclass(frozen=True, eq=False)
class _Change:
    """Changes of a document.

    Attributes:
        made: the document to write, with its meshes and materials.
        document: the document as it was.
        look: the document with its materials in full, if there is one.
        renumbering: the new numbers of nodes, meshes and morph targets.
        files: the images of the written document.
        lost: names of expressions that lost all of their binds.
        reduced: names of expressions that lost some of their binds.
    """

    made: GLTF2
    document: Document
    look: Document | None
    renumbering: Renumbering
    files: ImageFiles
    lost: list[str] = field(default_factory=list)
    reduced: list[str] = field(default_factory=list)

    def meshes(self, number: Any) -> list[int]:
        """The meshes that a mesh became; none if the value is not a number of a mesh."""
        return self.renumbering.meshes.get(number, []) if isinstance(number, int) else []

    def nodes(self, number: Any) -> list[int]:
        """The node that has the mesh of a node now; none if the value is not a number of such a node."""
        nodes = self.renumbering.nodes
        return [nodes[number]] if isinstance(number, int) and number in nodes else []

    def keys(self, mesh: Any, number: Any) -> list[int]:
        """The new number of a morph target of a mesh; none if it is gone."""
        keys = self.renumbering.keys.get(mesh, [])
        new = keys[number] if is_row(number, keys) else None
        return [] if new is None else [new]

    def material(self, number: Any) -> int | None:
        """The new number of a material, by its name if all were replaced; None if it is gone."""
        before = self.document.gltf.materials
        if not is_row(number, before):
            return None
        if self.look is self.document:
            return int(number)
        names = [material.name for material in self.made.materials]
        return names.index(before[number].name) if before[number].name in names else None


def keep_avatar(
    made: GLTF2, document: Document, look: Document | None, renumbering: Renumbering, files: ImageFiles
) -> tuple[str, ...]:
    """Renumber the references in the extensions of VRM; returns notes on expressions.

    Args:
        made: the document to write, with its meshes and materials, and the extensions of the document.
        document: the document as it was.
        look: the document with the written materials in full, if there is one.
        renumbering: the new numbers of nodes, meshes and morph targets.
        files: the images of the written document.
    """
    change = _Change(made, document, look, renumbering, files)
    extensions = made.extensions or {}
    notes: list[str] = []
    for name, keep in ((VRM_0, _keep_0), (VRM_1, _keep_1)):
        if isinstance(extensions.get(name), dict):
            notes += keep(extensions[name], change)
    for names, what in ((change.lost, "were left out"), (change.reduced, "were reduced")):
        if names:
            shown_names = ", ".join(map(shown, names))
            notes.append(f"Expressions {what}, because their morph targets or materials are gone: {shown_names}.")
    return tuple(notes)


def _keep_0(tree: dict[str, Any], change: _Change) -> list[str]:
    """Renumber the extension of VRM 0; returns notes."""

    def rebind(bind: dict[str, Any]) -> list[dict[str, Any]]:
        mesh = bind.get("mesh")
        return [
            {**bind, "mesh": new, "index": key}
            for new in change.meshes(mesh)
            for key in change.keys(mesh, bind.get("index"))
        ]

    def recolour(value: dict[str, Any]) -> list[dict[str, Any]]:
        names = {material.name for material in change.made.materials}
        return [value] if change.look is change.document or value.get("materialName") in names else []

    master = object_at(tree, "blendShapeMaster")
    kept = []
    for group in objects_at(master, "blendShapeGroups"):
        name = str(group.get("name") or group.get("presetName"))
        if _rebind(group, {"binds": rebind, "materialValues": recolour}, name, change):
            kept.append(group)
    made = []
    for preset, places in _new_presets(PRESETS_0, change).items():
        if all(str(each.get("presetName")).lower() != preset for each in kept):
            kept.append({"name": preset.capitalize(), "presetName": preset, "binds": [], "materialValues": []})
        group = next(each for each in kept if str(each.get("presetName")).lower() == preset)
        if not list_at(group, "binds"):
            group["binds"] = [{"mesh": mesh, "index": index, "weight": FULL_0} for mesh, index in places]
            made.append(preset)
    if kept or "blendShapeMaster" in tree:
        tree["blendShapeMaster"] = {**master, "blendShapeGroups": kept}
    note = _keep_annotations(tree, "mesh", change.meshes, ("firstPersonFlag", "Auto"))
    _keep_thumbnail_0(object_at(tree, "meta"), change)
    if change.look is not change.document:
        tree["materialProperties"] = _material_properties(change)
    return [*_note_on_presets(made), *note]


def _keep_1(tree: dict[str, Any], change: _Change) -> list[str]:
    """Renumber the extension of VRM 1; returns notes."""

    def rebind(bind: dict[str, Any]) -> list[dict[str, Any]]:
        node = bind.get("node")
        return [
            {**bind, "node": new, "index": key}
            for new in change.nodes(node)
            for key in change.keys(change.document.gltf.nodes[node].mesh, bind.get("index"))
        ]

    def rematerialise(bind: dict[str, Any]) -> list[dict[str, Any]]:
        new = change.material(bind.get("material"))
        return [] if new is None else [{**bind, "material": new}]

    binds = {"morphTargetBinds": rebind, "materialColorBinds": rematerialise, "textureTransformBinds": rematerialise}
    expressions = object_at(tree, "expressions")
    for kind in ("preset", "custom"):
        if kind in expressions:
            given = object_at(expressions, kind)
            expressions[kind] = {
                name: given[name] for name in given if _rebind(object_at(given, name), binds, name, change)
            }
    made = []
    bearers = {node.mesh: number for number, node in enumerate(change.made.nodes) if node.mesh is not None}
    for preset, places in _new_presets(PRESETS_1, change).items():
        presets = tree.setdefault("expressions", expressions).setdefault("preset", {})
        if not list_at(object_at(presets, preset), "morphTargetBinds"):
            binds_of_key = [{"node": bearers[mesh], "index": index, "weight": FULL_1} for mesh, index in places]
            presets[preset] = {**object_at(presets, preset), "morphTargetBinds": binds_of_key}
            made.append(preset)
    note = _keep_annotations(tree, "node", change.nodes, ("type", "auto"))
    _keep_thumbnail_1(object_at(tree, "meta"), change)
    return [*_note_on_presets(made), *note]


def _rebind(
    expression: dict[str, Any],
    lists: Mapping[str, Callable[[dict[str, Any]], list[dict[str, Any]]]],
    name: str,
    change: _Change,
) -> bool:
    """Renumber the binds of an expression; returns whether anything of it is left, or there was nothing before.

    Args:
        expression: the expression, whose lists of binds are replaced.
        lists: for each list, the new binds of a bind: none if it is gone, several if its mesh became several.
        name: name of the expression.
        change: what changed in the document.
    """
    any_lost = False
    for part in lists:
        kept: dict[str, dict[str, Any]] = {}
        for bind in objects_at(expression, part):
            found = lists[part](bind)
            any_lost = any_lost or not found
            for each in found:
                # Two meshes that became one may have had the same morph target.
                kept.setdefault(repr({key: value for key, value in each.items() if key != "weight"}), each)
        if part in expression:
            expression[part] = list(kept.values())
    left = any(list_at(expression, part) for part in lists)
    if any_lost:
        (change.reduced if left else change.lost).append(name)
    return left or not any_lost


def _new_presets(presets: Sequence[str], change: _Change) -> dict[str, list[tuple[int, int]]]:
    """Presets named like new morph targets: the meshes that have these, and their numbers there."""
    before = {name for mesh in change.document.gltf.meshes for name in morph_target_names(mesh)}
    names_of = change.renumbering.key_names
    places = {
        preset: [
            (mesh, number)
            for mesh, names in enumerate(names_of)
            for number, name in enumerate(names)
            if name.lower() == preset.lower() and name not in before
        ]
        for preset in presets
    }
    return {preset: found for preset, found in places.items() if found}


def _note_on_presets(presets: Sequence[str]) -> list[str]:
    if not presets:
        return []
    return [f"Expressions were made of the shape keys of their names: {', '.join(map(shown, presets))}."]


def _keep_annotations(
    tree: dict[str, Any], what: str, rows: Callable[[Any], list[int]], automatic: tuple[str, str]
) -> list[str]:
    """Renumber which meshes are shown in first person; returns a note if joined meshes differ.

    Args:
        tree: the extension.
        what: the name of the number in an annotation.
        rows: the new number of each row.
        automatic: the name of the choice in an annotation, and its value for a choice by the bones.
    """
    view = object_at(tree, "firstPerson")
    kept: dict[int, dict[str, Any]] = {}
    differ = False
    name, choice = automatic
    for annotation in objects_at(view, "meshAnnotations"):
        for row in rows(annotation.get(what)):
            if row in kept and kept[row].get(name) != annotation.get(name):
                kept[row][name], differ = choice, True
            kept.setdefault(row, {**annotation, what: row})
    if "meshAnnotations" in view:
        view["meshAnnotations"] = list(kept.values())
    if not differ:
        return []
    return ["The display in first person is chosen by the bones, because meshes that differ in it were joined."]


# --- images and materials -----------------------------------------------------------------------------------


def _keep_thumbnail_0(meta: dict[str, Any], change: _Change) -> None:
    """Renumber the texture with the picture of the avatar."""
    number, textures = meta.get("texture"), change.document.gltf.textures
    if change.look is change.document or not is_row(number, textures):
        return
    del meta["texture"]
    content = change.document.image_of(int(number or 0))
    added = None if content is None else change.files.add(content, "thumbnail")
    if added is not None:
        change.made.textures.append(library().Texture())
        change.files.refer(change.made.textures[-1], [added])
        meta["texture"] = len(change.made.textures) - 1


def _keep_thumbnail_1(meta: dict[str, Any], change: _Change) -> None:
    """Renumber the image with the picture of the avatar."""
    number = meta.pop("thumbnailImage", None)
    if not is_row(number, change.document.gltf.images):
        return
    if change.look is change.document:
        new = change.files.numbers.get(number)
    else:
        content = change.document.image(number)
        added = None if content is None else change.files.add(content, change.document.gltf.images[number].name)
        new = None if added is None else added[0]
    if new is not None:
        meta["thumbnailImage"] = new


def _material_properties(change: _Change) -> list[dict[str, Any]]:
    """The entry of VRM 0 for each material: that of the materials' document, or one without a shader."""
    materials = change.made.materials
    extensions = {} if change.look is None else change.look.gltf.extensions or {}
    given = list_at(object_at(extensions, VRM_0), "materialProperties")
    if len(given) == len(materials):
        return deepcopy(given)
    return [
        {"name": material.name or f"Material {number}", **PLAIN_MATERIAL} for number, material in enumerate(materials)
    ]
