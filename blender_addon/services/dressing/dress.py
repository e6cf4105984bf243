# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress a target with copies of its source's clothes, hair, eyes and props, fitted along their match."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.messages import plural, sentences
from zoomout_core.outfits.joint_match import match_by_joints
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.transfer import fit_to_shape

from ... import mesh_data
from ...jobs import compute, pause, run
from ...mesh_data import ObjectPair, Worn
from ...scene.pair import check_not_edited, find_mesh, name_of, names_of
from ...scene.stored_pair import stored_pair
from ..matching.made_match import BY_SCRIPT, MatchUse, find_match, store_and_stop
from ..matching.pair_match import check_options
from ..targets import Write
from .fit import fit_worn, notes_on_hidden_skin, notes_on_stretch, rigged_bodies
from .missing_skin import complete_fitting
from .read import READING, Dressing, check_unchanged, read_fitting, read_worn_object
from .write import write_copies

# Fraction of the progress for a new match.
MATCHING = 0.6


def dress(
    context: Context,
    source: Object,
    target: Object,
    accessories: Iterable[Object],
    dressing: Dressing | None = None,
    *,
    force: bool = False,
    **match_options: Any,
) -> dict[str, Any]:
    """Dress a target with copies of a source's accessories, fitted to its body along their match or a new one.

    If both are bound to one armature, they are fitted in its rest pose, and the copies are bound to it, too. If the
    target has a different armature, they are bound to that, which receives the outfit's own bones. Otherwise the copies
    are children of the target in its present pose, and follow when it is bound to the source's armature. Copies
    from an earlier call are replaced, and the originals are not changed.

    Args:
        context: Blender's; all objects are in its scene.
        source: the body that wears the accessories.
        target: the body to dress; it is matched if necessary.
        accessories: meshes, and hair curves.
        dressing: how to dress the target.
        force: whether to use a new match even if it is probably wrong.
        match_options: options of `match_objects`, for a new match.

    Returns:
        A report: `source` and `target` are names, `objects` has the names of the copies by those of the objects,
        `left_out` has reasons for objects without copies, `verdict` is that of the match, or None, `notes` are
        sentences.

    Raises:
        MeshError: none of the objects can be copied; nothing was written.
        TypeError: an option of the match is unknown.
    """
    names = names_of(accessories)
    use = MatchUse(force=force)
    return run(
        prepare_dress(context, name_of(source), name_of(target), names, dressing or Dressing(), use, **match_options)
    )()


async def prepare_dress(
    context: Context,
    source_name: str,
    target_name: str,
    things: Sequence[str],
    dressing: Dressing,
    use: MatchUse = BY_SCRIPT,
    **match_options: Any,
) -> Write[dict[str, Any]]:
    """`dress` as a coroutine that keeps no Blender data across an `await`; returns a function that writes.

    Args:
        context: Blender's; the objects are in its scene.
        source_name: name of the source.
        target_name: name of the target.
        things: names of the worn objects.
        dressing: how to dress the target.
        use: how to use the match.
        match_options: options of `match_objects`.
    """
    check_options(match_options)
    pair = await stored_pair(context, source_name, target_name)
    left_out: dict[str, str] = {}
    fitting = await read_fitting(context, pair, things, dressing, left_out)
    found = await find_match(context, pair, MATCHING, use, match_options)
    verdict = None if isinstance(found.match, zo.ProximityMatch) else found.match.verdict
    by_joints, completed = None, await compute(partial(complete_fitting, fitting))
    if completed is not None:
        fitting, by_joints = completed
    elif verdict is not None:
        read = partial(rigged_bodies, fitting)
        by_joints = await compute(partial(match_by_joints, found.match.surface_map, verdict.level, read))
    if found.refused is not None and by_joints is None:
        return partial(store_and_stop, context, pair, found.refused, found.settings, use)
    used = found.match if by_joints is None else by_joints.surface_map
    with portion(found.done, 1):
        fit = await compute(partial(fit_worn, used, fitting, dressing))
    on_match: tuple[str, ...] = ()
    if by_joints is not None:
        verdict = by_joints.verdict
        on_match = verdict.sentence, verdict.advice

    def write() -> dict[str, Any]:
        check_not_edited(context, pair)
        check_unchanged(context, fitting.worn)
        with mesh_data.all_or_nothing(find_mesh(context, target_name)) as writing:
            found.store(find_mesh(context, target_name).data, pair)
            made, notes = write_copies(context, pair, fitting, fit, writing)
        own = find_mesh(context, target_name).data.shape_keys
        known = () if own is None else own.key_blocks.keys()
        notes += notes_on_hidden_skin(fit.hiding, source_name, target_name, known)
        return {
            "source": source_name,
            "target": target_name,
            "objects": made,
            "left_out": left_out,
            "verdict": None if verdict is None else verdict._asdict(),
            "notes": [
                *on_match,
                *fit.dressed.notes,
                *notes_on_stretch(fitting.worn, fit.dressed),
                *fitting.notes,
                *notes,
            ],
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
            worn.append(read_worn_object(context, copy.name, False, mesh_data.kept_group(copy)))
    if not worn:
        return lambda: None
    skin, shapes = pair.target.with_vertices(at_rest), [each.shape for each in worn]
    dressed = await compute(
        partial(fit_to_shape, pair.target, at_rest, skin, shapes, keep=[each.mask for each in worn])
    )

    def write() -> None:
        check_unchanged(context, worn)
        wearer = find_mesh(context, pair.target_name)
        with mesh_data.all_or_nothing(*(context.scene.objects[each.name] for each in worn)):
            for each, positions, turns in zip(worn, dressed.vertices, dressed.turns, strict=True):
                mesh_data.bind_worn_copy(context, each, positions, turns, wearer)

    return write


def summary(report: dict[str, Any]) -> str:
    """The report in one sentence."""
    done = plural(
        len(report["objects"]),
        "Dressed '{target}' with 1 object of '{source}'.",
        "Dressed '{target}' with {count} objects of '{source}'.",
        target=report["target"],
        source=report["source"],
    )
    return sentences(done, *report["left_out"].values(), *report["notes"])
