# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress a target with copies of its source's clothes, hair, eyes and props, fitted along their match."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.messages import Message, message, sentences, warning
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.transfer import Dressed, Manner, Skeleton, carry, pair_bones, shape_of_source

from .. import mesh_data
from ..adapters.key_drivers import notes_on_drivers
from ..jobs import compute, pause, run
from ..mesh_data import BodyKeys, ObjectPair, OutfitBones, Worn
from ..scene.pair import check_not_edited, edit_error, find_mesh
from ..scene.stored_pair import stored_pair
from ..storage import stored_match
from .binding import read_sources_at_rest
from .constraints import check_options
from .matching.candidates import store_match
from .matching.made_match import CALL_WITH_FORCE, is_probably_wrong, make_match, store_and_stop
from .targets import Write
from .worn_weights import Change, GroupWeights, follow_groups, read_group_weights

# Fractions of the progress for a new match, and for giving the source the target's shape.
MATCHING, SHAPING = 0.6, 0.8
# Fraction of the progress for fitting the objects, before they follow keys.
FITTED = 0.9
READING = "Reading the objects"


@dataclass(frozen=True)
class Dressing:
    """How a target is dressed.

    Attributes:
        manner: "automatic": small solid parts and children of bones rotate and scale as a whole, and all others follow
            the body. "soft": all follow the body. "rigid": none do.
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
class _Rigs:
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
class _Fitting:
    """The bodies and the worn objects to transfer.

    Attributes:
        source: the matched surface of the source, in the pose for the fitting.
        target: likewise of the target.
        is_body: (n_s,) vertices of the source that are not worn themselves.
        worn: the worn objects.
        keys: the shape keys of the target that the copies follow; None for none.
        rigs: the armatures of both, if they differ and the copies are to be bound to the target's.
        weights: the vertex groups of both and of the worn objects, if the copies are to be bound to it.
        notes: sentences for the user.
    """

    source: zo.Surface
    target: zo.Surface
    is_body: np.ndarray
    worn: list[Worn]
    keys: BodyKeys | None
    rigs: _Rigs | None
    weights: GroupWeights | None
    notes: list[str]


@dataclass(frozen=True, eq=False)
class _Fit:
    """The fitted objects.

    Attributes:
        dressed: their shapes.
        moved: (4, 4) the motion of the body, as a similarity.
        keys: (n, keys, 3) offsets of each object that follow the target's keys; zero for those without shape keys.
        outfit: the outfit's own bones in their new places, if they are to be copied.
        pairs: names of the target's bones by those of the source's.
        weights: how the weights of each copy change; None where they stay.
    """

    dressed: Dressed
    moved: Floats
    keys: list[Floats]
    outfit: OutfitBones | None = None
    pairs: dict[str, str] = field(default_factory=dict)
    weights: list[Change | None] = field(default_factory=list)


def dress(
    context: Context,
    source: Object,
    target: Object,
    accessories: Iterable[Object],
    dressing: Dressing | None = None,
    **match_options: Any,
) -> dict[str, Any]:
    """Dress a target with copies of a source's accessories, fitted to its body along their match or a new one.

    If both are bound to one armature, they are fitted in its rest pose, and the copies are bound to it as well. If the
    target has an armature of its own, they are bound to that, which receives the outfit's own bones. Else the copies
    are children of the target in its present pose, and follow when it is bound to the source's armature.
    Earlier copies of the same objects are replaced; the objects themselves are not changed.

    Args:
        context: Blender's; all objects are in its scene.
        source: the body that wears the accessories.
        target: the body to dress; it is matched if necessary.
        accessories: meshes, and hair curves.
        dressing: how to dress the target.
        match_options: options of `match_objects`, for a new match; with `force=True` it is used even if it is
            probably wrong.

    Returns:
        A report: `source` and `target` are names, `objects` has the names of the copies by those of the objects,
        `left_out` has reasons for objects without copies, `verdict` is that of the match, or None, `notes` are
        sentences.

    Raises:
        MeshError: none of the objects can be copied; nothing was written.
        TypeError: an option of the match is unknown.
    """
    names = [obj.name for obj in accessories]
    return run(prepare_dress(context, source.name, target.name, names, dressing or Dressing(), **match_options))()


async def prepare_dress(
    context: Context,
    source_name: str,
    target_name: str,
    things: Sequence[str],
    dressing: Dressing,
    adjusted: bool = False,
    force: bool = False,
    remedy: str = CALL_WITH_FORCE,
    **match_options: Any,
) -> Write[dict[str, Any]]:
    """`dress` as a coroutine that keeps no Blender data across an `await`; returns a function that writes.

    Args:
        context: Blender's; the objects are in its scene.
        source_name: name of the source.
        target_name: name of the target.
        things: names of the worn objects.
        dressing: how to dress the target.
        adjusted: whether this repeats the last operation with other settings, and may reuse its undone match.
        force: whether to use a new match that is probably wrong; else only the match is stored.
        remedy: a sentence for the refusal of such a match: how to use it all the same.
        match_options: options of `match_objects`.
    """
    check_options(match_options)
    pair = await stored_pair(context, source_name, target_name)
    left_out: dict[str, str] = {}
    fitting = await _read_fitting(context, pair, things, dressing, left_out)
    stored = stored_match.read(find_mesh(context, target_name).data, pair)
    match: stored_match.Match
    begin = 0.0
    if stored is None:
        begin = MATCHING
        with portion(0, begin):
            match, made_with = await make_match(context, pair, adjusted, match_options)
        if not adjusted and not force and is_probably_wrong(match):
            return partial(store_and_stop, context, pair, match, made_with, remedy)
    else:
        match, made_with = stored, stored.settings
    with portion(begin, 1):
        fit = await compute(partial(_carry, match, fitting, dressing))

    def write() -> dict[str, Any]:
        check_not_edited(context, pair)
        check_unchanged(context, fitting.worn)
        with mesh_data.all_or_nothing(find_mesh(context, target_name)) as writing:
            if stored is None:
                store_match(find_mesh(context, target_name).data, match, pair, made_with)
            made, notes = _write(context, pair, fitting, fit, writing)
        return {
            "source": source_name,
            "target": target_name,
            "objects": made,
            "left_out": left_out,
            "verdict": stored_match.pack_verdict(match),
            "notes": [*fit.dressed.notes, *_notes_on_stretch(fitting.worn, fit.dressed), *fitting.notes, *notes],
        }

    return write


async def take_to_rest(context: Context, pair: ObjectPair, at_rest: Floats) -> Write[None]:
    """Fit copies that a target wears to its rest pose; returns a function that binds them like their originals.

    Args:
        context: Blender's.
        pair: the pair whose target is bound.
        at_rest: (n_t, 3) the rest positions of its vertices, in world space.
    """
    target, worn = find_mesh(context, pair.target_name), list[Worn]()
    with stage(READING, 0, 0):
        for copy in mesh_data.worn_copies(target):
            await pause()
            worn.append(_read(context, copy.name, False, mesh_data.kept_group(copy)))
    if not worn:
        return lambda: None
    skin, shapes = pair.target.with_vertices(at_rest), [each.shape for each in worn]
    dressed = await compute(partial(carry, pair.target, at_rest, skin, shapes, keep=[each.mask for each in worn]))

    def write() -> None:
        check_unchanged(context, worn)
        wearer = find_mesh(context, pair.target_name)
        with mesh_data.all_or_nothing(*(context.scene.objects[each.name] for each in worn)):
            for each, positions, turns in zip(worn, dressed.vertices, dressed.turns, strict=True):
                mesh_data.bind_worn_copy(context, each, positions, turns, wearer)

    return write


def summary(report: dict[str, Any]) -> str:
    """The report in one sentence."""
    done = message(
        "Dressed '{target}' with {count} objects of '{source}'.",
        target=report["target"],
        count=len(report["objects"]),
        source=report["source"],
    )
    return sentences(done, *report["left_out"].values(), *report["notes"])


def check_unchanged(context: Context, worn: Iterable[Worn]) -> None:
    """Raise a MeshError if a worn object was removed or edited since it was read."""
    for each in worn:
        obj = context.scene.objects.get(each.name)
        if obj is None or mesh_data.content_of(obj) != each.content:
            raise edit_error(each.name)


def _read_rigs(context: Context, pair: ObjectPair, worn: Sequence[str]) -> _Rigs | None:
    """The armatures of the source and of the target, if both have one of their own, and it may be changed."""
    source, target = (find_mesh(context, name) for name in (pair.source_name, pair.target_name))
    of_source, of_target = mesh_data.armatures_of(source), mesh_data.armatures_of(target)
    if not of_source or not of_target or set(of_source) & set(of_target):
        return None
    if of_target[0].data.library is not None or of_target[0].name not in context.view_layer.objects:
        return None
    bodies = [find_mesh(context, name) for name in pair.source_names if name not in worn]
    objects = [context.scene.objects[name] for name in worn if name in context.scene.objects]
    outfit = mesh_data.read_outfit_bones(of_source[0], of_target[0], bodies, objects)
    bones = mesh_data.read_bones(source).without(outfit.names)
    others = mesh_data.read_bones(target).without(outfit.names)
    return _Rigs(of_source[0].name, of_target[0].name, bones, others, outfit)


async def _read_fitting(
    context: Context, pair: ObjectPair, names: Sequence[str], dressing: Dressing, left_out: dict[str, str]
) -> _Fitting:
    """Read the worn objects, in the rest pose if the target is bound to the source's armature.

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
    armatures = set(mesh_data.armatures_of(source))
    rigs = _read_rigs(context, pair, chosen)
    at_rest = rigs is not None or bool(armatures & set(mesh_data.armatures_of(target)))
    surface, onto, notes = pair.source, pair.target, list[str]()
    if at_rest:
        surface = surface.with_vertices(read_sources_at_rest(context, pair))
        onto = onto.with_vertices(mesh_data.positions_in_world(target, mesh_data.read_rest_positions(target.data)))
    elif armatures:
        notes.append(
            warning(
                "'{target}' is not bound to the armature of '{source}': bind it, so that these objects "
                "follow the bones.",
                target=target.name,
                source=source.name,
            )
        )
    notes.extend(
        warning(
            "The particle hair of '{name}' was not copied: convert it to curves, and dress '{target}' with them.",
            name=each.name,
            target=target.name,
        )
        for each in (find_mesh(context, name) for name in pair.source_names)
        if any(system.settings.type == "HAIR" for system in each.particle_systems)
    )
    worn = []
    with stage(READING, 0, 0):
        for name in chosen:
            await pause()
            try:
                worn.append(_read(context, name, at_rest, dressing.keep))
            except zo.MeshError as error:
                left_out[name] = str(error)
    if not worn:
        raise zo.MeshError(next(iter(left_out.values())))
    if dressing.keep and all(each.mask is None for each in worn):
        notes.append(
            warning(
                "None of the objects has a vertex group '{group}', so all of them follow the body: choose another one.",
                group=dressing.keep,
            )
        )
    keys = mesh_data.read_body_keys(target) if dressing.follow_keys else None
    if keys is not None and not at_rest and not mesh_data.stands_as_modelled(target, onto.vertices - keys.displacement):
        keys = None
        notes.append(
            warning(
                "The objects have no keys for the shape keys of '{target}', because it is deformed: undo the "
                "deformation, and dress it again.",
                target=target.name,
            )
        )
    weights = None if rigs is None else read_group_weights(context, pair, worn)
    worn_too = [name in chosen for name in pair.source_names]
    is_body = np.repeat(~np.array(worn_too), [len(each.vertices) for each in pair.sources])
    return _Fitting(surface, onto, is_body, worn, keys, rigs, weights, notes)


def _read(context: Context, name: str, at_rest: bool, keep: str) -> Worn:
    obj = context.scene.objects.get(name)
    if obj is None:
        raise zo.MeshError("There is no object '{name}' in the scene: choose another one.", name=name)
    if obj.mode == "EDIT" or (obj.type == "MESH" and obj.data.is_editmode):
        raise zo.MeshError("'{name}' is in Edit Mode: switch to Object Mode first.", name=name)
    return mesh_data.read_worn(obj, context.evaluated_depsgraph_get(), at_rest, keep)


def _carry(match: stored_match.Match, fitting: _Fitting, dressing: Dressing) -> _Fit:
    """Fit the worn objects, and let them follow the target's keys."""
    with portion(0, SHAPING):
        shape = shape_of_source(match, fitting.source, fitting.target)
    body, shape = _part(fitting.source, shape, fitting.is_body)
    manners: list[Manner] = [
        "rigid" if each.hangs_from_bone and dressing.manner == "automatic" else dressing.manner for each in fitting.worn
    ]
    with portion(SHAPING, FITTED):
        dressed = carry(
            body,
            shape,
            fitting.target,
            [each.shape for each in fitting.worn],
            manners=manners,
            keep=[each.mask for each in fitting.worn],
            stiffness=dressing.stiffness,
            gap=dressing.gap,
        )
    motion, moved = procrustes(body.vertices, shape), np.eye(4)
    moved[:3, :3], moved[:3, 3] = motion.linear, motion.translation
    fit = _Fit(dressed, moved, [])
    if fitting.rigs is not None and fitting.weights is not None:
        fit = _move_bones(fit, fitting, fitting.rigs, body, shape)
        fit = _follow_weights(fit, fitting, fitting.rigs, fitting.weights, body)
    if fitting.keys is None:
        return fit
    with portion(FITTED, 1):
        keys = _follow_keys(fitting, fitting.keys, dressed)
    if not fitting.worn[0].at_rest:  # then the target's keys have their present values
        still = [np.einsum("nkx,k->nx", each, fitting.keys.values) for each in keys]
        vertices = tuple(points - off for points, off in zip(dressed.vertices, still, strict=True))
        dressed = replace(dressed, vertices=vertices)
    return replace(fit, dressed=dressed, keys=keys)


def _move_bones(fit: _Fit, fitting: _Fitting, rigs: _Rigs, body: zo.Surface, shape: Floats) -> _Fit:
    """Move the outfit's own bones along with the objects, and find the counterparts of all others."""
    outfit = rigs.outfit
    ends, upright = outfit.ends.copy(), outfit.upright.copy()
    for number, worn in enumerate(fitting.worn):
        own = np.flatnonzero([name == worn.name for name in outfit.wearer])
        joints = zo.move_joints(worn.shape, fit.dressed.vertices[number], outfit.ends[own].reshape(-1, 3))
        ends[own] = joints.positions.reshape(-1, 2, 3)
        upright[own] = np.einsum("bxy,by->bx", joints.rotations[::2], outfit.upright[own])
    size = float(np.ptp(fitting.target.vertices, axis=0).max())
    heads = zo.move_joints(body, shape, rigs.body.heads).positions
    bones = Skeleton(rigs.body.names, rigs.body.parents, heads)
    pairs = pair_bones(bones, Skeleton(rigs.others.names, rigs.others.parents, rigs.others.heads), size)
    return replace(fit, outfit=replace(outfit, ends=ends, upright=upright), pairs=pairs)


def _follow_weights(fit: _Fit, fitting: _Fitting, rigs: _Rigs, weights: GroupWeights, body: zo.Surface) -> _Fit:
    """Change the weights of the copies as those of the body below them change."""
    whole = len(body.vertices) == len(fitting.source.vertices)
    changes = follow_groups(
        weights,
        {name: fit.pairs.get(name, name) for name in rigs.body.names},
        rigs.outfit.names,
        rigs.others.names,
        (body, np.ones_like(fitting.is_body) if whole else fitting.is_body),
        fitting.target,
        fitting.worn,
        fit.dressed.vertices,
    )
    return replace(fit, weights=changes)


def _follow_keys(fitting: _Fitting, keys: BodyKeys, dressed: Dressed) -> list[Floats]:
    """(n, keys, 3) offsets of each fitted object that follow the target's keys, zero without shape keys."""
    offsets = [np.zeros((len(points), len(keys.keys), 3)) for points in dressed.vertices]
    taking = [number for number, worn in enumerate(fitting.worn) if worn.takes_keys]
    shapes = [_in_shape(fitting.worn[number].shape, dressed.vertices[number]) for number in taking]
    masks = [fitting.worn[number].mask for number in taking]
    followed = zo.follow_keys(fitting.target, keys.offsets, shapes, keep=masks)
    for number, found in zip(taking, followed, strict=True):
        offsets[number] = found
    return offsets


def _in_shape(shape: zo.Surface | zo.Lines, vertices: Floats) -> zo.Surface | zo.Lines:
    """The same object with other vertices (n, 3)."""
    return zo.Lines(vertices, shape.edges) if isinstance(shape, zo.Lines) else shape.with_vertices(vertices)


def _notes_on_stretch(worn: Sequence[Worn], dressed: Dressed) -> list[str]:
    """A sentence for each copy that is stretched somewhere."""
    return [
        warning(
            "{count:,} vertices of '{name}' are stretched far more than the body, as where limbs touch: check these.",
            count=int(stretched.sum()),
            name=each.name,
        )
        for each, stretched in zip(worn, dressed.stretched, strict=True)
        if stretched.any()
    ]


def _part(surface: zo.Surface, shape: Floats, kept: np.ndarray) -> tuple[zo.Surface, Floats]:
    """The part of a surface with vertices `kept` (n,), if it has triangles, and its vertices in the new shape."""
    triangles = surface.triangles[kept[surface.triangles].all(axis=1)]
    if kept.all() or not len(triangles):
        return surface, shape
    number = np.cumsum(kept) - 1
    return zo.Surface(surface.vertices[kept], number[triangles]), shape[kept]


def _write(
    context: Context,
    pair: ObjectPair,
    fitting: _Fitting,
    fit: _Fit,
    writing: mesh_data.Writing,
) -> tuple[dict[str, str], list[str]]:
    """Add the copies; returns their names by those of the originals, and notes."""
    target = find_mesh(context, pair.target_name)
    bodies = [find_mesh(context, name) for name in pair.source_names]
    collection = mesh_data.collection_beside(context, target, mesh_data.dress_name(target.name))
    made, notes = {}, []
    for number, worn in enumerate(fitting.worn):
        positions, turns = fit.dressed.vertices[number], fit.dressed.turns[number]
        obj = context.scene.objects[worn.name]
        for earlier in mesh_data.worn_copies_in(collection, worn.name):
            writing.replace(earlier, earlier.data)
        copy, more = mesh_data.add_worn_copy(worn, obj, positions, turns, target, bodies, collection, fit.moved)
        if copy.type == "CURVES":
            mesh_data.attach_strands(copy, target, fitting.target, positions)
        elif fitting.keys is not None:
            keys = fitting.keys.keys
            mesh_data.write_body_keys(copy, target, keys, fit.keys[number], worn.place(fit.moved))
        if fitting.rigs is not None:
            source_rig, target_rig = (
                context.scene.objects[name] for name in (fitting.rigs.source, fitting.rigs.target)
            )
            mesh_data.bind_to_other(copy, source_rig, target_rig, fit.pairs, worn.place(fit.moved))
            change = fit.weights[number]
            if change is not None:
                mesh_data.update_weights(copy, *change)
        made[worn.name] = copy.name
        notes.extend(more)
    context.view_layer.update()
    if fitting.rigs is not None and fit.outfit is not None:
        mesh_data.add_outfit_bones(context, *_armatures(context, fitting.rigs), fit.outfit, fit.pairs)
        notes.extend(_notes_on_bones(fit.outfit, fit.pairs, fitting.rigs.target))
    for name, copy in made.items():
        notes.extend(_redirect_drivers(context, name, copy, target, bodies, fitting, fit))
    return made, notes


def _redirect_drivers(
    context: Context, original: str, made: str, target: Object, bodies: Sequence[Object], fitting: _Fitting, fit: _Fit
) -> list[Message]:
    """Let drivers of a copy's own keys read the target, its keys and its armature; returns notes."""
    obj, copy = (context.scene.objects[name] for name in (original, made))
    if copy.type != "MESH" or copy.data.shape_keys is None:
        return []
    keys, blocks = target.data.shape_keys, dict[Any, Any]()
    if keys is not None:
        blocks |= dict.fromkeys((keys, *(each.data.shape_keys for each in bodies if each.data.shape_keys)), keys)
    if obj.data.shape_keys is not None:
        blocks[obj.data.shape_keys] = copy.data.shape_keys
    blocks |= {part: part for body in bodies for each in mesh_data.armatures_of(body) for part in (each, each.data)}
    bones = None
    if fitting.rigs is not None and fit.outfit is not None:
        blocks |= mesh_data.counterpart_armatures(*_armatures(context, fitting.rigs))
        bones = {name: name for name in fit.outfit.names} | fit.pairs
    read = mesh_data.Counterparts(blocks, bones, dict.fromkeys(bodies, target) | {obj: copy})
    return list(notes_on_drivers(mesh_data.redirect_drivers(copy.data.shape_keys, read), copy))


def _armatures(context: Context, rigs: _Rigs) -> tuple[Object, Object]:
    """The source's and the target's armature."""
    return context.scene.objects[rigs.source], context.scene.objects[rigs.target]


def _notes_on_bones(outfit: OutfitBones, pairs: dict[str, str], armature: str) -> Iterator[str]:
    """Sentences on the armature that the copies were bound to."""
    yield message(
        "The objects are bound to '{armature}', to which {count} bones of their own were added.",
        armature=armature,
        count=len(outfit.names),
    )
    missing = [name for name in outfit.of_body if name not in pairs]
    if missing:
        yield warning(
            "{count} bones that move the objects have no counterpart in '{armature}', such as '{bone}': assign their "
            "weights to other bones.",
            count=len(missing),
            armature=armature,
            bone=missing[0],
        )
