# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's handlers: drop cached facts and landmarks of changed or removed objects, and update the preview.

They also have the selected objects prepared for a match.
"""

from __future__ import annotations

from typing import Any

import bpy
from bpy.app.handlers import persistent
from bpy.types import Depsgraph, Mesh, Object, Scene

from . import services
from .operators.base import prepare_ahead
from .scene import landmarks, mesh_facts
from .viewport import overlay, preview


@persistent
def _after_update(scene: Scene, depsgraph: Depsgraph) -> None:
    changed = [update.id.original for update in depsgraph.updates if update.is_updated_geometry]
    meshes = [one for one in changed if isinstance(one, Mesh)]
    mesh_facts.forget(meshes)
    prepare_ahead.forget(meshes)
    prepare_ahead.consider()
    overlay.repose(one.session_uid for one in changed if isinstance(one, Object))
    preview.follow_edit(meshes)
    preview.follow_selection()
    if depsgraph.id_type_updated("SCENE"):  # as when objects are removed
        landmarks.forget_removed_objects(scene)


@persistent
def _after_undo(*_: Any) -> None:
    mesh_facts.forget_all()
    overlay.repose()
    if (shown := preview.current()) is not None:
        services.matching.previews.follow_undo(bpy.context, shown)


@persistent
def _after_load(*_: Any) -> None:
    forget_everything()


HANDLERS = (
    ("depsgraph_update_post", _after_update),
    ("undo_post", _after_undo),
    ("redo_post", _after_undo),
    ("load_post", _after_load),
)


def register() -> None:
    """Add the handlers."""
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    """Remove the handlers, and clear the caches."""
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).remove(handler)
    forget_everything()


def forget_everything() -> None:
    """Clear all caches of the open file."""
    prepare_ahead.clear()
    mesh_facts.forget_all()
    services.matching.cached_results.clear()
    preview.clear()
