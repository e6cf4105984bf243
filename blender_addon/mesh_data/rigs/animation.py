# SPDX-License-Identifier: GPL-3.0-or-later
"""Animation of objects, of the armatures that deform them, and of shape keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain

import bpy
import numpy as np
from bpy.types import AnimData, FCurve, NlaStrip, Object
from mathutils import Matrix, Vector

from zoomout_core.arrays import Floats, Integers

from ..matrices import world_matrix
from .armatures import OF_PLACE, armatures_of, copy_value, read_bones

# Maximum number of frames that are evaluated.
FRAMES = 48
# The properties of a bone in a pose that its matrix depends on.
CHANNELS = ("location", "rotation_mode", "rotation_quaternion", "rotation_euler", "rotation_axis_angle", "scale")


def moves_by_itself(obj: Object) -> bool:
    """Whether an action or NLA tracks of an object animate its location, rotation or scale."""
    animation = obj.animation_data
    if animation is None:
        return False
    curves = [_curves(animation), *(_curves(strip) for track in animation.nla_tracks for strip in track.strips)]
    return any(curve.data_path.removeprefix("delta_") in OF_PLACE for curve in chain.from_iterable(curves))


def _curves(animation: AnimData | NlaStrip) -> list[FCurve]:
    """The curves of the action of an object or other data, or of an NLA strip."""
    action = animation.action
    if action is None:
        return []
    if not hasattr(action, "layers"):  # before Blender 4.4
        return list(action.fcurves)
    if animation.action_slot is None:
        return []
    bags = (strip.channelbag(animation.action_slot) for layer in action.layers for strip in layer.strips)
    return [curve for bag in bags if bag is not None for curve in bag.fcurves]


def frames_of_animation(obj: Object) -> Integers:
    """(f,) frames of the animation of an object's armatures, evenly distributed; empty without animation."""
    spans = [span for armature in armatures_of(obj) for span in _spans(armature.animation_data)]
    if not spans:
        return np.empty(0, dtype=np.int64)
    first, last = min(start for start, _ in spans), max(end for _, end in spans)
    return np.unique(np.linspace(first, last, FRAMES).round().astype(np.int64))


def read_animation(obj: Object, frames: Integers | None = None) -> Floats:
    """(f, b, 3, 4) transforms of the deforming bones of an object in frames of its armatures' animation.

    They lead from rest to the pose, in world space; bones are in the order of `read_bones`. Empty without animation.
    The frames are evaluated in a temporary scene, so that the current frame and all poses stay as they are.

    Args:
        obj: the object.
        frames: (f,) the frames; those of `frames_of_animation` when not given.
    """
    bones, armatures = read_bones(obj), armatures_of(obj)
    frames = frames_of_animation(obj) if frames is None else frames
    if not len(frames):
        return np.empty((0, len(bones.names), 3, 4))
    scene = bpy.data.scenes.new("Frames")
    try:
        for armature in armatures:
            scene.collection.objects.link(armature)
        poses = []
        for frame in frames.tolist():
            scene.frame_set(frame)
            poses.append(_transforms(armatures, bones.names, scene.view_layers[0].depsgraph))
    finally:
        bpy.data.scenes.remove(scene)
    return np.array(poses)


class HeldPose:
    """The pose of an object's armature, to restore it later; it keeps no reference to Blender's data."""

    def __init__(self, armature: Object) -> None:
        self._channels = {
            bone.name: {name: copy_value(getattr(bone, name)) for name in CHANNELS} for bone in armature.pose.bones
        }

    def restore(self, armature: Object) -> None:
        """Restore the pose of the bones that still exist."""
        for bone in armature.pose.bones:
            for name, value in self._channels.get(bone.name, {}).items():
                setattr(bone, name, value)


class HeldKeys:
    """The state of an object's shape keys, to play them and to restore it; it keeps no reference to Blender's data."""

    def __init__(self, obj: Object) -> None:
        key = obj.data.shape_keys
        blocks = [] if key is None else list(key.key_blocks)
        self._values = {block.name: (block.value, block.mute) for block in blocks}
        self._pinned = obj.show_only_shape_key
        animation = None if key is None else key.animation_data
        self._uses_tracks = animation is not None and animation.use_nla
        self._muted = {place: curve.mute for place, curve in _curves_of_keys(obj)}

    def play(self, obj: Object, name: str, value: float) -> None:
        """Show one key at a value, and no other, regardless of drivers and animations."""
        obj.show_only_shape_key = False
        for _, curve in _curves_of_keys(obj):
            curve.mute = True
        self._use_tracks(obj, False)
        for block in obj.data.shape_keys.key_blocks if obj.data.shape_keys else ():
            block.value, block.mute = (value, False) if block.name == name else (0, block.mute)

    def restore(self, obj: Object) -> None:
        """Restore the keys that still exist."""
        obj.show_only_shape_key = self._pinned
        for block in obj.data.shape_keys.key_blocks if obj.data.shape_keys else ():
            if block.name in self._values:
                block.value, block.mute = self._values[block.name]
        for place, curve in _curves_of_keys(obj):
            curve.mute = self._muted.get(place, False)
        self._use_tracks(obj, self._uses_tracks)

    @staticmethod
    def _use_tracks(obj: Object, use: bool) -> None:
        animation = obj.data.shape_keys and obj.data.shape_keys.animation_data
        if animation:
            animation.use_nla = use


def _curves_of_keys(obj: Object) -> list[tuple[tuple[str, str], FCurve]]:
    """The drivers and the curves of the action of an object's shape keys, each with its kind and path."""
    key = obj.data.shape_keys
    if key is None or key.animation_data is None:
        return []
    curves = {"driver": key.animation_data.drivers, "action": _curves(key.animation_data)}
    return [((kind, curve.data_path), curve) for kind, of_kind in curves.items() for curve in of_kind]


def turn_bones(armature: Object, turns: Mapping[str, Floats]) -> None:
    """Rotate named bones of an armature from rest; all others are at rest.

    Args:
        armature: the armature.
        turns: rotation vectors (3,) by the names of bones, in radians about the axes of the world.
    """
    to_armature, still = np.linalg.inv(world_matrix(armature))[:3, :3], np.zeros(3)
    for bone in armature.pose.bones:
        turn = turns.get(bone.name, still)
        axis = bone.bone.matrix_local.to_3x3().inverted() @ Vector(to_armature @ turn)
        angle = float(np.linalg.norm(turn))
        bone.matrix_basis = Matrix.Rotation(angle, 4, axis) if angle else Matrix()


def follow_constraints(armatures: Sequence[Object]) -> bool:
    """Whether constraints move all deforming bones of armatures, so that these cannot be turned."""
    bones = [bone for armature in armatures for bone in armature.pose.bones if bone.bone.use_deform]
    return all(any(one.enabled and one.influence > 0 for one in bone.constraints) for bone in bones)


def _spans(animation: AnimData | None) -> list[tuple[float, float]]:
    """First and last frames of an object's action and of its NLA strips."""
    if animation is None:
        return []
    strips = [strip for track in animation.nla_tracks if not track.mute for strip in track.strips]
    spans = [(strip.frame_start, strip.frame_end) for strip in strips]
    return [*spans, tuple(animation.action.frame_range)] if _curves(animation) else spans


def _transforms(armatures: Sequence[Object], names: Sequence[str], depsgraph: bpy.types.Depsgraph) -> Floats:
    """(b, 3, 4) transforms of bones, of the first armature that has each, from rest to an evaluated pose."""
    found = {}
    for armature in armatures:
        world, posed = world_matrix(armature), armature.evaluated_get(depsgraph).pose.bones
        for bone in armature.data.bones:
            if bone.use_deform and bone.name not in found:
                pose, rest = np.array(posed[bone.name].matrix), np.array(bone.matrix_local)
                found[bone.name] = (world @ pose @ np.linalg.inv(world @ rest))[:3]
    return np.array([found[name] for name in names])
