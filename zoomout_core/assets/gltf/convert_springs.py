# SPDX-License-Identifier: GPL-3.0-or-later
"""Convert chains of spring bones, with their colliders, from one version of VRM to the other.

Avatars of VRM 0 face against z, those of VRM 1 along it, so that directions of gravity are turned about y. Offsets of
colliders have z reversed in VRM 0. A chain of VRM 0 has all nodes below its root and ends 7 cm beyond the last one; one
of VRM 1 lists its nodes, and ends at the last.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import Floats
from zoomout_core.assets.gltf.avatars import object_at, objects_at
from zoomout_core.messages import message, warning

# The JSON of a document, or a part of it.
Tree: TypeAlias = dict[str, Any]
# Values of a joint: the name in each version, and what VRM 1 has for one that is left out.
NUMBERS = (
    ("stiffiness", "stiffness", 1.0),
    ("gravityPower", "gravityPower", 0.0),
    ("dragForce", "dragForce", 0.5),
    ("hitRadius", "hitRadius", 0.0),
)
DOWN = (0.0, -1.0, 0.0)
# Values that differ by a smaller share are alike: radii grow with the surroundings of each joint.
ALIKE = 0.1
# Length of the end of a chain of VRM 0, in metres.
END = 0.07
# Shorter nodes have no direction.
SHORT = 1e-6
# Maximum number of gaps between the spheres for a capsule.
MAX_GAPS = 32


def vector_of(value: Any, default: ArrayLike = (0.0, 0.0, 0.0)) -> Floats:
    """(3,) a vector of VRM 1, a list, or of VRM 0, an object; the default for something else."""
    parts = [value.get(name, 0.0) for name in "xyz"] if isinstance(value, dict) else value
    if isinstance(parts, list) and len(parts) == 3 and all(isinstance(each, (int, float)) for each in parts):
        return np.array(parts, dtype=np.float64)
    return np.array(default, dtype=np.float64)


def number_of(row: Tree, name: str, default: float = 0.0) -> float:
    """A number of a row; the default if there is none."""
    value = row.get(name)
    return float(value) if isinstance(value, (int, float)) else default


def as_object(vector: Floats) -> dict[str, float]:
    """A vector (3,) as VRM 0 has it."""
    return dict(zip("xyz", vector.tolist(), strict=True))


def to_version_1(rows: Tree, made: Tree) -> Tree:
    """Chains of VRM 0 as those of VRM 1, for a document that has their nodes; it receives a node for each end."""
    colliders, groups = _colliders_of_version_1(rows)
    springs = list[Tree]()
    roots = _first_above(made, (root for chains in rows.get("boneGroups", []) for root in chains["bones"]))
    for chains in rows.get("boneGroups", []):
        values = {name: number_of(chains, name_0, default) for name_0, name, default in NUMBERS}
        gravity = vector_of(chains.get("gravityDir"), DOWN) * [-1, 1, -1]
        for root in chains["bones"]:
            if root not in roots:
                continue
            roots.remove(root)
            for nodes in _chains_below(made, root):
                joints = [{"node": node, **values, "gravityDir": gravity.tolist()} for node in nodes]
                spring: Tree = {"joints": [*joints, {"node": _add_end(made, nodes[-1])}]}
                if chains.get("comment"):
                    spring["name"] = str(chains["comment"])
                spring["center"] = chains["center"]
                # A group without colliders is not valid.
                touched = [each for each in chains["colliderGroups"] if groups[each]["colliders"]]
                spring |= {"colliderGroups": touched} if touched else {}
                springs.append(spring)
    kept = [number for number, group in enumerate(groups) if group["colliders"]]
    for spring in springs:
        if "colliderGroups" in spring:
            spring["colliderGroups"] = [kept.index(each) for each in spring["colliderGroups"]]
    return {"colliders": colliders, "colliderGroups": [groups[number] for number in kept], "springs": springs}


def _colliders_of_version_1(rows: Tree) -> tuple[list[Tree], list[Tree]]:
    """All colliders and groups of VRM 0, converted to VRM 1."""
    colliders, groups = list[Tree](), list[Tree]()
    for group in rows.get("colliderGroups", []):
        own = [
            {
                "node": group["node"],
                "shape": {
                    "sphere": {
                        "offset": (vector_of(each.get("offset")) * [1, 1, -1]).tolist(),
                        "radius": number_of(each, "radius"),
                    }
                },
            }
            for each in objects_at(group, "colliders")
        ]
        groups.append({"colliders": list(range(len(colliders), len(colliders) + len(own)))})
        colliders += own
    return colliders, groups


def _first_above(made: Tree, starts: Iterable[int]) -> set[int]:
    """Those of the first nodes of chains that are below no other: their chains have all nodes below them."""
    parents = {child: number for number, each in enumerate(made["nodes"]) for child in each.get("children", ())}
    found, given = set[int](), set(starts)
    for start in given:
        above = parents.get(start)
        while above is not None and above not in given:
            above = parents.get(above)
        if above is None:
            found.add(start)
    return found


def _chains_below(made: Tree, root: int) -> Iterator[list[int]]:
    """The nodes at and below a root as chains: each follows the first child, and the others begin chains."""
    starts = [root]
    while starts:
        chain = [starts.pop()]
        while children := made["nodes"][chain[-1]].get("children"):
            starts += reversed(children[1:])
            chain.append(children[0])
        yield chain


def _add_end(made: Tree, last: int) -> int:
    """Add the end of a chain, beyond its last node in the direction from the node above; returns its number."""
    node = made["nodes"][last]
    matrix = np.reshape(node["matrix"], (4, 4)).T
    direction = np.linalg.solve(matrix[:3, :3], matrix[:3, 3])
    length = float(np.linalg.norm(direction))
    step = END / length * direction if length > SHORT else END * np.array(DOWN)
    made["nodes"].append({"name": f"{node.get('name', '')} end", "translation": step.tolist()})
    node["children"] = [len(made["nodes"]) - 1]
    return len(made["nodes"]) - 1


def to_version_0(rows: Tree, made: Tree) -> tuple[Tree, list[str]]:
    """Chains of VRM 1 as those of VRM 0, for a document that has their nodes, and notes on what is simplified.

    A capsule becomes a row of spheres. The joints of a chain have the values of the first one.
    """
    groups, parts_of, is_left_out = _colliders_of_version_0(rows)
    springs, chains, differ = rows.get("springs", []), list[Tree](), False
    roots = _first_above(made, (spring["joints"][0]["node"] for spring in springs))
    for spring in springs:
        first, *others = spring["joints"]
        if first["node"] not in roots:
            continue  # another chain has all of its nodes
        roots.remove(first["node"])
        values, *of_others = [
            {name_0: number_of(joint, name, default) for name_0, name, default in NUMBERS}
            for joint in [first, *others[:-1]]
        ]
        differ = differ or not all(np.allclose([*each.values()], [*values.values()], ALIKE) for each in of_others)
        chains.append(
            {
                "comment": str(spring.get("name", "")),
                **values,
                "gravityDir": as_object(vector_of(first.get("gravityDir"), DOWN) * [-1, 1, -1]),
                "center": spring.get("center", -1),
                "bones": [first["node"]],
                "colliderGroups": [part for each in spring.get("colliderGroups", ()) for part in parts_of[each]],
            }
        )
    notes = list[str]()
    if differ:
        notes.append(
            message("Each chain of spring bones has the values of its first joint, because VRM 0 has one set for all.")
        )
    if is_left_out:
        notes.append(
            warning("Colliders that are not spheres or capsules were left out, because VRM 0 has only spheres.")
        )
    return {"colliderGroups": groups, "boneGroups": chains}, notes


def _colliders_of_version_0(rows: Tree) -> tuple[list[Tree], list[list[int]], bool]:
    """Colliders of VRM 1 as groups of VRM 0, each on one node.

    Returns:
        The groups, the numbers of those that each group of VRM 1 becomes, and whether some have no spheres.
    """
    groups, parts_of = list[Tree](), list[list[int]]()
    is_left_out = False
    for group in rows.get("colliderGroups", []):
        of_node: dict[int, list[Tree]] = {}
        for number in group["colliders"]:
            spheres = list(_spheres(rows["colliders"][number]))
            is_left_out = is_left_out or not spheres
            of_node.setdefault(rows["colliders"][number]["node"], []).extend(spheres)
        own = [{"node": node, "colliders": spheres} for node, spheres in of_node.items() if spheres]
        parts_of.append(list(range(len(groups), len(groups) + len(own))))
        groups += own
    return groups, parts_of, is_left_out


def _spheres(collider: Tree) -> Iterator[Tree]:
    """The spheres of VRM 0 that stand for a collider of VRM 1; none for other shapes."""
    shape = object_at(collider, "shape")
    form = object_at(shape, "sphere") or object_at(shape, "capsule")
    if not form or "extensions" in collider:
        return
    start, radius = vector_of(form.get("offset")), number_of(form, "radius")
    end = vector_of(form.get("tail"), start)
    # Spheres a radius apart: between their centres, the row is 13 % thinner.
    length = float(np.linalg.norm(end - start))
    gaps = min(int(np.ceil(length / max(radius, SHORT))), MAX_GAPS)
    for share in np.linspace(0, 1, gaps + 1):
        yield {"offset": as_object((start + share * (end - start)) * [1, 1, -1]), "radius": radius}
