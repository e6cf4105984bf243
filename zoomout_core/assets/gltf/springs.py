# SPDX-License-Identifier: GPL-3.0-or-later
"""Copy spring bones of one VRM document to another one, with their colliders."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.assets.gltf.avatars import SPRINGS, is_row, list_at, object_at, objects_at
from zoomout_core.assets.gltf.convert_springs import as_object, number_of, to_version_0, to_version_1, vector_of
from zoomout_core.mesh.formats.gltf_document import VRM_0, VRM_1

# The JSON of a document, or a part of it.
Tree: TypeAlias = dict[str, Any]
# Colliders of other shapes than spheres and capsules, inside a collider of VRM 1.
MORE_SHAPES = "VRMC_springBone_extended_collider"


class Partner(NamedTuple):
    """The node that stands for a node of another document."""

    node: int
    axes: Floats = np.eye(4)  # (4, 4) transform of places from the axes of the other node to those of this one

    def move(self, place: Floats) -> Floats:
        """(3,) a place in its axes."""
        return np.asarray(self.axes[:3, :3] @ place + self.axes[:3, 3])

    @property
    def growth(self) -> float:
        """How many times as long lengths become."""
        return float(np.cbrt(abs(np.linalg.det(self.axes[:3, :3]))))


def copy_springs(made: Tree, other: Tree, copies: Mapping[int, Partner], partners: Mapping[int, Partner]) -> list[str]:
    """Copy the spring bones whose nodes were copied; returns notes.

    Chains of VRM 0 end 7 cm beyond their last node. In VRM 1 they end at a node, which is added there.

    Args:
        made: the JSON of the document that receives them.
        other: the JSON of the document that has them.
        copies: the copy of each copied node.
        partners: the partner of each other node that has one; colliders and centres refer to these, too.
    """
    mine, theirs = object_at(made, "extensions"), object_at(other, "extensions")
    everything, notes = {**partners, **copies}, list[str]()
    if SPRINGS in theirs:
        rows = _copy_1(theirs[SPRINGS], copies, everything)
        if VRM_0 in mine and VRM_1 not in mine:
            rows, notes = to_version_0(rows, made)
    else:
        rows = _copy_0(object_at(object_at(theirs, VRM_0), "secondaryAnimation"), copies, everything)
        if VRM_1 in mine:
            rows = to_version_1(rows, made)
    if VRM_1 in mine and rows.get("springs"):
        _add_1(made, rows, str(object_at(theirs, SPRINGS).get("specVersion", "1.0")))
    elif VRM_0 in mine and rows.get("boneGroups"):
        _add_0(mine[VRM_0].setdefault("secondaryAnimation", {}), rows)
    return notes


def _copy_1(given: Tree, copies: Mapping[int, Partner], partners: Mapping[int, Partner]) -> Tree:
    """The copied chains of VRM 1, with their colliders."""
    own: Tree = {}
    colliders, groups = objects_at(given, "colliders"), objects_at(given, "colliderGroups")

    def copy_collider(number: int) -> Tree | None:
        partner = partners.get(int(colliders[number].get("node", -1)))
        if partner is None:
            return None
        copied = {**deepcopy(colliders[number]), "node": partner.node}
        for part in (copied, object_at(object_at(copied, "extensions"), MORE_SHAPES)):
            for shape in object_at(part, "shape").values():
                if isinstance(shape, dict):
                    _move_shape(shape, partner)
        return copied

    collider = _once(own, "colliders", colliders, copy_collider)

    def copy_group(number: int) -> Tree | None:
        kept = [new for each in list_at(groups[number], "colliders") if (new := collider(each)) is not None]
        return {**deepcopy(groups[number]), "colliders": kept} if kept else None

    group = _once(own, "colliderGroups", groups, copy_group)
    for spring in objects_at(given, "springs"):
        if not spring.get("joints") or any(joint.get("node") not in copies for joint in objects_at(spring, "joints")):
            continue
        copied = deepcopy(spring)
        for joint in copied["joints"]:
            partner = copies[joint["node"]]
            joint["node"] = partner.node
            _scale(joint, "hitRadius", partner)
        center = partners.get(copied.pop("center", -1))
        copied |= {} if center is None else {"center": center.node}
        kept = [new for each in list_at(copied, "colliderGroups") if (new := group(each)) is not None]
        copied.pop("colliderGroups", None)
        copied |= {"colliderGroups": kept} if kept else {}
        own.setdefault("springs", []).append(copied)
    return own


def _copy_0(given: Tree, copies: Mapping[int, Partner], partners: Mapping[int, Partner]) -> Tree:
    """The copied chains of VRM 0, with their colliders; a group lists the roots of its chains."""
    own: Tree = {}
    groups = objects_at(given, "colliderGroups")

    def copy_group(number: int) -> Tree | None:
        partner = partners.get(int(groups[number].get("node", -1)))
        if partner is None:
            return None
        copied = {**deepcopy(groups[number]), "node": partner.node}
        for collider in objects_at(copied, "colliders"):
            # In this version, z is reversed.
            place = partner.move(vector_of(collider.get("offset")) * [1, 1, -1])
            collider["offset"] = as_object(place * [1, 1, -1])
            _scale(collider, "radius", partner)
        return copied

    group = _once(own, "colliderGroups", groups, copy_group)
    for chains in objects_at(given, "boneGroups"):
        roots = [copies[root] for root in list_at(chains, "bones") if root in copies]
        if roots:
            kept = [new for each in list_at(chains, "colliderGroups") if (new := group(each)) is not None]
            copied = {**deepcopy(chains), "bones": [root.node for root in roots], "colliderGroups": kept}
            center = partners.get(chains.get("center", -1))
            copied["center"] = -1 if center is None else center.node
            _scale(copied, "hitRadius", roots[0])
            own.setdefault("boneGroups", []).append(copied)
    return own


def _move_shape(shape: Tree, partner: Partner) -> None:
    """Move a shape of a collider of VRM 1 to the axes of a partner."""
    shape["offset"] = partner.move(vector_of(shape.get("offset"))).tolist()
    if "tail" in shape:
        shape["tail"] = partner.move(vector_of(shape["tail"])).tolist()
    if "normal" in shape:
        shape["normal"] = (partner.axes[:3, :3] @ vector_of(shape["normal"]) / partner.growth).tolist()
    _scale(shape, "radius", partner)


def _scale(row: Tree, name: str, partner: Partner) -> None:
    """Scale a length, if a row has it, to the size of a partner."""
    if name in row:
        row[name] = partner.growth * number_of(row, name)


def _add_1(made: Tree, rows: Tree, version: str) -> None:
    """Add chains of VRM 1 to a document, and declare the shapes of their colliders."""
    own = made["extensions"].setdefault(SPRINGS, {"specVersion": version})
    colliders, groups = (len(own.setdefault(name, [])) for name in ("colliders", "colliderGroups"))
    own["colliders"] += rows.get("colliders", [])
    for group in rows.get("colliderGroups", []):
        own["colliderGroups"].append({**group, "colliders": [colliders + each for each in group["colliders"]]})
    for spring in rows["springs"]:
        if "colliderGroups" in spring:
            spring = {**spring, "colliderGroups": [groups + each for each in spring["colliderGroups"]]}
        if not _is_above(made, spring.get("center", -1), spring["joints"][0]["node"]):
            spring = {name: value for name, value in spring.items() if name != "center"}
        own.setdefault("springs", []).append(spring)
    for name in ("colliders", "colliderGroups"):
        if not own[name]:
            del own[name]


def _add_0(own: Tree, rows: Tree) -> None:
    """Add chains to those of a document of VRM 0."""
    first = len(own.setdefault("colliderGroups", []))
    own["colliderGroups"] += rows.get("colliderGroups", [])
    own.setdefault("boneGroups", []).extend(
        {**chains, "colliderGroups": [first + each for each in chains["colliderGroups"]]}
        for chains in rows["boneGroups"]
    )


def _is_above(made: Tree, node: int, other: int) -> bool:
    """Whether a node is the other one, or an ancestor of it."""
    parents = {child: number for number, each in enumerate(made["nodes"]) for child in each.get("children", ())}
    while other != node and other in parents:
        other = parents[other]
    return other == node


def _once(own: Tree, table: str, rows: list[Tree], copy: Callable[[int], Tree | None]) -> Callable[[Any], int | None]:
    """A function that copies a row of a table at the first request; it returns None for rows that are left out."""
    known: dict[int, int | None] = {}

    def number_of(row: Any) -> int | None:
        if not is_row(row, rows):
            return None
        if row not in known:
            made = copy(row)
            if made is not None:
                own.setdefault(table, []).append(made)
            known[row] = None if made is None else len(own[table]) - 1
        return known[row]

    return number_of
