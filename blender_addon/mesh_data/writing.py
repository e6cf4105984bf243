# SPDX-License-Identifier: GPL-3.0-or-later
"""Writing that is rolled back if it fails at any step.

Blender's own undo reverts an operator that has succeeded; this reverts operators, functions of scripts and commands
that fail.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
from bpy.types import ID, Key, Object

from .rigs.armatures import Place, copy_modifier

# Kinds of data-blocks that writing adds to the file, users before the data-blocks that they use.
ADDED_TO = ("objects", "meshes", "hair_curves", "collections", "actions", "materials", "node_groups", "images")
# Kinds of which an added data-block stays while it has users: it may have restored data, see `outfit_bones`.
ADDED_IF_UNUSED = ("armatures",)


class Writing:
    """The objects that are being written, and their state before."""

    def __init__(self) -> None:
        self._before: list[_Before] = []
        self._replaced: list[tuple[ID, str]] = []
        self._present = {one.session_uid for kind in (*ADDED_TO, *ADDED_IF_UNUSED) for one in getattr(bpy.data, kind)}

    def keep(self, obj: Object) -> None:
        """Remember an object before it is written to, with its data, its place and its children's."""
        before = _Before(obj)
        self._before.append(before)
        for writing in _enclosing:
            writing._present |= before.copies

    def replace(self, *blocks: ID) -> None:
        """Free the names of data-blocks for others; they are removed when all is written.

        Objects come before their data, which stays if it has other users.
        """
        for one in blocks:
            self._replaced.append((one, one.name))
            one.name = f"{one.name} before"

    def take_over(self, other: Writing) -> None:
        """Roll back another writing, too, if this one fails."""
        self._before += other._before
        self._replaced += other._replaced

    def take_back(self) -> None:
        """Restore changed objects, and remove added ones."""
        for before in reversed(self._before):
            before.restore()
        for kind in ADDED_TO:
            bpy.data.batch_remove(self._find_added(kind))
        for kind in ADDED_IF_UNUSED:
            bpy.data.batch_remove([one for one in self._find_added(kind) if not one.users])
        for one, name in self._replaced:
            one.name = name
        bpy.context.view_layer.update()

    def _find_added(self, kind: str) -> list[ID]:
        """The data-blocks of a kind that were added to the file since."""
        return [one for one in getattr(bpy.data, kind) if one.session_uid not in self._present]

    def finish(self) -> None:
        """Forget the state before, and remove replaced data-blocks."""
        for before in self._before:
            before.forget()
        replaced = [one for one, _ in self._replaced]
        bpy.data.batch_remove([one for one in replaced if isinstance(one, Object)])
        others = [one for one in replaced if not isinstance(one, Object)]
        while unused := [one for one in others if not one.users]:  # a material may use an image
            others = [one for one in others if one.users]
            bpy.data.batch_remove(unused)


# Nested writings, the innermost last: writing for several targets encloses the writing of each.
_enclosing: list[Writing] = []


@contextmanager
def all_or_nothing(*objects: Object) -> Iterator[Writing]:
    """A context for writing to objects, which restores them if the block fails.

    An enclosing context rolls back the writing of this one, too.

    Args:
        objects: objects whose data, vertex groups, shape keys, materials, place or armature modifiers are written. New
            objects and data-blocks need not be named.
    """
    writing = Writing()
    _enclosing.append(writing)
    try:
        for obj in dict.fromkeys(objects):
            writing.keep(obj)
        yield writing
    except BaseException:
        _enclosing.pop()
        writing.take_back()
        raise
    _enclosing.pop()
    if _enclosing:
        _enclosing[-1].take_over(writing)
    else:
        writing.finish()


def remove_when_written(block: ID) -> None:
    """Remove a data-block without users once the innermost `all_or_nothing` has succeeded, or now if there is none."""
    if _enclosing:
        _enclosing[-1].replace(block)
    else:
        bpy.data.batch_remove([block])


class _Before:
    """The state of an object before, as a copy outside any scene.

    Attributes:
        copies: `session_uid` of the copy and of its data.
    """

    def __init__(self, obj: Object) -> None:
        self._obj, self._place = obj, Place(obj)
        self._name, self._fake_user = obj.data.name, obj.data.use_fake_user
        keys = getattr(obj.data, "shape_keys", None)
        self._name_of_keys = keys and keys.name
        self._copy = obj.copy()
        self._copy.data = obj.data.copy()
        self.copies = {self._copy.session_uid, self._copy.data.session_uid}

    def restore(self) -> None:
        """Replace the object's data by the copy's wherever it is used, and restore its place and modifiers."""
        written, data = self._obj.data, self._copy.data
        if self._name_of_keys and written.shape_keys:
            _let_drivers_refer(written.shape_keys, data.shape_keys)
        written.user_remap(data)
        bpy.data.batch_remove([written])
        data.name, data.use_fake_user = self._name, self._fake_user
        if self._name_of_keys:
            data.shape_keys.name = self._name_of_keys
        self._place.restore()
        self._restore_modifiers()
        if self._name_of_keys:
            self._obj.active_shape_key_index = self._copy.active_shape_key_index
        bpy.data.batch_remove([self._copy])

    def _restore_modifiers(self) -> None:
        """Restore armature modifiers and node groups; writing does not remove other modifiers."""
        names = {one.name for one in self._copy.modifiers}
        for one in [one for one in self._obj.modifiers if one.type == "ARMATURE" or one.name not in names]:
            self._obj.modifiers.remove(one)
        for place, one in enumerate(self._copy.modifiers):
            if one.type == "ARMATURE":
                copy_modifier(one, self._obj, place)
            elif one.type == "NODES":
                self._obj.modifiers[one.name].node_group = one.node_group
        active = self._copy.modifiers.active
        self._obj.modifiers.active = active and self._obj.modifiers[active.name]

    def forget(self) -> None:
        """Remove the copy."""
        bpy.data.batch_remove([self._copy, self._copy.data])


def _let_drivers_refer(before: Key, now: Key) -> None:
    """Redirect drivers from one data-block of shape keys to another."""
    for user in bpy.data.user_map(subset=[before])[before]:
        animation = getattr(user, "animation_data", None)
        for curve in animation.drivers if animation else ():
            for variable in curve.driver.variables:
                for end in variable.targets:
                    if end.id == before:
                        end.id = now
