# SPDX-License-Identifier: GPL-3.0-or-later
"""Metarigs, from which Blender's add-on Rigify generates rigs."""

from __future__ import annotations

from bpy.types import Context, Object

from zoomout_core.arrays import Floats

from .moved_rig import RigBones, copy_rig


def metarig_of(context: Context, armature: Object) -> Object | None:
    """The metarig in the scene that an armature was generated from; None if there is none, or Rigify is disabled."""
    armatures = (obj for obj in context.scene.objects if obj.type == "ARMATURE")
    return next((obj for obj in armatures if getattr(obj.data, "rigify_target_rig", None) == armature), None)


def copy_metarig(
    context: Context, metarig: Object, rig: Object, beside: Object, bones: RigBones, motion: Floats
) -> Object:
    """Copy a metarig with its bones at other places, see `copy_rig`; generating it again changes another rig.

    Args:
        context: Blender's, in Object Mode.
        metarig: the metarig.
        rig: the rig that the copy generates.
        beside: an object whose name the copy's name contains, and whose collections it is in.
        bones: all bones in their new places, in world space.
        motion: (4, 4) the similarity from the place of the metarig to that of the copy.
    """
    made = copy_rig(context, metarig, beside, bones, motion)
    _generate_into(made, rig)
    return made


def copy_loose_rig(context: Context, armature: Object, beside: Object, bones: RigBones, motion: Floats) -> Object:
    """`copy_rig` of an armature that may be a metarig, which then generates a new rig."""
    made = copy_rig(context, armature, beside, bones, motion)
    if hasattr(made.data, "rigify_target_rig"):
        _generate_into(made, None)
    return made


def _generate_into(metarig: Object, rig: Object | None) -> None:
    metarig.data.rigify_target_rig = rig
    # Or it would overwrite the custom shapes and the panel of the original rig.
    metarig.data.rigify_widgets_collection = metarig.data.rigify_rig_ui = None
