"""Transfer data between two objects along their match, and store a report on the target."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.runtime.stepping import Steps, drain, within
from zoomout_core.transfer import Blend

from ..adapters import (
    COLLECTORS,
    DATA,
    DEFAULT,
    NOUNS,
    USUAL_DATA,
    Adapter,
    Remarks,
    Settings,
    TransferJob,
    TransferRequest,
    transfer_all_steps,
)
from ..mesh_data import ObjectPair
from ..properties.match import option_label
from ..scene.pair import (
    READING,
    check_unedited,
    evaluated_sources,
    find_mesh,
    target_mesh,
    users_of_mesh,
)
from ..scene.stored_pair import stored_pair_steps
from ..storage import stored_match, stored_report
from .candidates import store_match
from .constraints import check_options, matching_steps, settings_to_store
from .targets import Write

# Part of the progress bar that matching takes, where there is no match yet, in [0, 1].
MATCHING = 0.8


def transfer_objects(
    context: Context,
    source: Object,
    target: Object,
    data: Collection[str] = USUAL_DATA,
    settings: Settings = DEFAULT,
    **match_options: Any,
) -> dict[str, Any]:
    """Transfer data between two mesh objects, along the match stored on the target, or a new one.

    Args:
        context: Blender's; both objects are in its scene.
        source: has the data; read as its modifiers leave it.
        target: receives it.
        data: which kinds of it, of `DATA`; all but the source's own shape, when not given.
        settings: how it is transferred.
        match_options: of `match_objects`, where no match of these two is stored.

    Returns:
        The report, see `stored_report.transfer_report`.

    Raises:
        MeshError: something cannot be transferred; nothing was written.
        TypeError: a match has no option of a name.
    """
    return drain(transfer_steps(context, source.name, target.name, data, settings, **match_options))


def transfer_steps(
    context: Context,
    source_name: str,
    target_name: str,
    data: Collection[str],
    settings: Settings = DEFAULT,
    **match_options: Any,
) -> Steps[dict[str, Any]]:
    """`transfer_objects` as a generator, which holds no Blender data while it is suspended."""
    write = yield from prepare_transfer_steps(context, source_name, target_name, data, settings, **match_options)
    return write()


def prepare_transfer_steps(
    context: Context,
    source_name: str,
    target_name: str,
    data: Collection[str],
    settings: Settings = DEFAULT,
    **match_options: Any,
) -> Steps[Write[dict[str, Any]]]:
    """`transfer_steps` without the writing: returns a function that writes the data to the target."""
    check_options(match_options)
    pair = yield from stored_pair_steps(context, source_name, target_name)
    stored = stored_match.read(find_mesh(context, target_name).data, pair)
    adapters, remarks, blend = yield from _collected_steps(context, pair, data, settings)
    match: stored_match.Match
    if stored is None:
        made_with = settings_to_store(context, pair, match_options)
        match = yield from within(matching_steps(context, pair, **match_options), 0, MATCHING)
    else:
        match = stored
        remarks.notes.extend(_unused_settings(stored, match_options))
    job = TransferJob(match, pair, remarks, settings, blend)
    yield from within(transfer_all_steps(adapters, job), MATCHING if stored is None else 0, 1)

    def write() -> dict[str, Any]:
        _, target = check_unedited(context, pair)
        if stored is None:
            store_match(target.data, match, pair, made_with)
        for one in adapters:
            one.write(target)
        target.data.update()
        return _write_report(target, adapters, job, users_of_mesh(context, target))

    return write


def _unused_settings(stored: stored_match.StoredMatch, settings: dict[str, Any]) -> list[str]:
    """A sentence about settings that differ from those of the stored match, as far as these are known."""
    unused = [name for name, value in settings.items() if name not in stored.settings or stored.settings[name] != value]
    if not unused:
        return []
    labels = ", ".join(option_label(name) for name in unused)
    return [f"The match that was made before was used as it is: to use other settings ({labels}), match again."]


def _collected_steps(
    context: Context, pair: ObjectPair, data: Collection[str], settings: Settings
) -> Steps[tuple[list[Adapter], Remarks, Blend]]:
    """Choose from what the source has, and see that the target has room for it, and how it is blended with its own."""
    if unknown := set(data).difference(DATA):
        raise ValueError(f"There is no data called {', '.join(sorted(unknown))}: choose from {', '.join(DATA)}.")
    adapters, remarks = list[Adapter](), Remarks()
    with target_mesh(context, pair) as (target, _):
        blend = settings.blend(target)
    for collect in COLLECTORS:
        yield READING
        with evaluated_sources(context, pair) as (first, *others), target_mesh(context, pair) as (target, _):
            adapters += collect(TransferRequest(*first, target, data, settings, blend, others), remarks)
    if not adapters:
        raise zo.MeshError(f"'{pair.source_name}' has none of the data that is to be transferred: choose other data.")
    return adapters, remarks, blend


def _write_report(target: Object, adapters: list[Adapter], job: TransferJob, users: int) -> dict[str, Any]:
    match, pair, remarks = job.match, job.pair, job.remarks
    written: dict[str, list[str]] = {kind: [] for kind in DATA}
    for one in adapters:
        written[one.kind].extend(one.names)
    shared = f"The mesh '{target.data.name}' is shared by {users} objects, which all received the data."
    report = {
        "source": pair.source_name,
        "others": list(pair.source_names[1:]),
        "target": pair.target_name,
        "written": written,
        "skipped": remarks.skipped,
        "notes": [*match.notes, *remarks.notes, *([shared] if users > 1 else [])],
        "vertices": len(match.confidence),
        "low_confidence": stored_match.low_confidence(match.confidence),
        "without_partner": stored_match.without_partner(match),
    }
    stored_report.write(target, report)
    return report


def summary(report: dict[str, Any]) -> str:
    """The report in one sentence."""
    written = ", ".join(_count(len(names), NOUNS[kind]) for kind, names in report["written"].items() if names)
    skipped = f"; {len(report['skipped'])} skipped" if report["skipped"] else ""
    return (
        f"Transferred {written} from '{report['source']}'{and_others(report['others'])} to '{report['target']}'"
        f"{skipped}; "
        f"{report['low_confidence']} of {report['vertices']} vertices are of low confidence"
    )


def and_others(names: Sequence[str]) -> str:
    """What follows the name of a source where the target lies on others, too."""
    return f" and {_count(len(names), 'other')}" if names else ""


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
