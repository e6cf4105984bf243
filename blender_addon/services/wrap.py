# SPDX-License-Identifier: GPL-3.0-or-later
"""Wrap one mesh onto another: give its topology the other's shape, along their match."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.messages import message, sentences, warning
from zoomout_core.runtime.progress import portion
from zoomout_core.transfer import reverse_match

from .. import mesh_data
from ..adapters import Settings, check_takes_keys
from ..jobs import compute, run
from ..mesh_data import ObjectPair
from ..scene.landmarks import LandmarkPairs, landmark_pairs
from ..scene.pair import check_writable, find_mesh, fingerprint_source, fingerprint_target, name_of, writing
from ..scene.stored_pair import stored_pair
from ..storage import stored_match
from .matching import previews
from .matching.made_match import BY_SCRIPT, MatchUse, find_match, store_and_stop
from .matching.pair_match import check_options
from .targets import Write

# Fractions of the progress for a new match, and for reversing a match.
MATCHING, TURNING_ROUND = 0.8, 0.5


@dataclass(frozen=True)
class Wrapping:
    """How a mesh is wrapped.

    Attributes:
        result: where to write the shape: a shape key, the mesh itself, or a new object.
        reverse: whether to wrap the source onto the target, instead of the target onto the source.
        smoothness: how evenly edges flow, in [0, 1].
        detail: how far to follow the detail of the shape, in [0, 1].
        mask: the vertex group of the wrapped object that may change; empty for all of it.
        landmarks: whether to meet the landmarks that both objects have.
        subdivided: whether to fit the subdivided surface of a Subdivision modifier to the shape, instead of its cage.
    """

    result: Literal["shape_key", "mesh", "object"] = "shape_key"
    reverse: bool = False
    smoothness: float = 0.5
    detail: float = 1.0
    mask: str = ""
    landmarks: bool = True
    subdivided: bool = True


@dataclass(frozen=True, eq=False)
class _Given:
    """The input of a wrap.

    Attributes:
        wrapped: name of the object to wrap.
        shape: name of the object whose shape it gets.
        rest: surface of the object to wrap, before the wrap.
        onto: surface of the other object.
        mask: (n,) how far vertices are wrapped; None for all.
        landmarks: the landmarks of both objects.
        is_cage: whether to fit the subdivision surface of the wrapped object.
    """

    wrapped: str
    shape: str
    rest: zo.Surface
    onto: zo.Surface
    mask: Floats | None
    landmarks: LandmarkPairs | None
    is_cage: bool


def wrap(
    context: Context,
    source: Object,
    target: Object,
    wrapping: Wrapping | None = None,
    *,
    force: bool = False,
    **match_options: Any,
) -> dict[str, Any]:
    """Give the target's topology the source's shape, or vice versa, along their match or a new one.

    Args:
        context: Blender's; both objects are in its scene.
        source: the source; it is read after its modifiers.
        target: the target; it is matched if necessary.
        wrapping: how to wrap; a shape key of the target with the source's shape, when not given.
        force: whether to use a new match even if it is probably wrong.
        match_options: options of `match_objects`, for a new match.

    Returns:
        A report: `wrapped` is the name of the wrapped object, `shape` of the one whose shape it gets; `object` and
        `key` name where the shape was written; `turned_over` is the number of folded triangles; `verdict` is that of
        the match, or None; `notes` are sentences.

    Raises:
        MeshError: an object cannot be wrapped; nothing was written.
        TypeError: an option of the match is unknown.
    """
    use = MatchUse(force=force)
    return run(prepare_wrap(context, name_of(source), name_of(target), wrapping or Wrapping(), use, **match_options))()


async def prepare_wrap(
    context: Context,
    source_name: str,
    target_name: str,
    wrapping: Wrapping,
    use: MatchUse = BY_SCRIPT,
    **match_options: Any,
) -> Write[dict[str, Any]]:
    """`wrap` as a coroutine that keeps no Blender data across an `await`; returns a function that writes.

    Args:
        context: Blender's; both objects are in its scene.
        source_name: name of the source.
        target_name: name of the target.
        wrapping: how to wrap.
        use: how to use the match.
        match_options: options of `match_objects`.
    """
    check_options(match_options)
    pair = await stored_pair(context, source_name, target_name)
    given = _prepare(context, pair, wrapping)
    found = await find_match(context, pair, MATCHING, use, match_options)
    if found.refused is not None:
        return partial(store_and_stop, context, pair, found.refused, found.settings, use)
    with portion(found.done, 1):
        wrapped = await compute(partial(_wrap, found.match, pair, given, wrapping))
    notes = [*wrapped.notes, *(given.landmarks.notes if given.landmarks else ())]

    def write() -> dict[str, Any]:
        with writing(context, pair, find_mesh(context, given.wrapped)) as (_, target):
            found.store(target.data, pair)
            obj, key, more = _write(context, given, wrapping, wrapped.vertices)
            if wrapping.result != "shape_key":
                _keep_match(context, pair, found.match, found.settings, obj, wrapping)
        if obj.name == target_name:
            previews.follow_match(context, obj)
        return {
            "wrapped": given.wrapped,
            "shape": given.shape,
            "object": obj.name,
            "key": key,
            "turned_over": wrapped.turned_over,
            "verdict": stored_match.pack_verdict(found.match),
            "notes": [*notes, *more],
        }

    return write


def check_one_target(wrapping: Wrapping, targets: Collection[str]) -> None:
    """Raise a MeshError if there are several targets to wrap the source onto."""
    if wrapping.reverse and len(targets) > 1:
        raise zo.MeshError("The source can be wrapped onto only one target at a time: select a single target.")


def summary(report: dict[str, Any]) -> str:
    """The report in one sentence."""
    if report["key"]:
        where = message("key '{key}'", key=report["key"])
    elif report["object"] == report["wrapped"]:
        where = message("the mesh itself")
    else:
        where = message("new object '{object}'", object=report["object"])
    done = message(
        "Wrapped '{wrapped}' onto '{shape}' ({where}).", wrapped=report["wrapped"], shape=report["shape"], where=where
    )
    return sentences(done, *report["notes"])


def _prepare(context: Context, pair: ObjectPair, wrapping: Wrapping) -> _Given:
    """Collect and check the input of a wrap.

    Raises:
        MeshError: the wrapped object is not writable, its modifiers change its topology, or it lacks the mask.
    """
    source, target = (find_mesh(context, name) for name in (pair.source_name, pair.target_name))
    obj, other = (source, target) if wrapping.reverse else (target, source)
    seen, onto = (pair.source, pair.target) if wrapping.reverse else (pair.target, pair.source)
    if wrapping.reverse:
        _check_reverse(context, pair, source)
    if wrapping.result != "object" and mesh_data.is_flat(obj):
        raise zo.MeshError("'{name}' has a scale of zero and cannot be reshaped: change its scale.", name=obj.name)
    if wrapping.result == "shape_key":
        check_takes_keys(obj, [other.name])
    rest = _without_key(obj, other.name, seen)
    mask = Settings(mask_group=wrapping.mask).blend(obj).mask
    if mask is not None and not np.any(mask):
        raise zo.MeshError(
            "The vertex group '{group}' of '{name}' is empty: choose another mask.", group=wrapping.mask, name=obj.name
        )
    landmarks = _landmarks(context, source, target, wrapping, seen, rest) if wrapping.landmarks else None
    is_cage = wrapping.subdivided and mesh_data.is_cage(obj)
    return _Given(obj.name, other.name, rest, onto, None if mask is None else np.asarray(mask), landmarks, is_cage)


def _check_reverse(context: Context, pair: ObjectPair, source: Object) -> None:
    """Raise a MeshError if a source cannot be wrapped onto its target."""
    if len(pair.sources) > 1:
        raise zo.MeshError(
            "'{target}' corresponds to {count} objects, which cannot be wrapped onto it together: turn Reverse off.",
            target=pair.target_name,
            count=len(pair.sources),
        )
    check_writable(source)
    seen = mesh_data.read_source_faces(source, context.evaluated_depsgraph_get())
    if seen != mesh_data.read_faces(source.data):
        raise zo.MeshError(
            "'{source}' cannot be wrapped, because its modifiers change its faces: disable or apply "
            "those that add or remove vertices, and match again.",
            source=source.name,
        )


def _without_key(obj: Object, name: str, seen: zo.Surface) -> zo.Surface:
    """The surface of an object without the effect of its key of some name, from an earlier wrap."""
    keys = obj.data.shape_keys
    block = keys.key_blocks.get(name) if keys else None
    if block is None or block.mute or not block.value:
        return seen
    base = mesh_data.read_key_positions(obj.data, block.relative_key.name)
    moved = block.value * (mesh_data.read_key_positions(obj.data, name) - base)
    return seen.with_vertices(seen.vertices - mesh_data.directions_in_world(obj, moved))


def _landmarks(
    context: Context, source: Object, target: Object, wrapping: Wrapping, seen: zo.Surface, rest: zo.Surface
) -> LandmarkPairs:
    """The landmarks of both objects, moved from the surface `seen` of the wrapped one to `rest`."""
    pairs = landmark_pairs(context, source, target)
    points = pairs.source if wrapping.reverse else pairs.target
    if rest is seen or not len(points):
        return pairs
    triangle, barycentric = closest_points(points, seen.vertices, seen.triangles)
    moved = np.einsum("mc,mcx->mx", barycentric, rest.vertices[rest.triangles[triangle]])
    return replace(pairs, source=moved) if wrapping.reverse else replace(pairs, target=moved)


def _wrap(match: stored_match.Match, pair: ObjectPair, given: _Given, wrapping: Wrapping) -> zo.Wrapped:
    landmarks = None
    if given.landmarks is not None and given.landmarks.numbers:
        landmarks = given.landmarks.source, given.landmarks.target
    options: dict[str, Any] = {"smoothness": wrapping.smoothness, "detail": wrapping.detail, "mask": given.mask}
    options["subdivided"] = given.is_cage
    if not wrapping.reverse:
        return zo.wrap(match, given.onto, given.rest, landmarks=landmarks, **options)
    with portion(0, TURNING_ROUND):
        turned = reverse_match(match, pair.source, pair.target)
    landmarks = None if landmarks is None else landmarks[::-1]
    with portion(TURNING_ROUND, 1):
        return zo.wrap(turned, given.onto, given.rest, landmarks=landmarks, **options)


def _write(
    context: Context, given: _Given, wrapping: Wrapping, vertices: Floats
) -> tuple[Object, str, tuple[str, ...]]:
    """Write a shape (n, 3) in world space; returns the object with it, the name of its key, and notes."""
    obj, other = find_mesh(context, given.wrapped), find_mesh(context, given.shape)
    place = mesh_data.origin(other)
    if wrapping.result == "object":
        name = f"{obj.name} on {other.name}"
        return mesh_data.add_shaped_copy(context, obj, name, vertices, place), "", ()
    shape = mesh_data.to_object(obj, vertices - place)
    notes: tuple[str, ...] = ()
    shown = [modifier for modifier in obj.modifiers if modifier.show_viewport]
    if len(shown) > given.is_cage:
        notes = (warning("The modifiers of '{name}' also deform its new shape.", name=obj.name),)
    if wrapping.result == "mesh":
        mesh_data.move_vertices(obj.data, shape - mesh_data.read_rest_positions(obj.data))
        obj.data.update()
        return obj, "", notes
    mesh_data.write_shape(obj, other.name, shape)
    obj.data.shape_keys.key_blocks[other.name].value = 1
    obj.data.update()
    return obj, other.name, notes


def _keep_match(
    context: Context,
    pair: ObjectPair,
    match: stored_match.Match,
    settings: Mapping[str, Any],
    obj: Object,
    wrapping: Wrapping,
) -> None:
    """Store the match again for the reshaped object, unless the result is a new object made from the source."""
    if wrapping.result == "object" and wrapping.reverse:
        return
    if wrapping.reverse:
        at_base = pair.source_fingerprints[0].at_base
        now = replace(pair, source_fingerprints=(fingerprint_source(context, obj.name, at_base),))
        obj = find_mesh(context, pair.target_name)
    else:
        now = replace(pair, target_fingerprint=fingerprint_target(context, obj.name))
    stored_match.write(obj.data, match, now, settings)
