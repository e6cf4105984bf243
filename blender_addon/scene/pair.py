# SPDX-License-Identifier: GPL-3.0-or-later
"""The two objects of a match: finding them, reading them, and recognising them later.

A target that is a part of a character may map to several objects of another character. Then these, joined in order,
are the source.

A match depends on the numbering of elements and on the modelled shape. So a fingerprint covers the topology and the
positions in the meshes themselves, but not names, attributes or poses.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace

import bpy
import numpy as np
from bpy.types import Context, Mesh, Object

import zoomout_core as zo
from zoomout_core.runtime.progress import stage

from .. import mesh_data
from ..jobs import pause
from ..mesh_data import Fingerprint, ObjectPair
from ..mesh_data.arrays import hash_of

READING = "Reading the meshes"


def check_context(context: object) -> None:
    """Raise a TypeError unless a script gives Blender's context, or something like it with a scene."""
    if getattr(context, "scene", None) is None:
        raise TypeError(f"The context is {context!r:.60}: give Blender's, bpy.context.")


def name_of(obj: object) -> str:
    """The name of an object, or of a collection, that a script gives.

    Raises:
        MeshError: it was removed from the file.
        TypeError: it is neither.
    """
    if not isinstance(obj, Object | bpy.types.Collection):
        raise TypeError(f"{obj!r:.60} is not an object: give one, such as bpy.data.objects['Body'].")
    try:
        return str(obj.name)
    except ReferenceError:
        raise zo.MeshError("An object was removed from the file: find it in bpy.data.objects again.") from None


def names_of(objects: object) -> list[str]:
    """The names of a script's list of objects.

    Raises:
        MeshError: one was removed from the file.
        TypeError: they are not a list of objects.
    """
    if isinstance(objects, Object) or not isinstance(objects, Iterable):
        raise TypeError(f"{objects!r:.60} is not a list of objects: give one, such as [bpy.data.objects['Hat']].")
    return [name_of(obj) for obj in objects]


def find_mesh(context: Context, name: str, edited: bool = False) -> Object:
    """The mesh object of a name, ready to read; it may be in Edit Mode only if `edited`.

    Raises:
        MeshError: the scene has no such mesh, or several objects of the name, or it is in Edit Mode.
        TypeError: the context is not Blender's.
    """
    check_context(context)
    obj = context.scene.objects.get(name)
    if obj is None:
        raise zo.MeshError("There is no object '{name}' in the scene: choose another one.", name=name)
    if _has_namesake(context, obj):
        raise zo.MeshError(
            "The scene has several objects named '{name}', some linked from other files: rename the local one.",
            name=name,
        )
    if obj.type != "MESH":
        raise zo.MeshError("'{name}' is not a mesh: choose a mesh object.", name=name)
    if obj.data.is_editmode and not (edited and obj.mode == "EDIT"):  # possibly by another object that shares the mesh
        raise zo.MeshError("'{name}' is in Edit Mode: switch to Object Mode first.", name=name)
    return obj


def _has_namesake(context: Context, obj: Object) -> bool:
    """Whether another object of the scene has the same name, which is possible for linked objects."""
    objects = context.blend_data.objects
    paths = (None, *(library.filepath for library in context.blend_data.libraries))
    others = {found for path in paths if (found := objects.get((obj.name, path))) not in (None, obj)}
    return any(context.scene in other.users_scene for other in others)


def check_writable(target: Object) -> None:
    """Raise a MeshError if the target or its mesh belongs to another file."""
    for data in (target, target.data):
        if data.library is not None:
            raise zo.MeshError(
                "'{name}' is linked from another file and cannot be edited: make it local first.", name=data.name
            )
        if data.override_library is not None and data == target.data:
            raise zo.MeshError(
                "The mesh '{mesh}' is a library override and cannot be edited: make it local first.", mesh=data.name
            )


def check_distinct(source: Object, target: Object) -> None:
    """Raise a MeshError if both objects or their meshes are the same."""
    if source == target:
        raise zo.MeshError(
            "'{target}' cannot be its own source: choose another source, or make another mesh active.",
            target=target.name,
        )
    if source.data == target.data:
        raise zo.MeshError(
            "'{source}' and '{target}' share one mesh: make the target single-user, or choose another source.",
            source=source.name,
            target=target.name,
        )


async def read_pair(
    context: Context, source_name: str, target_name: str, others: Sequence[str] = (), at_base: Collection[str] = ()
) -> ObjectPair:
    """Read both objects of a match; no Blender data is kept across an `await`.

    All fingerprints are read first, to detect any edits afterwards.

    Args:
        context: Blender's.
        source_name: name of the source.
        target_name: name of the target.
        others: names of further sources.
        at_base: names of sources to read at their base, see `Fingerprint.at_base`.

    Raises:
        MeshError: an object cannot be used, or the target cannot be written to.
    """
    names = source_name, *others
    for name in names:
        check_distinct(find_mesh(context, name), find_mesh(context, target_name))
    fingerprints = tuple(fingerprint_source(context, name, name in at_base) for name in names)
    target_fingerprint = fingerprint_target(context, target_name)
    with stage(READING, 0, 0):
        await pause()
        sources = []
        for name in names:
            read = mesh_data.read_target_surface if name in at_base else mesh_data.read_source_surface
            sources.append(read(find_mesh(context, name), context.evaluated_depsgraph_get()))
            await pause()
        target = mesh_data.read_target_surface(find_mesh(context, target_name), context.evaluated_depsgraph_get())
        pair = ObjectPair(tuple(sources), target, fingerprints, target_fingerprint)
        await pause()
    check_not_edited(context, pair)
    return pair


def check_not_edited(context: Context, pair: ObjectPair) -> tuple[Object, Object]:
    """The first source and the target, after checking that no object has changed since the pair was read.

    Raises:
        MeshError: an object was removed or edited since.
    """
    for before in pair.source_fingerprints:
        check_same(before, fingerprint_source(context, before.name, before.at_base))
    check_same(pair.target_fingerprint, fingerprint_target(context, pair.target_name))
    return find_mesh(context, pair.source_name), find_mesh(context, pair.target_name)


@contextmanager
def writing(context: Context, pair: ObjectPair, *others: Object) -> Iterator[tuple[Object, Object]]:
    """`check_not_edited`, and a context for writing to the target and other objects, all or nothing.

    Raises:
        MeshError: the source or the target was removed or edited since the pair was read.
    """
    source, target = check_not_edited(context, pair)
    with mesh_data.all_or_nothing(target, *others):
        yield source, target


def check_same(before: Fingerprint, now: Fingerprint) -> None:
    """Raise a MeshError if an object was edited between two fingerprints."""
    if before.digest != now.digest:
        raise edit_error(before.name)


def edit_error(name: str) -> zo.MeshError:
    """The error for an object that was edited during an operation."""
    return zo.MeshError("'{name}' was edited during the operation: start again.", name=name)


@contextmanager
def source_mesh(context: Context, pair: ObjectPair) -> Iterator[tuple[Object, Mesh]]:
    """The first evaluated source and its mesh, see `evaluated_sources`."""
    with evaluated_sources(context, pair) as (first, *_):
        yield first.evaluated, first.mesh


@contextmanager
def evaluated_sources(context: Context, pair: ObjectPair) -> Iterator[list[mesh_data.EvaluatedObject]]:
    """The sources of a pair, originals and evaluated, to read their data.

    Raises:
        MeshError: a source was removed, or its number of elements has changed since the pair was read.
    """
    with ExitStack() as stack:
        found = []
        for fingerprint, surface in zip(pair.source_fingerprints, pair.sources, strict=True):
            source = find_mesh(context, fingerprint.name)
            evaluated = mesh_data.base_mesh if fingerprint.at_base else mesh_data.evaluated_mesh
            seen = stack.enter_context(evaluated(source, context.evaluated_depsgraph_get()))
            found.append(mesh_data.EvaluatedObject(source, *seen))
            check_elements(fingerprint.name, surface, found[-1].mesh)
        yield found


@contextmanager
def target_mesh(context: Context, pair: ObjectPair) -> Iterator[tuple[Object, Mesh]]:
    """The target of a pair and its own mesh, to read its data.

    Raises:
        MeshError: it was removed, or its number of elements has changed since the pair was read.
    """
    target = find_mesh(context, pair.target_name)
    check_elements(pair.target_name, pair.target, target.data)
    yield target, target.data


def check_elements(name: str, surface: zo.Surface, mesh: Mesh) -> None:
    """Raise a MeshError if a mesh has other numbers of elements than its surface, so that its data would not fit."""
    elements = len(mesh.vertices), len(mesh.polygons), len(mesh.loops)
    if elements != (len(surface.vertices), len(surface.face_start) - 1, len(surface.corner_vertex)):
        raise edit_error(name)


def users_of_mesh(context: Context, target: Object) -> int:
    """Number of objects of the file that use the target's mesh."""
    return sum(obj.data == target.data for obj in context.blend_data.objects)


def fingerprint_source(context: Context, name: str, at_base: bool = False) -> Fingerprint:
    """The fingerprint of a source; for `at_base` see `Fingerprint`.

    Raises:
        MeshError: the source cannot be used.
    """
    source = find_mesh(context, name)
    read = mesh_data.read_target_faces if at_base else mesh_data.read_source_faces
    return replace(_fingerprint(source, read(source, context.evaluated_depsgraph_get())), at_base=at_base)


def fingerprint_target(context: Context, name: str) -> Fingerprint:
    """The fingerprint of a target.

    Raises:
        MeshError: the target cannot be used or written to.
    """
    target = find_mesh(context, name)
    check_writable(target)
    return _fingerprint(target, mesh_data.read_target_faces(target, context.evaluated_depsgraph_get()))


def _fingerprint(obj: Object, faces: mesh_data.Faces) -> Fingerprint:
    """The fingerprint of an object whose surface has these faces."""
    content, mirrored = mesh_data.content_hash(obj.data), mesh_data.is_mirrored(obj)
    # Triangles are not hashed: they change when a pose folds a quad of a subdivided mesh. Numbers have the types of a
    # surface's.
    corner_vertex = faces.corner_vertex.astype(np.int64)
    face_start = np.append(faces.start, len(corner_vertex)).astype(np.int64)
    size = faces.vertices, len(faces.start)
    return Fingerprint(obj.name, hash_of(f"{content} {mirrored}", corner_vertex, face_start), content, mirrored, size)
