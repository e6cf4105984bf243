# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a target can be bound to the armature of its source."""

from __future__ import annotations

from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats

from ... import mesh_data
from ...adapters import Binding, Settings
from ...scene.pair import check_context, find_mesh, users_of_mesh


def check_binding(context: Context, source_name: str, target_name: str, binding: Binding, settings: Settings) -> None:
    """Raise a MeshError if a target cannot be bound to the armature of a source.

    Args:
        context: Blender's.
        source_name: name of the source, which has the armature.
        target_name: name of the target.
        binding: how to bind it.
        settings: how to transfer its weights.
    """
    check_context(context)
    context.view_layer.update()  # a script may have moved objects since
    source, target = find_mesh(context, source_name), find_mesh(context, target_name)
    if binding.move_rig and not moves_vertices(source):
        raise zo.MeshError(
            "No bone weights of '{source}' belong to an armature: choose a source that an armature deforms, or select "
            "the armature inside it as well, such as a metarig, to move it alone.",
            source=source.name,
        )
    _check_rig(source)
    check_in_scene(context, source)
    if binding.move_rig:
        _check_movable(source, target)
    if settings.flip_names:
        raise zo.MeshError("Flip Group Names cannot be used with Bind to Rig: turn it off.")
    _check_bindable(context, target, binding)
    if mesh_data.is_flat(source):
        raise zo.MeshError(
            "'{source}' has a scale of zero, so nothing can be bound to its armature: change its scale.",
            source=source.name,
        )
    if mesh_data.moves_by_itself(target):
        raise zo.MeshError(
            "'{target}' has an animation of its own, which would move it off the rig: clear its location, rotation and "
            "scale animation, or bind a copy without it.",
            target=target.name,
        )
    if not mesh_data.can_be_put(source, target):
        raise zo.MeshError(
            "Constraints, drivers or animation control the transform of '{target}': remove them, so "
            "that it can be parented to the armature.",
            target=target.name,
        )


def _check_bindable(context: Context, target: Object, binding: Binding) -> None:
    """Check that a target has no other rig, and a mesh of its own."""
    if target.parent is not None and target.parent_type == "BONE":
        raise zo.MeshError(
            "'{target}' is already parented to a bone: clear its parent to bind it to the armature.", target=target.name
        )
    if mesh_data.armatures_of(target) and not binding.replace:
        raise zo.MeshError(
            "'{target}' is already bound to {armatures}: turn on Replace Binding, or remove its Armature modifier.",
            target=target.name,
            armatures=armature_names(target),
        )
    if (users := users_of_mesh(context, target)) > 1:
        raise zo.MeshError(
            "The mesh of '{target}' is shared by {users} objects, which would all change: make it single-user.",
            target=target.name,
            users=users,
        )
    if target.data.shape_keys is not None and not target.data.shape_keys.use_relative:
        raise zo.MeshError(
            "The shape keys of '{name}' are absolute: turn on Relative in its shape keys.", name=target.name
        )


def _check_rig(source: Object) -> None:
    """Raise a MeshError unless an armature deforms an object by vertex groups."""
    if not mesh_data.armatures_of(source):
        if any(modifier.type == "ARMATURE" for modifier in source.modifiers):
            raise zo.MeshError(
                "The Armature modifier of '{source}' has no object: choose the armature in it.", source=source.name
            )
        raise zo.MeshError(
            "'{source}' has no Armature modifier: choose a source that an armature deforms.", source=source.name
        )
    if not moves_vertices(source):
        raise zo.MeshError(
            "No deform bone of {armatures} is named like a vertex group of '{source}': add bone "
            "weights to the source first.",
            armatures=armature_names(source),
            source=source.name,
        )


def check_in_scene(context: Context, obj: Object) -> None:
    """Raise a MeshError if an armature that deforms an object is not in its scene, where nothing poses it."""
    for armature in mesh_data.armatures_of(obj):
        if context.scene.objects.get(armature.name) != armature:
            raise zo.MeshError(
                "The armature '{armature}' of '{name}' is not in this scene: link it to the scene first.",
                armature=armature.name,
                name=obj.name,
            )


def moves_vertices(source: Object) -> bool:
    """Whether an object has vertex groups of bones of its armatures."""
    return bool(mesh_data.deforming_bones(source) & {group.name for group in source.vertex_groups})


def _check_movable(source: Object, target: Object) -> None:
    """Raise a MeshError if the armature of a source cannot be moved into a target."""
    first, *others = mesh_data.armatures_of(source)
    if others:
        raise zo.MeshError(
            "'{source}' is deformed by several armatures ({armatures}), and only one can be moved: join them first, or "
            "use Bind to Rig.",
            source=source.name,
            armatures=armature_names(source),
        )
    check_armature(first)
    if mesh_data.worn_copies(target):
        raise zo.MeshError(
            "'{target}' wears copies of clothes, which would stay on the source's rig: move the rig first, and dress "
            "the target then.",
            target=target.name,
        )


def check_armature(armature: Object) -> None:
    """Raise a MeshError if an armature cannot be copied to another place."""
    if armature.mode == "EDIT":
        raise zo.MeshError("'{armature}' is in Edit Mode: leave it first.", armature=armature.name)
    if mesh_data.moves_by_itself(armature):
        raise zo.MeshError(
            "The location, rotation or scale of '{armature}' is animated, so a copy of it would not stay at the "
            "target: animate its root bone instead, or clear that animation.",
            armature=armature.name,
        )


def check_keys_of_posed(target: Object, seen: Floats) -> None:
    """Raise a MeshError if a target that an armature poses has shape keys, because these belong to another pose."""
    if target.data.shape_keys is None or not mesh_data.armatures_of(target):
        return
    if not mesh_data.stands_as_modelled(target, seen):
        raise zo.MeshError(
            "'{target}' has shape keys and is posed by {armatures}: set that armature to Rest "
            "Position, and match again.",
            target=target.name,
            armatures=armature_names(target),
        )


def armature_names(obj: Object) -> str:
    """The names of an object's armatures, for a message."""
    return ", ".join(f"'{armature.name}'" for armature in mesh_data.armatures_of(obj))
