"""The two objects of a match: choosing them, reading them, and recognising them when time has passed.

An object of another name, or a mesh with other attributes, is still the same surface. What a match depends on
is how elements are numbered and what was modelled, so that is what a fingerprint is taken of: topology and
the positions in the meshes themselves. Posing a character leaves it the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.progress import Progress, Steps, drain

from . import mesh_data
from .mesh_data.arrays import hash_of

READING = Progress(0.0, "Reading the meshes")


@dataclass(frozen=True, eq=False)
class ObjectPair:
    """The surfaces of two objects.

    Attributes:
        source_name: the object that has the data.
        target_name: the object that receives it.
        source: as its modifiers leave it.
        target: its own mesh, where modifiers move it.
        source_fingerprint: changes when the source is edited, or its modifiers make other faces.
        target_fingerprint: changes when the target is edited.
        source_content: of the source's own mesh, see `mesh_data.content_hash`.
        target_content: of the target's.
        source_mirrored: whether the source's matrix mirrors it.
        target_mirrored: whether the target's does.
    """

    source_name: str
    target_name: str
    source: zo.Surface
    target: zo.Surface
    source_fingerprint: str
    target_fingerprint: str
    source_content: str
    target_content: str
    source_mirrored: bool
    target_mirrored: bool


@dataclass(frozen=True)
class Look:
    """What tells whether an object was edited, without its surface.

    Attributes:
        fingerprint: changes when it is edited, or the faces of its surface become others.
        content: of its own mesh, see `mesh_data.content_hash`.
        mirrored: whether its matrix mirrors it.
    """

    fingerprint: str
    content: str
    mirrored: bool


def find_mesh(context: Context, name: str) -> Object:
    """The mesh object of a name, ready to be read.

    Raises:
        MeshError: there is none in the scene, or it is being edited.
    """
    obj = context.scene.objects.get(name)
    if obj is None:
        raise zo.MeshError(f"There is no object '{name}' in the scene: choose another one.")
    if obj.type != "MESH":
        raise zo.MeshError(f"'{name}' is not a mesh: choose a mesh object.")
    if obj.mode == "EDIT":
        raise zo.MeshError(f"'{name}' is in Edit Mode: switch to Object Mode first.")
    return obj


def choose_source(context: Context, target: Object, named: str = "", otherwise: str = "") -> Object:
    """The source for a target.

    It is the object that is named, else the one chosen in the scene, else the one mesh that is selected
    besides the target, else the one named `otherwise`.

    Raises:
        MeshError: it is not a mesh that can be read, or there is no telling which it is.
    """
    return find_mesh(context, source_name(context, target, named, otherwise))


def source_name(context: Context, target: Object, named: str = "", otherwise: str = "") -> str:
    """The name of the source that `choose_source` gives, whatever it names.

    Raises:
        MeshError: there is no telling which it is.
    """
    chosen = context.scene.zoomout.source
    selected = [obj.name for obj in context.selected_objects if obj.type == "MESH" and obj != target]
    name = named or (chosen.name if chosen else "")
    if not name and len(selected) > 1:
        raise zo.MeshError(
            f"{len(selected)} meshes are selected besides the active one: "
            "select the source alone, or choose it in the sidebar."
        )
    name = name or "".join(selected) or otherwise
    if not name:
        raise zo.MeshError("There is no source: choose it in the sidebar, or select it and then, last, the target.")
    return name


def check_writable(target: Object) -> None:
    """Raise a MeshError if the mesh of the target belongs to another file."""
    for data in (target, target.data):
        if data.library is not None:
            raise zo.MeshError(
                f"'{data.name}' is linked from another file and cannot be written to: make it local first."
            )
        if data.override_library is not None and data == target.data:
            raise zo.MeshError(
                f"The mesh '{data.name}' overrides that of another file and cannot be written to: make it local first."
            )


def check_distinct(source: Object, target: Object) -> None:
    """Raise a MeshError if both are one mesh."""
    if source == target:
        raise zo.MeshError(
            f"'{target.name}' cannot be its own source: choose another source, or make another mesh active."
        )
    if source.data == target.data:
        raise zo.MeshError(
            f"'{source.name}' and '{target.name}' share one mesh: make the target single-user, "
            "or choose another source."
        )


def read_pair(context: Context, source_name: str, target_name: str) -> ObjectPair:
    """Read both objects of a match.

    Raises:
        MeshError: one of them cannot be used, or the target cannot be written to.
    """
    return drain(read_pair_steps(context, source_name, target_name))


def read_pair_steps(context: Context, source_name: str, target_name: str) -> Steps[ObjectPair]:
    """`read_pair` as a generator, which holds no Blender data while it is suspended.

    What tells an edit is read before the first yield, so that all edits from then on are noticed.
    """
    of_source, of_target = _looked_at(context, source_name, target_name)
    yield READING
    source = mesh_data.read_source_surface(find_mesh(context, source_name), context.evaluated_depsgraph_get())
    yield READING
    target = mesh_data.read_target_surface(find_mesh(context, target_name), context.evaluated_depsgraph_get())
    pair = ObjectPair(
        source_name,
        target_name,
        source,
        target,
        of_source.fingerprint,
        of_target.fingerprint,
        of_source.content,
        of_target.content,
        of_source.mirrored,
        of_target.mirrored,
    )
    yield READING
    check_unedited(context, pair)
    return pair


def check_unedited(context: Context, pair: ObjectPair) -> tuple[Object, Object]:
    """The source and the target, which are still what they were when the pair was read.

    Raises:
        MeshError: one of them was removed or edited since.
    """
    now = _looked_at(context, pair.source_name, pair.target_name)
    for name, before, after in (
        (pair.source_name, pair.source_fingerprint, now[0].fingerprint),
        (pair.target_name, pair.target_fingerprint, now[1].fingerprint),
    ):
        if before != after:
            raise zo.MeshError(f"'{name}' was edited while it was being worked on: start again.")
    return find_mesh(context, pair.source_name), find_mesh(context, pair.target_name)


def users_of_mesh(context: Context, target: Object) -> int:
    """How many objects of the file show the target's mesh."""
    return sum(obj.data == target.data for obj in context.blend_data.objects)


def _looked_at(context: Context, source_name: str, target_name: str) -> tuple[Look, Look]:
    """A look at the source and one at the target, which can be matched.

    Raises:
        MeshError: one of them cannot be used, or the target cannot be written to.
    """
    source, target = find_mesh(context, source_name), find_mesh(context, target_name)
    check_distinct(source, target)
    check_writable(target)
    depsgraph = context.evaluated_depsgraph_get()
    return (
        _look(source, mesh_data.read_source_faces(source, depsgraph)),
        _look(target, mesh_data.read_target_faces(target, depsgraph)),
    )


def _look(obj: Object, faces: mesh_data.Faces) -> Look:
    """A look at an object whose surface has these faces."""
    content, mirrored = mesh_data.content_hash(obj.data), mesh_data.is_mirrored(obj)
    # Not of the triangles: a pose that folds a quad of a subdivided mesh divides it another way. The numbers are
    # hashed as a surface has them.
    corner_vertex = faces.corner_vertex.astype(np.int64)
    face_start = np.append(faces.start, len(corner_vertex)).astype(np.int64)
    return Look(hash_of(f"{content} {mirrored}", corner_vertex, face_start), content, mirrored)
