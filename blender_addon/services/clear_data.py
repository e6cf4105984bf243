# SPDX-License-Identifier: GPL-3.0-or-later
"""Remove only the stored data of matches, transfers, links and symmetries from meshes and scenes."""

from __future__ import annotations

from collections.abc import Iterable

from bpy.types import Context, Mesh, Object

import zoomout_core as zo
from zoomout_core.messages import message, plural

from .. import mesh_data
from ..scene.landmarks import landmarks_in_words, remove_landmarks_on
from ..storage import stored_candidates, stored_link, stored_match, stored_report, stored_symmetry
from ..viewport import preview


def clear_match_data(context: Context, objects: Iterable[Object]) -> str:
    """Remove matches, their candidates, reports, links and symmetries from meshes, and landmarks from objects.

    Transferred data stays. A match is stored on the target's mesh, so clearing a source does not remove it.

    Args:
        context: Blender's.
        objects: objects of any type, in Object Mode; meshes of other files are not changed.

    Returns:
        A sentence for the user.

    Raises:
        MeshError: a mesh is in Edit Mode; nothing was removed.
    """
    meshes = [obj for obj in objects if obj.type == "MESH"]
    return _clear(context, dict.fromkeys(obj.data for obj in meshes), meshes)


def clear_file(context: Context) -> str:
    """`clear_match_data` for all meshes and scenes of the file."""
    return _clear(context, context.blend_data.meshes, [obj for obj in context.blend_data.objects if obj.type == "MESH"])


def _clear(context: Context, meshes: Iterable[Mesh], objects: list[Object]) -> str:
    own = [mesh for mesh in meshes if mesh.library is None and mesh.override_library is None]
    for mesh in own:
        if mesh.is_editmode:
            raise zo.MeshError("The mesh '{mesh}' is being edited: leave its Edit Mode.", mesh=mesh.name)
    for obj in objects:
        if obj.data in own:
            mesh_data.remove_link(obj)
    cleared = [mesh for mesh in own if _clear_mesh(mesh)]
    landmarks = sum(remove_landmarks_on(scene, objects) for scene in context.blend_data.scenes if not scene.library)
    shown = preview.current()
    if shown is not None and shown.object_uid in {obj.session_uid for obj in objects if obj.data in cleared}:
        preview.clear()
    return message(
        "Cleared {meshes} and {landmarks}",
        meshes=plural(len(cleared), "1 mesh", "{count} meshes"),
        landmarks=landmarks_in_words(landmarks),
    )


def _clear_mesh(mesh: Mesh) -> bool:
    """Remove all stored data from a mesh; returns whether there was any."""
    before = len(mesh.attributes), len(mesh.keys())
    stored_match.remove(mesh)
    stored_candidates.remove(mesh)
    stored_report.remove(mesh)
    stored_link.remove(mesh)
    stored_symmetry.forget(mesh)
    if (len(mesh.attributes), len(mesh.keys())) == before:
        return False
    mesh.update()
    return True
