# SPDX-License-Identifier: GPL-3.0-or-later
"""Copy spring bones of one VRM document to another one of the same version, with their colliders."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any, TypeAlias

from zoomout_core.assets.gltf.avatars import SPRINGS, is_row, list_at, object_at, objects_at
from zoomout_core.assets.gltf.document import VRM_0, VRM_1
from zoomout_core.messages import message

# The JSON of a document, or a part of it.
Tree: TypeAlias = dict[str, Any]


def copy_springs(made: Tree, other: Tree, nodes: Mapping[int, int], partners: Mapping[int, int]) -> list[str]:
    """Copy the spring bones whose nodes were copied; returns notes.

    Args:
        made: the JSON of the document that receives them.
        other: the JSON of the document that has them.
        nodes: the number of the copy of each copied node.
        partners: the number of the partner, or of the copy, of each node that has one; colliders and centres
            refer to these.
    """
    mine, theirs = object_at(made, "extensions"), object_at(other, "extensions")
    if SPRINGS in theirs and VRM_1 in mine:
        _copy_1(made, theirs[SPRINGS], nodes, partners)
    elif VRM_0 in theirs and VRM_0 in mine:
        _copy_0(mine[VRM_0], theirs[VRM_0], nodes, partners)
    elif nodes and (SPRINGS in theirs or VRM_0 in theirs) and (VRM_0 in mine or VRM_1 in mine):
        return [message("The outfit's spring bones were left out, because the avatar has another version of VRM.")]
    return []


def _copy_1(made: Tree, given: Tree, nodes: Mapping[int, int], partners: Mapping[int, int]) -> None:
    """Copy the chains of VRM 1."""
    springs = [
        spring
        for spring in objects_at(given, "springs")
        if spring.get("joints") and all(joint.get("node") in nodes for joint in objects_at(spring, "joints"))
    ]
    if not springs:
        return
    own = made["extensions"].setdefault(SPRINGS, {"specVersion": given.get("specVersion", "1.0")})
    colliders, groups = objects_at(given, "colliders"), objects_at(given, "colliderGroups")

    def copy_collider(number: int) -> Tree | None:
        node = partners.get(int(colliders[number].get("node", -1)))
        return None if node is None else {**deepcopy(colliders[number]), "node": node}

    collider = _once(own, "colliders", colliders, copy_collider)

    def copy_group(number: int) -> Tree | None:
        kept = [new for each in list_at(groups[number], "colliders") if (new := collider(each)) is not None]
        return {**deepcopy(groups[number]), "colliders": kept} if kept else None

    group = _once(own, "colliderGroups", groups, copy_group)
    for spring in springs:
        copied = deepcopy(spring)
        for joint in copied["joints"]:
            joint["node"] = nodes[joint["node"]]
        center = partners.get(copied.pop("center", -1))
        if center is not None and _is_above(made, center, copied["joints"][0]["node"]):
            copied["center"] = center
        kept = [new for each in list_at(copied, "colliderGroups") if (new := group(each)) is not None]
        copied.pop("colliderGroups", None)
        copied |= {"colliderGroups": kept} if kept else {}
        own.setdefault("springs", []).append(copied)


def _copy_0(avatar: Tree, given: Tree, nodes: Mapping[int, int], partners: Mapping[int, int]) -> None:
    """Copy the chains of VRM 0, of which a group lists the roots."""
    animation = object_at(given, "secondaryAnimation")
    own = avatar.setdefault("secondaryAnimation", {"boneGroups": [], "colliderGroups": []})
    groups = objects_at(animation, "colliderGroups")

    def copy_group(number: int) -> Tree | None:
        node = partners.get(int(groups[number].get("node", -1)))
        return None if node is None else {**deepcopy(groups[number]), "node": node}

    group = _once(own, "colliderGroups", groups, copy_group)
    for chains in objects_at(animation, "boneGroups"):
        roots = [nodes[root] for root in list_at(chains, "bones") if root in nodes]
        if roots:
            kept = [new for each in list_at(chains, "colliderGroups") if (new := group(each)) is not None]
            copied = {**deepcopy(chains), "bones": roots, "colliderGroups": kept}
            copied["center"] = partners.get(chains.get("center", -1), -1)
            own.setdefault("boneGroups", []).append(copied)


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
