# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a binding to the scene, and read it from reports of transfers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from bpy.types import Context, Object

from zoomout_core.messages import Message, message, warning

from ... import mesh_data
from ...adapters.key_drivers import notes_on_drivers
from ...mesh_data import ObjectPair
from ...scene.pair import find_mesh, fingerprint_target
from ...storage import stored_match
from .bind import POSED_SHAPE, Bound, MovedRig


def write_bound(context: Context, pair: ObjectPair, bound: Bound) -> list[Message]:
    """Bind the target, in `writing`, after its vertex groups were written, and before transferred shape keys are.

    Returns:
        Sentences for the user.
    """
    source, target = find_mesh(context, pair.source_name), find_mesh(context, pair.target_name)
    place, armature = mesh_data.place_beside(source, target), None
    if bound.rig is not None:
        place, original = bound.rig.motion @ place, context.scene.objects[bound.rig.armature]
        armature = mesh_data.copy_rig(context, original, target, bound.rig.bones, bound.rig.motion)
    read = [*mesh_data.armatures_of(target), *mesh_data.armatures_of(source)]
    mesh_data.unbind(target)
    mesh_data.reshape(target, bound.seen, bound.rest.positions, bound.rest.linear, place)
    mesh_data.bind_like(source, target)
    if armature is not None:
        mesh_data.bind_to_other(target, original, armature, {}, place)
    context.view_layer.update()
    notes = _redirect_drivers(target, read)
    if armature is None or bound.rig is None:
        return notes
    notes += note_on_bends(mesh_data.bends_at_rest(original, armature))
    return notes + _copy_metarig(context, armature, target, bound.rig.metarig)


def _copy_metarig(context: Context, rig: Object, target: Object, metarig: MovedRig | None) -> list[Message]:
    """Copy the metarig of a moved rig beside it; returns a sentence on how to use it."""
    if metarig is None:
        return []
    original = context.scene.objects[metarig.armature]
    made = mesh_data.copy_metarig(context, original, rig, target, metarig.bones, metarig.motion)
    return [
        message(
            "The metarig was moved, too: to rebuild the controls of '{rig}', select '{metarig}' and press Re-Generate "
            "Rig in the panel of Rigify.",
            rig=rig.name,
            metarig=made.name,
        )
    ]


def _redirect_drivers(target: Object, read: Iterable[Object]) -> list[Message]:
    """Make drivers of the target's own keys read its armature, if it has the bones that they read elsewhere.

    Args:
        target: the object, bound.
        read: armatures that they may read.
    """
    if target.data.shape_keys is None:
        return []
    own = mesh_data.armatures_of(target)
    blocks = {part: part for each in own for part in (each, each.data)}
    others = {block: other for each in read for block, other in mesh_data.partner_armatures(each, own[0]).items()}
    partners = mesh_data.Partners(blocks, if_present=others)
    return notes_on_drivers(mesh_data.redirect_drivers(target.data.shape_keys, partners), target)


def write_posed_shape(target: Object, bound: Bound) -> None:
    """Keep the original shape of a target that was moved to rest as a key, after all others were written."""
    if bound.shape == "rest_pose":
        mesh_data.write_shape(target, POSED_SHAPE, mesh_data.positions_in_object(target, bound.seen))


def note_on_bends(turned: Mapping[str, float]) -> list[Message]:
    """A warning about bones that do not fit the constraints of a moved rig."""
    if not turned:
        return []
    worst = max(turned, key=lambda name: turned[name])
    return [
        warning(
            "At rest, constraints rotate {count} deform bones of the copy, such as '{bone}' by {angle:.0f}°: in Edit "
            "Mode, move the control bones that no longer fit.",
            count=len(turned),
            bone=worst,
            angle=turned[worst],
        )
    ]


def is_at_source(report: Mapping[str, Any]) -> bool:
    """Whether a transfer bound the target, and moved it to the place of its source."""
    return bool(report["bound"]) and "moved" not in report["bound"]


def hide_sources(context: Context, reports: Iterable[Mapping[str, Any]]) -> None:
    """Hide the sources of targets that were bound at their place.

    Args:
        context: Blender's.
        reports: reports of transfers.
    """
    for report in reports:
        for name in (report["source"], *report["others"]) if is_at_source(report) else ():
            find_mesh(context, name).hide_set(True)


def keep_match(context: Context, pair: ObjectPair, match: stored_match.Match, settings: Mapping[str, Any]) -> None:
    """Store the match again for the reshaped mesh."""
    target = find_mesh(context, pair.target_name)
    now = replace(pair, target_fingerprint=fingerprint_target(context, target.name))
    stored_match.write(target.data, match, now, settings)
