"""Vertex groups.

Weights have neither `foreach_get` nor `foreach_set`: they are read in one pass over `MeshVertex.groups`, and
written with one `VertexGroup.add` a weight, those of one all at once. A weight takes about a microsecond and a half;
setting and filling lists of vertices of equal weights takes as long where few are equal. BMesh's deform layer takes
half the time, but its round trip writes all the rest of the mesh anew.
"""

from __future__ import annotations

import numpy as np
from bpy.types import Mesh, Object
from scipy.sparse import csc_array, csr_array

from zoomout_core.transfer import Attribute, Domain, Kind


def read_weights(obj: Object, mesh: Mesh) -> Attribute:
    """The weights of all vertex groups, as one sparse attribute labelled by the groups' names.

    Args:
        obj: the object that names the groups.
        mesh: its mesh, original or evaluated.
    """
    names = tuple(group.name for group in obj.vertex_groups)
    record = np.dtype([("vertex", np.int32), ("group", np.int32), ("weight", np.float32)])
    entries = np.fromiter(
        ((vertex.index, group.group, group.weight) for vertex in mesh.vertices for group in vertex.groups), record
    )
    entries = entries[entries["group"] < len(names)]
    values = csr_array(
        (entries["weight"], (entries["vertex"], entries["group"])), shape=(len(mesh.vertices), len(names))
    )
    return Attribute("vertex groups", Domain.POINT, Kind.WEIGHT, values, labels=names)


def write_weights(obj: Object, weights: Attribute) -> None:
    """Write vertex groups in the order of their labels, in place of those of the same names."""
    groups = obj.vertex_groups
    active = groups.active.name if groups.active else None
    for name in weights.labels:
        if name in groups:
            groups.remove(groups[name])
    columns = csc_array(weights.values)
    for column, name in enumerate(weights.labels):
        entries = slice(*columns.indptr[column : column + 2])
        vertices, weight = columns.indices[entries], columns.data[entries]
        add = groups.new(name=name).add
        add(vertices[weight == 1].tolist(), 1, "REPLACE")
        for vertex, part in zip(vertices[weight != 1].tolist(), weight[weight != 1].tolist(), strict=True):
            add((vertex,), part, "REPLACE")
    if active is not None:
        groups.active_index = groups[active].index


def locked_groups(obj: Object) -> set[str]:
    """Names of the vertex groups that are locked against changes."""
    return {group.name for group in obj.vertex_groups if group.lock_weight}


def deforming_bones(obj: Object) -> set[str]:
    """Names of the deforming bones of the armatures that deform an object, as its modifiers or as its parent."""
    armatures = [modifier.object for modifier in obj.modifiers if modifier.type == "ARMATURE"]
    armatures.append(obj.find_armature())
    return {bone.name for armature in armatures if armature for bone in armature.data.bones if bone.use_deform}
