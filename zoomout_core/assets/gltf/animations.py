# SPDX-License-Identifier: GPL-3.0-or-later
"""Keep the animations and the copies of meshes of a glTF document whose meshes are rewritten."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from copy import deepcopy
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from zoomout_core.assets.gltf.meshes import Renumbering
from zoomout_core.mesh.formats.gltf_buffer import Buffer
from zoomout_core.mesh.formats.gltf_document import INSTANCES, POINTER, Document

if TYPE_CHECKING:
    from pygltflib import GLTF2, AnimationChannelTarget, AnimationSampler

# The path of the weights of morph targets, in channels and in pointers.
WEIGHTS = "weights"
# Tables of a document whose numbers change with the materials.
OF_MATERIALS = ("materials", "textures", "images", "samplers")


class _Target(NamedTuple):
    """The target of an animation channel.

    Attributes:
        node: number of the node; None for a pointer.
        pointer: the steps of a pointer of KHR_animation_pointer; empty for a node.
        meshes: the mesh of the document and the written one, if the weights of all their morph targets are animated.
    """

    node: int | None = None
    pointer: tuple[str, ...] = ()
    meshes: tuple[int, int] | None = None


class _Accessors:
    """Copies of a document's accessors, each made once; normalised integers become fractions."""

    def __init__(self, document: Document, buffer: Buffer) -> None:
        self.document, self.buffer = document, buffer
        self._copies: dict[int, int] = {}

    def copy(self, number: int) -> int:
        """The number of an accessor's copy."""
        if number not in self._copies:
            bounded = self.document.gltf.accessors[number].min is not None
            self._copies[number] = self.buffer.add(self.document.array(number).astype("<f4"), bounded=bounded)
        return self._copies[number]


def keep_animations(
    made: GLTF2, document: Document, renumbering: Renumbering, keeps_materials: bool, buffer: Buffer
) -> tuple[str, ...]:
    """Copy the animations of a document, with the weights of the morph targets that there are now; returns notes.

    Args:
        made: the document to write, with its meshes.
        document: the document with the animations.
        renumbering: the new numbers of nodes, meshes and morph targets.
        keeps_materials: whether materials, textures and images have the same numbers.
        buffer: the buffer of the written document.
    """
    accessors, notes = _Accessors(document, buffer), dict[str, None]()
    made.animations = []
    for animation in document.gltf.animations:
        found = [
            (
                each,
                [one for one in targets if _has_weights(animation.samplers[each.sampler], one, document, renumbering)],
            )
            for each in animation.channels
            for targets in [_targets(each.target, made, document, renumbering, keeps_materials)]
        ]
        if not all(targets for _, targets in found):
            notes["Animations of materials or morph targets that are gone were left out."] = None
        pairs = [(channel, target) for channel, targets in found for target in targets]
        counts = Counter((channel.target.path, target.node, target.pointer) for channel, target in pairs)
        if any(count > 1 for count in counts.values()):
            notes["Animated weights of several meshes' morph targets were left out, because they were joined."] = None
        written = deepcopy(animation)
        written.channels, written.samplers = [], []
        numbers: dict[tuple[int, tuple[int, int] | None], int] = {}
        for channel, target in pairs:
            if counts[channel.target.path, target.node, target.pointer] > 1:
                continue
            key = channel.sampler, target.meshes
            if key not in numbers:
                numbers[key] = len(written.samplers)
                sampler = animation.samplers[channel.sampler]
                written.samplers.append(_copy_sampler(sampler, target.meshes, renumbering, accessors))
            own = deepcopy(channel)
            own.sampler, own.target.node = numbers[key], target.node
            if target.pointer:
                own.target.extensions[POINTER]["pointer"] = "/".join(("", *target.pointer))
            written.channels.append(own)
        if written.channels:
            made.animations.append(written)
    return tuple(notes)


def _targets(
    target: AnimationChannelTarget, made: GLTF2, document: Document, renumbering: Renumbering, keeps_materials: bool
) -> Iterator[_Target]:
    """Targets of a channel in the written document: none if its mesh is gone, several if that was split."""
    path = (target.extensions or {}).get(POINTER, {}).get("pointer") if target.path == "pointer" else None
    steps = tuple(path.split("/")[1:]) if isinstance(path, str) else ()
    nodes, meshes = document.gltf.nodes, document.gltf.meshes
    if target.path == WEIGHTS and target.node is not None:
        node = renumbering.nodes.get(target.node)
        if node is not None and nodes[target.node].mesh is not None and renumbering.key_names[made.nodes[node].mesh]:
            yield _Target(node, meshes=(nodes[target.node].mesh, made.nodes[node].mesh))
    elif steps[:1] == ("nodes",) and steps[2:3] == (WEIGHTS,):
        number = _number(steps[1], nodes)
        node = None if number is None else renumbering.nodes.get(number)
        if number is not None and node is not None:
            yield from _weights_of(steps, node, nodes[number].mesh, made.nodes[node].mesh, renumbering)
    elif steps[:1] == ("meshes",) and steps[2:3] == (WEIGHTS,):
        number = _number(steps[1], meshes)
        for mesh in () if number is None else renumbering.meshes.get(number, ()):
            yield from _weights_of(steps, mesh, number, mesh, renumbering)
    elif keeps_materials or steps[:1] == () or steps[0] not in OF_MATERIALS:
        yield _Target(target.node, steps)


def _weights_of(
    steps: tuple[str, ...], number: int, old: int | None, new: int, renumbering: Renumbering
) -> Iterator[_Target]:
    """A pointer to the weights of all morph targets of a mesh, or to that of one.

    Args:
        steps: the steps of the pointer.
        number: the new number of the node or mesh in it.
        old: the mesh of the document.
        new: the written mesh.
        renumbering: the new numbers of morph targets.
    """
    start = (steps[0], str(number), WEIGHTS)
    if old is None:
        return
    if len(steps) == 3 and renumbering.key_names[new]:
        yield _Target(None, start, (old, new))
    elif len(steps) == 4:
        key = _number(steps[3], renumbering.keys[old])
        key = None if key is None else renumbering.keys[old][key]
        if key is not None:
            yield _Target(None, (*start, str(key)))


def _has_weights(sampler: AnimationSampler, target: _Target, document: Document, renumbering: Renumbering) -> bool:
    """Whether a sampler has a weight for each morph target of the document's mesh, if these are animated."""
    if target.meshes is None:
        return True
    keys = renumbering.keys[target.meshes[0]]
    return bool(keys) and document.gltf.accessors[sampler.output].count % len(keys) == 0


def _number(step: str, table: Sequence[Any]) -> int | None:
    """The number of a step of a pointer; None if the table has no such row."""
    return int(step) if step.isdecimal() and int(step) < len(table) else None


def _copy_sampler(
    sampler: AnimationSampler, meshes: tuple[int, int] | None, renumbering: Renumbering, accessors: _Accessors
) -> AnimationSampler:
    """Copy the keyframes of a sampler; weights get a column for each morph target of the new mesh."""
    again = deepcopy(sampler)
    again.input = accessors.copy(sampler.input)
    keys = [] if meshes is None else renumbering.keys[meshes[0]]
    names = () if meshes is None else renumbering.key_names[meshes[1]]
    if meshes is None or keys == list(range(len(names))):
        again.output = accessors.copy(sampler.output)
        return again
    before = accessors.document.array(sampler.output).reshape(-1, len(keys))
    after = np.zeros((len(before), len(names)), "<f4")
    for old, new in enumerate(keys):
        if new is not None:
            after[:, new] = before[:, old]
    again.output = accessors.buffer.add(after.ravel())
    return again


def keep_copies(made: GLTF2, document: Document, renumbering: Renumbering, buffer: Buffer) -> tuple[str, ...]:
    """Keep the copies of meshes (EXT_mesh_gpu_instancing) whose node still has its mesh; returns notes."""
    accessors, lost = _Accessors(document, buffer), False
    for node in made.nodes:
        copies = (node.extensions or {}).get(INSTANCES)
        if copies is not None and (node.mesh is None or renumbering.is_joined):
            del node.extensions[INSTANCES]
            lost = True
        elif copies is not None:
            columns = copies.get("attributes") or {}
            copies["attributes"] = {name: accessors.copy(number) for name, number in columns.items()}
    return (f"Copies of meshes ({INSTANCES}) were left out, because the mesh was replaced.",) if lost else ()
