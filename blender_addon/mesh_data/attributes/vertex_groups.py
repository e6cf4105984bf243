# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertex groups.

Weights have neither `foreach_get` nor `foreach_set`. They are read in one pass over `MeshVertex.groups`, and written by
one `VertexGroup.add` per weight, and one for all weights of 1. A weight takes about 1.5 microseconds; lists of vertices
of equal weight take as long where few weights are equal. BMesh's deform layer takes half the time, but its round trip
rewrites the rest of the mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import numpy as np
import scipy
from bpy.types import Mesh, Object, VertexGroup

import zoomout_core as zo
from zoomout_core.arrays import Floats, Indices, SingleFloats
from zoomout_core.messages import message
from zoomout_core.runtime.progress import advance
from zoomout_core.transfer import Attribute, Domain, Kind

from ...jobs import pause

# Record of a vertex's weight in a group.
ENTRY = np.dtype([("vertex", np.int32), ("group", np.int32), ("weight", np.float32)])
# Vertices whose weights are read between two pauses for the window: about 10 ms, or a few times as long where many
# groups overlap.
PIECE = 2000


def read_weights(obj: Object, mesh: Mesh) -> Attribute:
    """The weights of all vertex groups, as one sparse attribute labelled by the groups' names.

    Args:
        obj: the object that names the groups.
        mesh: its mesh, original or evaluated.
    """
    return _weights(_group_names(obj), len(mesh.vertices), [_entries(mesh, 0, len(mesh.vertices))])


def read_mask(obj: Object, name: str) -> Floats:
    """(n,) the weights of a vertex group, in [0, 1].

    Raises:
        MeshError: the object has no group of that name.
    """
    weights = read_weights(obj, obj.data)
    if name not in weights.labels:
        raise zo.MeshError(
            "'{name}' has no vertex group '{group}' to use as a mask: choose another one.", name=obj.name, group=name
        )
    return weights.values[:, [weights.labels.index(name)]].toarray()[:, 0].clip(0, 1)


async def read_weights_in_pieces(
    fetch: Callable[[], AbstractContextManager[tuple[Object, Mesh]]],
) -> Attribute:
    """`read_weights`, some vertices at a time, with pauses for the window.

    Args:
        fetch: finds the object and its mesh again for each piece; the number of vertices stays the same.
    """
    with fetch() as (obj, mesh):
        names, count = _group_names(obj), len(mesh.vertices)
    entries = []
    for first in range(0, count, PIECE):
        advance(first / count)
        await pause()
        with fetch() as (_, mesh):
            entries.append(_entries(mesh, first, first + PIECE))
    return _weights(names, count, entries)


def _group_names(obj: Object) -> tuple[str, ...]:
    return tuple(group.name for group in obj.vertex_groups)


def _entries(mesh: Mesh, first: int, end: int) -> np.ndarray:
    """The weights of some vertices, as records."""
    vertices = mesh.vertices[first:end]
    return np.fromiter(((v.index, group.group, group.weight) for v in vertices for group in v.groups), ENTRY)


def _weights(names: tuple[str, ...], count: int, entries: list[np.ndarray]) -> Attribute:
    """The attribute from the records of all vertices."""
    found = np.concatenate([np.empty(0, ENTRY), *entries])
    found = found[found["group"] < len(names)]
    values = scipy.sparse.csr_array((found["weight"], (found["vertex"], found["group"])), shape=(count, len(names)))
    return Attribute(message("vertex groups"), Domain.POINT, Kind.WEIGHT, values, labels=names)


def write_weights(obj: Object, weights: Attribute) -> None:
    """Write vertex groups in the order of their labels, in place of those of the same names."""
    groups = obj.vertex_groups
    columns = scipy.sparse.csc_array(weights.values)
    with _preserve_active_group(obj):
        for name in weights.labels:
            if name in groups:
                groups.remove(groups[name])
        for column, name in enumerate(weights.labels):
            _add(groups.new(name=name), *_members(columns, column))


def update_weights(obj: Object, before: Attribute, after: Attribute) -> None:
    """Write the differences between two states of some vertex groups, which keep their places in the list.

    Args:
        obj: the object.
        before: their present weights; a group without weights may be missing, and is added.
        after: their new weights, with the same labels.
    """
    groups = obj.vertex_groups
    old, new = scipy.sparse.csc_array(before.values), scipy.sparse.csc_array(after.values)
    with _preserve_active_group(obj):
        for column, name in enumerate(after.labels):
            group = groups.get(name) or groups.new(name=name)
            (was_in, had), (is_in, has) = _members(old, column), _members(new, column)
            group.remove(np.setdiff1d(was_in, is_in).tolist())
            present = np.full(len(obj.data.vertices), np.nan, np.float32)
            present[was_in] = had
            changed = present[is_in] != has
            _add(group, is_in[changed], has[changed])


def _members(columns: scipy.sparse.csc_array, column: int) -> tuple[Indices, SingleFloats]:
    """The vertices in a group and their weights, in Blender's single precision."""
    entries = slice(*columns.indptr[column : column + 2])
    return columns.indices[entries], columns.data[entries].astype(np.float32)


def _add(group: VertexGroup, vertices: Indices, weight: SingleFloats) -> None:
    group.add(vertices[weight == 1].tolist(), 1, "REPLACE")
    for vertex, part in zip(vertices[weight != 1].tolist(), weight[weight != 1].tolist(), strict=True):
        group.add((vertex,), part, "REPLACE")


@contextmanager
def _preserve_active_group(obj: Object) -> Iterator[None]:
    """Restore the active vertex group of an object, which adding and removing groups changes."""
    groups = obj.vertex_groups
    active = groups.active.name if groups.active else None
    yield
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
