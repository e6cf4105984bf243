# SPDX-License-Identifier: GPL-3.0-or-later
"""Read the objects that a source wears, and the bodies and armatures for their fit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.messages import Message, warning
from zoomout_core.runtime.progress import stage
from zoomout_core.transfer import Manner
from zoomout_core.transfer.dressing.missing_skin import ClothedBody

from ... import mesh_data
from ...jobs import pause
from ...mesh_data import BodyKeys, ObjectPair, OutfitBones, Worn
from ...scene.pair import edit_error, find_mesh
from ..binding.check import check_in_scene
from ..binding.read import read_sources_at_rest
from .worn_weights import GroupWeights, read_group_weights

READING = "Reading the objects"


@dataclass(frozen=True)
class Dressing:
    """How a target is dressed.

    Attributes:
        manner: "automatic": small solid parts and children of bones rotate and scale as a whole, objects named like
            hair are hair, and all others follow the body. "soft": all follow the body. "rigid": none do. "hair": all
            follow it near the skin only, and move as a whole farther away.
        stiffness: how far objects that follow the body keep their form, in [0, 1].
        gap: minimum distance from the skin of points that were outside of it, in scene units.
        keep: name of a vertex group of the objects; its connected patches move as a whole, see `zoomout_core.dress`.
        follow_keys: whether shape keys of the target drive keys of the copies.
    """

    manner: Manner = "automatic"
    stiffness: float = 0.5
    gap: float = 0.0
    keep: str = ""
    follow_keys: bool = True


@dataclass(frozen=True, eq=False)
class Rigs:
    """The armatures of a source and of a target.

    Attributes:
        source: name of the source's armature.
        target: name of the target's.
        body: the bones that move the source.
        others: the bones that move the target.
        outfit: the bones that only move worn objects.
    """

    source: str
    target: str
    body: mesh_data.Bones
    others: mesh_data.Bones
    outfit: OutfitBones


@dataclass(frozen=True, eq=False)
class ActiveKeys:
    """The shape keys of a body that are in use.

    Attributes:
        surface: the body without shape keys, at rest, in world space.
        names: their names.
        offsets: (n, keys, 3) their offsets at their present values.
    """

    surface: zo.Surface
    names: tuple[str, ...]
    offsets: Floats


@dataclass(frozen=True, eq=False)
class Fitting:
    """The bodies and the worn objects to transfer.

    Attributes:
        source: the matched surface of the source, in the pose for the fitting.
        target: the same for the target.
        is_body: (n_s,) vertices of the source that are not worn themselves.
        worn: the worn objects.
        keys: the shape keys of the target that the copies follow; None if they follow none.
        rigs: the armatures of both, if they differ and the copies are to be bound to the target's.
        weights: the vertex groups of both and of the worn objects, if the copies are to be bound.
        bones: names of the bones that move the target.
        active_keys: the shape keys of the source's bodies that are in use.
        notes: sentences for the user.
        clothed: the source as a body whose missing skin is replaced by clothes; None if its skin is complete.
    """

    source: zo.Surface
    target: zo.Surface
    is_body: Booleans
    worn: list[Worn]
    keys: BodyKeys | None
    rigs: Rigs | None
    weights: GroupWeights | None
    bones: tuple[str, ...]
    active_keys: list[ActiveKeys]
    notes: list[Message]
    clothed: ClothedBody | None = None


async def read_fitting(
    context: Context, pair: ObjectPair, names: Sequence[str], dressing: Dressing, left_out: dict[str, str]
) -> Fitting:
    """Read the worn objects, in the rest pose if the target is bound to the source's armature.

    Args:
        context: Blender's.
        pair: the source and the target.
        names: the worn objects; the source and the target are ignored.
        dressing: how to dress the target.
        left_out: receives the reasons for objects that cannot be read, by name.

    Raises:
        MeshError: there are no worn objects, or none can be read.
    """
    chosen = [name for name in dict.fromkeys(names) if name not in (pair.source_name, pair.target_name)]
    if not chosen:
        raise zo.MeshError(
            "There is nothing to dress '{target}' with: select clothes, hair or other objects "
            "besides the source and the target, or choose their collection.",
            target=pair.target_name,
        )
    source, target = (find_mesh(context, name) for name in (pair.source_name, pair.target_name))
    rigs = _read_rigs(context, pair, chosen)
    bound_alike = bool(set(mesh_data.armatures_of(source)) & set(mesh_data.armatures_of(target)))
    at_rest = rigs is not None or bound_alike
    surface, onto = pair.source, pair.target
    if at_rest:
        surface = surface.with_vertices(read_sources_at_rest(context, pair))
        onto = onto.with_vertices(mesh_data.positions_in_world(target, mesh_data.read_rest_positions(target.data)))
    notes = [*_notes_on_armature(source, target, at_rest), *_notes_on_hair(context, pair)]
    worn = await _read_all(context, chosen, at_rest, dressing.keep, left_out)
    # Objects that were found before a pause may be gone.
    target = find_mesh(context, pair.target_name)
    notes += _notes_on_group(worn, dressing.keep)
    onto, keys, notes_on_keys = _keys_to_follow(target, onto, dressing.follow_keys, at_rest)
    notes += notes_on_keys
    weights = read_group_weights(context, pair, worn) if at_rest else None
    bones = mesh_data.read_bones(target).names
    worn_too = [name in chosen for name in pair.source_names]
    is_body = np.repeat(~np.array(worn_too), [len(each.vertices) for each in pair.sources])
    bodies = [find_mesh(context, name) for name in pair.source_names if name not in chosen]
    active = [found for body in bodies if (found := _read_active_keys(body)) is not None]
    return Fitting(surface, onto, is_body, worn, keys, rigs, weights, bones, active, notes)


def _notes_on_group(worn: Sequence[Worn], keep: str) -> list[Message]:
    """A warning if no object has the vertex group of the parts that keep their form."""
    if not keep or any(each.mask is not None for each in worn):
        return []
    return [
        warning(
            "None of the objects has a vertex group '{group}', so all of them follow the body: choose another one.",
            group=keep,
        )
    ]


def _keys_to_follow(
    target: Object, onto: zo.Surface, follow: bool, at_rest: bool
) -> tuple[zo.Surface, BodyKeys | None, list[Message]]:
    """The surface to fit copies to, the target's shape keys that they follow, if any, and notes.

    Args:
        target: the target.
        onto: its matched surface, in the pose for the fitting.
        follow: whether copies should follow its shape keys.
        at_rest: whether copies are fitted in the rest pose.
    """
    keys = mesh_data.read_body_keys(target)
    if keys is None:
        return onto, None, []
    if not follow:  # copies without keys fit the target with the present values of its keys
        return onto.with_vertices(onto.vertices + keys.at_rest) if at_rest else onto, None, []
    if at_rest or mesh_data.stands_as_modelled(target, onto.vertices - keys.displacement):
        return onto, keys, []
    note = warning(
        "The objects have no keys for the shape keys of '{target}', because it is deformed: undo the "
        "deformation, and dress it again.",
        target=target.name,
    )
    return onto, None, [note]


def _read_active_keys(body: Object) -> ActiveKeys | None:
    """The shape keys of a body that are in use; None if there are none."""
    keys = mesh_data.read_body_keys(body)
    if keys is None or not keys.values.any():
        return None
    surface = mesh_data.read_surface_at_rest(body, positions=mesh_data.read_rest_positions(body.data))
    surface = surface.with_vertices(mesh_data.positions_in_world(body, surface.vertices))
    active = np.flatnonzero(keys.values)
    names = tuple(keys.keys[number].name for number in active)
    return ActiveKeys(surface, names, keys.offsets[:, active] * keys.values[active, None])


def _notes_on_armature(source: Object, target: Object, at_rest: bool) -> list[Message]:
    """A warning if the source is bound to an armature, and the copies will not be bound."""
    if at_rest or not mesh_data.armatures_of(source):
        return []
    return [
        warning(
            "'{target}' is not bound to the armature of '{source}': bind it, so that these objects follow the bones.",
            target=target.name,
            source=source.name,
        )
    ]


def _notes_on_hair(context: Context, pair: ObjectPair) -> Iterator[Message]:
    """A warning for each source with particle hair, which is not copied."""
    for name in pair.source_names:
        if any(system.settings.type == "HAIR" for system in find_mesh(context, name).particle_systems):
            yield warning(
                "The particle hair of '{name}' was not copied: convert it to curves, and dress '{target}' with them.",
                name=name,
                target=pair.target_name,
            )


async def _read_all(
    context: Context, names: Sequence[str], at_rest: bool, keep: str, left_out: dict[str, str]
) -> list[Worn]:
    """Read worn objects; `left_out` receives the reasons for those that cannot be read."""
    worn = []
    with stage(READING, 0, 0):
        for name in names:
            await pause()
            try:
                worn.append(read_worn_object(context, name, at_rest, keep))
            except zo.MeshError as error:
                left_out[name] = str(error)
    if not worn:
        raise zo.MeshError(next(iter(left_out.values())))
    return worn


def _read_rigs(context: Context, pair: ObjectPair, worn: Sequence[str]) -> Rigs | None:
    """The armatures of the source and of the target, if both have different ones, and the target's may be changed.

    Raises:
        MeshError: the source's is not in the scene.
    """
    source, target = (find_mesh(context, name) for name in (pair.source_name, pair.target_name))
    of_source, of_target = mesh_data.armatures_of(source), mesh_data.armatures_of(target)
    if not of_source or not of_target or set(of_source) & set(of_target):
        return None
    if of_target[0].data.library is not None or of_target[0].name not in context.view_layer.objects:
        return None
    check_in_scene(context, source)
    bodies = [find_mesh(context, name) for name in pair.source_names if name not in worn]
    objects = [context.scene.objects[name] for name in worn if name in context.scene.objects]
    outfit = mesh_data.read_outfit_bones(of_source[0], of_target[0], bodies, objects)
    bones = mesh_data.read_bones(source).without(outfit.names)
    others = mesh_data.read_bones(target).without(outfit.names)
    return Rigs(of_source[0].name, of_target[0].name, bones, others, outfit)


def read_worn_object(context: Context, name: str, at_rest: bool, keep: str) -> Worn:
    """Read an object that can be copied.

    Raises:
        MeshError: it does not exist, is being edited, or has nothing to copy.
    """
    obj = context.scene.objects.get(name)
    if obj is None:
        raise zo.MeshError("There is no object '{name}' in the scene: choose another one.", name=name)
    if obj.mode == "EDIT" or (obj.type == "MESH" and obj.data.is_editmode):
        raise zo.MeshError("'{name}' is in Edit Mode: switch to Object Mode first.", name=name)
    return mesh_data.read_worn(obj, context.evaluated_depsgraph_get(), at_rest, keep)


def check_unchanged(context: Context, worn: Iterable[Worn]) -> None:
    """Raise a MeshError if a worn object was removed or edited since it was read."""
    for each in worn:
        obj = context.scene.objects.get(each.name)
        if obj is None or mesh_data.content_of(obj) != each.content:
            raise edit_error(each.name)
