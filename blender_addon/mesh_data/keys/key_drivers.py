# SPDX-License-Identifier: GPL-3.0-or-later
"""Drivers of shape keys: the armatures, bones and keys that they read, and their partners in another character."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import bpy
from bpy.types import ID, DriverTarget, FCurve, Key, Object, Scene

from .write_keys import path_of_key

# A bone in a data path; its name is escaped.
BONE = re.compile(r'\bbones\["((?:[^"\\]|\\.)*)"\]')


@dataclass(frozen=True, eq=False)
class Partners:
    """The data that drivers read on another object.

    Attributes:
        blocks: data-blocks, by those that they replace: armatures with their data, shape keys.
        bones: names of the bones of replaced armatures; bones without a partner are missing. None for the same.
        if_present: data-blocks that replace others only where they have the property that a driver reads.
    """

    blocks: Mapping[Any, Any]
    bones: Mapping[str, str] | None = None
    if_present: Mapping[Any, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Redirected:
    """The outcome for the drivers of some keys.

    Attributes:
        removed: names of keys whose drivers were removed, because the partners lack the bones or properties.
        lacking: names of bones, and paths of properties, that are lacking.
        outside: names of data-blocks that drivers read still, besides the object and its partners.
    """

    removed: list[str] = field(default_factory=list)
    lacking: list[str] = field(default_factory=list)
    outside: list[str] = field(default_factory=list)


def partner_armatures(source: Object, target: Object) -> dict[Any, Any]:
    """The armature that drivers read, the one to read instead, and the data of both."""
    return {source: target, source.data: target.data}


def bones_of_drivers(key: Key, names: Collection[str], armature: Object) -> set[str]:
    """The names of an armature's bones that drivers of some keys read."""
    found = set[str]()
    for _, curve in _drivers(key, names):
        for kind, target in _driver_targets(curve):
            if target.id in (armature, armature.data):
                found |= {bpy.utils.unescape_identifier(name) for name in BONE.findall(target.data_path)}
                found |= {target.bone_target} if _reads_bone(kind, target) else set()
    return found


def is_corrective(key: Key, name: str) -> bool:
    """Whether bones drive a key."""
    return any(
        _reads_bone(kind, target) or BONE.search(target.data_path)
        for _, curve in _drivers(key, [name])
        for kind, target in _driver_targets(curve)
    )


def redirect_drivers(key: Key, partners: Partners, names: Collection[str] | None = None) -> Redirected:
    """Redirect drivers of keys to partners; remove those whose partners lack data, and turn their keys off.

    Args:
        key: the shape keys of an object, with drivers that were copied from another one.
        partners: the data that they read instead.
        names: names of the keys; all when not given.
    """
    result = Redirected()
    for name, curve in _drivers(key, key.key_blocks.keys() if names is None else names):
        lacking = [what for kind, target in _driver_targets(curve) if (what := _redirect(kind, target, partners))]
        if lacking:
            _add(result.lacking, lacking)
            _add(result.removed, [name])
            if curve.data_path == f"{path_of_key(name)}value":
                key.key_blocks[name].value = 0
            key.animation_data.drivers.remove(curve)
            continue
        inside = {key, *partners.blocks.values(), *partners.if_present.values()}
        read = [
            target.id
            for _, target in _driver_targets(curve)
            if target.id is not None and not isinstance(target.id, Scene)
        ]
        _add(result.outside, [each.name for each in read if each not in inside])
    return result


def _drivers(key: Key, names: Collection[str]) -> Iterator[tuple[str, FCurve]]:
    """The drivers of some keys, each with the name of its key."""
    for name in names if key.animation_data else ():
        for curve in [each for each in key.animation_data.drivers if each.data_path.startswith(path_of_key(name))]:
            yield name, curve


def _driver_targets(curve: FCurve) -> Iterator[tuple[str, DriverTarget]]:
    """The targets of the variables of a driver, each with the type of its variable."""
    for variable in curve.driver.variables:
        for target in variable.targets if variable.type != "CONTEXT_PROP" else ():
            yield variable.type, target


def _reads_bone(kind: str, target: DriverTarget) -> bool:
    return kind != "SINGLE_PROP" and bool(target.bone_target) and getattr(target.id, "pose", None) is not None


def _redirect(kind: str, target: DriverTarget, partners: Partners) -> str:
    """Redirect a target of a driver's variable to the partner; returns the name of lacking data, or nothing."""
    read = target.id
    other = partners.blocks.get(read, partners.if_present.get(read))
    if other is None or other == read:
        return ""
    path, bone = target.data_path, target.bone_target
    lacking = ""
    if partners.bones is not None:
        path, bone, lacking = _find_names(kind, target, partners.bones)
    if not lacking and kind == "SINGLE_PROP" and _has(read, target.data_path) and not _has(other, path):
        lacking = path
    if (
        not lacking
        and _reads_bone(kind, target)
        and target.bone_target in read.pose.bones
        and bone not in other.pose.bones
    ):
        lacking = bone
    if not lacking:
        target.id = other
        target.data_path, target.bone_target = path, bone
    return lacking if read in partners.blocks else ""


def _find_names(kind: str, target: DriverTarget, bones: Mapping[str, str]) -> tuple[str, str, str]:
    """The path and the bone of a target with the names of other bones, and one that has none, or nothing."""
    bone = target.bone_target
    read = [bpy.utils.unescape_identifier(name) for name in BONE.findall(target.data_path)]
    read += [bone] if _reads_bone(kind, target) else []

    def with_other_bone(found: re.Match[str]) -> str:
        name = bpy.utils.unescape_identifier(found[1])
        return f'bones["{bpy.utils.escape_identifier(bones.get(name, name))}"]'

    lacking = next((name for name in read if name not in bones), "")
    return BONE.sub(with_other_bone, target.data_path), bones.get(bone, bone), lacking


def _has(block: ID, path: str) -> bool:
    """Whether a data-block has a property."""
    try:
        block.path_resolve(path)
    except ValueError:
        return False
    return True


def _add(listed: list[str], new: list[str]) -> None:
    listed.extend(each for each in dict.fromkeys(new) if each not in listed)
