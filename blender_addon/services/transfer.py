# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer data between two objects along their match, and store a report on the target."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.messages import as_message, enumeration, message
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.transfer import Blend

from ..adapters import (
    COLLECTORS,
    DATA,
    DEFAULT,
    USUAL_DATA,
    Adapter,
    Binding,
    Remarks,
    Settings,
    TransferJob,
    TransferRequest,
    transfer_all,
)
from ..adapters.shape_keys import ShapeKeyAdapter
from ..adapters.vertex_groups import WeightAdapter
from ..jobs import compute, pause, run
from ..mesh_data import ObjectPair
from ..scene.pair import (
    READING,
    evaluated_sources,
    name_of,
    target_mesh,
    users_of_mesh,
    writing,
)
from ..scene.stored_pair import stored_pair
from .binding.bind import Bound, prepare_binding
from .binding.check import check_binding
from .binding.write import hide_sources, keep_match, write_bound, write_posed_shape
from .dressing.dress import take_to_rest
from .matching.made_match import BY_SCRIPT, FoundMatch, MatchUse, find_match, push_match, store_and_stop
from .matching.pair_match import check_options
from .targets import Write
from .transfer_report import unused_settings, write_report

# Fraction of the progress for a new match.
MATCHING = 0.8
# Kinds that are written once a target is bound: keys belong to its rest pose and to its armature, and the source's
# shape to the place of the source.
AT_REST = ("shape_keys", "shape")


def transfer_objects(
    context: Context,
    source: Object,
    target: Object,
    data: Collection[str] = USUAL_DATA,
    settings: Settings = DEFAULT,
    binding: Binding | None = None,
    hide_source: bool = True,
    **match_options: Any,
) -> dict[str, Any]:
    """Transfer data between two mesh objects, along the match stored on the target, or a new one.

    Args:
        context: Blender's; both objects are in its scene.
        source: the object with the data; it is read after its modifiers.
        target: the object that receives the data.
        data: the kinds of data, of `DATA`; all but the source's own shape, when not given.
        settings: how to transfer the data.
        binding: how to bind the target to the source's armature; it is not bound when not given.
        hide_source: whether to hide the source in the viewport if the target is bound at its place, as the buttons do.
        match_options: options of `match_objects`, for a new match; with `force=True` data is transferred along it even
            if it is probably wrong.

    Returns:
        The report, see `stored_report.transfer_report`.

    Raises:
        MeshError: some data cannot be transferred; nothing was written. Or a new match is probably wrong; only the
            match was stored.
        TypeError: an option of the match is unknown.
    """
    report = run(transfer(context, name_of(source), name_of(target), data, settings, binding, **match_options))
    if hide_source:
        hide_sources(context, [report])
    return report


def bind_to_rig(
    context: Context,
    source: Object,
    target: Object,
    binding: Binding | None = None,
    settings: Settings = DEFAULT,
    hide_source: bool = True,
    **match_options: Any,
) -> dict[str, Any]:
    """Transfer the vertex groups, move the target to the rest pose, and bind it to the source's armature.

    The armature and its animation are not changed. A posed target gets a shape key with its original shape.

    Args:
        context: Blender's; both objects are in its scene.
        source: an object that an armature deforms.
        target: the object to bind; its vertices move to the rest pose, and it gets the source's matrix.
        binding: whether the target is at rest already, and whether to replace another binding; when not given, the pose
            is detected, and a bound target is rejected.
        settings: how to transfer weights.
        hide_source: whether to hide the source in the viewport, as the button does: the target is at its place then.
        match_options: options of `match_objects`, for a new match.

    Returns:
        The report, see `stored_report.transfer_report`.

    Raises:
        MeshError: the target cannot be bound; nothing was written.
        TypeError: an option of the match is unknown.
    """
    binding = binding or Binding()
    return transfer_objects(context, source, target, (), settings, binding, hide_source, **match_options)


def move_rig(
    context: Context,
    source: Object,
    target: Object,
    binding: Binding | None = None,
    settings: Settings = DEFAULT,
    **match_options: Any,
) -> dict[str, Any]:
    """Copy the source's armature into a target of another build, and bind the target to the copy.

    Bones move into the target's body, with rolls that follow its surface; constraints, drivers, custom shapes, bone
    collections and the action are copied. The target keeps its place and size, is moved to the rest pose if it is in
    another one, and gets the source's vertex groups.

    Args:
        context: Blender's; both objects are in its scene.
        source: an object that one armature deforms.
        target: the object that receives the rig.
        binding: whether the target is at rest already, and whether to replace another binding, as for `bind_to_rig`.
        settings: how to transfer weights.
        match_options: options of `match_objects`, for a new match.

    Returns:
        The report, see `stored_report.transfer_report`; `bound` has the name of the copy.

    Raises:
        MeshError: the armature cannot be moved, or the target cannot be bound; nothing was written.
        TypeError: an option of the match is unknown.
    """
    return bind_to_rig(context, source, target, replace(binding or Binding(), move_rig=True), settings, **match_options)


async def transfer(
    context: Context,
    source_name: str,
    target_name: str,
    data: Collection[str],
    settings: Settings = DEFAULT,
    binding: Binding | None = None,
    force: bool = False,
    **match_options: Any,
) -> dict[str, Any]:
    """`transfer_objects` as a coroutine, which keeps no Blender data across an `await`."""
    use = MatchUse(force=force)
    write = await prepare_transfer(context, source_name, target_name, data, settings, binding, use, **match_options)
    return write()


async def prepare_transfer(
    context: Context,
    source_name: str,
    target_name: str,
    data: Collection[str],
    settings: Settings = DEFAULT,
    binding: Binding | None = None,
    use: MatchUse = BY_SCRIPT,
    **match_options: Any,
) -> Write[dict[str, Any]]:
    """`transfer` without writing: returns a function that writes the data to the target.

    If the match is new and probably wrong, the function stores only the match, and raises a MeshError.

    Args:
        context: Blender's; both objects are in its scene.
        source_name: name of the source.
        target_name: name of the target.
        data: the kinds of data.
        settings: how to transfer it.
        binding: how to bind the target to the source's rig; None not to bind it.
        use: how to use the match.
        match_options: options of `match_objects`.
    """
    check_options(match_options)
    if binding is not None:
        check_binding(context, source_name, target_name, binding, settings)
        data = {*data, "vertex_groups"}
    pair = await stored_pair(context, source_name, target_name)
    adapters, remarks, blend = await _collect(context, pair, data, settings)
    # Those of a bound target are transferred once its pose is known.
    bound_later = [one for one in adapters if binding is not None and one.kind in ("vertex_groups", "shape_keys")]
    weights = next((one for one in bound_later if isinstance(one, WeightAdapter)), None)
    keys = next((one for one in bound_later if isinstance(one, ShapeKeyAdapter)), None)
    if binding is not None and weights is None:
        raise zo.MeshError("All bone vertex groups of '{target}' are locked: unlock them.", target=target_name)
    found = await find_match(context, pair, MATCHING, use, match_options)
    if found.refused is not None:
        return partial(store_and_stop, context, pair, found.refused, found.settings, use)
    if not found.is_new:
        remarks.notes.extend(unused_settings(found.settings, match_options))
    job = TransferJob(found.match, pair, remarks, settings, blend)
    others = [one for one in adapters if one not in bound_later]
    with portion(found.done, 1):
        if binding is None or weights is None:
            await compute(partial(transfer_all, others, job))
            return PreparedTransfer(context, found, adapters, job, use)
        bound = await prepare_binding(context, job, others, weights, keys, binding)
    remarks.notes.extend(bound.notes)
    bind_worn = await take_to_rest(context, pair, bound.rest.positions)
    return PreparedTransfer(context, found, adapters, job, use, bound, bind_worn)


@dataclass(frozen=True, eq=False)
class PreparedTransfer:
    """A computed transfer; a call writes it to the target, and returns the report.

    Attributes:
        context: Blender's.
        found: the match that the transfer follows.
        adapters: the data.
        job: the transfer, with remarks for the report.
        use: how the match is used.
        bound: the target at rest; None if it is not bound.
        bind_worn: binds copies that the target wears.
    """

    context: Context
    found: FoundMatch
    adapters: Sequence[Adapter]
    job: TransferJob
    use: MatchUse
    bound: Bound | None = None
    bind_worn: Write[None] = lambda: None

    def __call__(self) -> dict[str, Any]:
        context, pair, found, bound = self.context, self.job.pair, self.found, self.bound
        with writing(context, pair) as (_, target):
            found.store(target.data, pair)
            if found.is_new and self.use.undo_step:
                push_match()
            self._write_data(target, at_rest=False)
            if bound is not None:
                self.job.remarks.notes.extend(write_bound(context, pair, bound))
                self.bind_worn()
            self._write_data(target, at_rest=True)
            if bound is not None:
                write_posed_shape(target, bound)
            target.data.update()
            if bound is not None:
                keep_match(context, pair, bound.match, found.settings)
            return write_report(target, self.adapters, self.job, users_of_mesh(context, target), bound)

    def _write_data(self, target: Object, at_rest: bool) -> None:
        """Write the kinds of data that are written once the target is at rest, or the others."""
        for one in self.adapters:
            if (one.kind in AT_REST) == at_rest:
                one.write(target)


async def _collect(
    context: Context, pair: ObjectPair, data: Collection[str], settings: Settings
) -> tuple[list[Adapter], Remarks, Blend]:
    """Choose the source's data, check that the target can receive it, and determine the blend."""
    if isinstance(data, str) or not isinstance(data, Collection):
        raise TypeError(f"The data is {data!r:.60}: give a list of kinds, such as ['uv_maps'].")
    if not isinstance(settings, Settings):
        raise TypeError(f"The settings are {settings!r:.60}: give an object of the class Settings.")
    if unknown := set(data).difference(DATA):
        raise ValueError(f"There is no kind of data named {', '.join(sorted(unknown))}: choose from {', '.join(DATA)}.")
    adapters, remarks = list[Adapter](), Remarks()
    with target_mesh(context, pair) as (target, _):
        blend = settings.blend(target)
    with stage(READING, 0, 0):
        for collect in COLLECTORS:
            await pause()
            with evaluated_sources(context, pair) as (first, *others), target_mesh(context, pair) as (target, _):
                adapters += collect(TransferRequest(*first, target, data, settings, blend, others), remarks)
    if not adapters and remarks.skipped:
        reasons = (
            message("{name}: skipped, {reason}", name=name, reason=as_message(remarks.skipped[name]))
            for name in remarks.skipped
        )
        raise zo.MeshError("None of the data can be transferred. {reasons}.", reasons=enumeration(reasons, "; "))
    if not adapters:
        raise zo.MeshError("'{source}' has none of the data to transfer: choose other data.", source=pair.source_name)
    return adapters, remarks, blend
