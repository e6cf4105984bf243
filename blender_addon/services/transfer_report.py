# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of a transfer, which is stored on the target, and its summary in a sentence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bpy.types import Object

from zoomout_core.matching import report as match_report
from zoomout_core.messages import as_message, enumeration, message, plural, warning

from ..adapters import DATA, NOUNS
from ..properties.match import option_label
from ..storage import stored_match, stored_report
from . import binding

if TYPE_CHECKING:
    from ..adapters import Adapter, TransferJob


def write_report(
    target: Object, adapters: Sequence[Adapter], job: TransferJob, users: int, bound: binding.bind.Bound | None
) -> dict[str, Any]:
    """Store the report of a transfer on its target, whose mesh several objects (`users`) may share; returns it."""
    match, pair, remarks = job.match, job.pair, job.remarks
    written: dict[str, list[str]] = {kind: [] for kind in DATA}
    for one in adapters:
        written[one.kind].extend(one.names)
    shared = warning(
        "The mesh '{mesh}' is shared by {users} objects, which all received the data.",
        mesh=target.data.name,
        users=users,
    )
    report = {
        "source": pair.source_name,
        "others": list(pair.source_names[1:]),
        "target": pair.target_name,
        "written": written,
        "skipped": remarks.skipped,
        "notes": [
            *match_report.part_report.without_shares(match.notes),
            *remarks.notes,
            *([shared] if users > 1 else []),
        ],
        "vertices": len(match.confidence),
        "low_confidence": stored_match.low_confidence(match.confidence),
        "without_partner": stored_match.without_partner(match),
        "verdict": stored_match.pack_verdict(match),
        "stretched": None if bound is None else stored_match.pack_mask(bound.stretched),
        "bound": None if bound is None else _binding_in_report(target, bound),
    }
    stored_report.write(target, report)
    return report


def _binding_in_report(target: Object, bound: binding.bind.Bound) -> dict[str, Any]:
    """The armature of a bound target for reports, and whether it is a copy that was moved into it."""
    moved = {"moved": True} if bound.rig is not None else {}
    return {"armature": target.parent.name, "shape": bound.shape} | moved


def summary(report: dict[str, Any]) -> str:
    """The report in one sentence."""
    known = [(NOUNS[kind], names) for kind, names in report["written"].items() if names and kind in NOUNS]
    written = enumeration(plural(len(names), *nouns) for nouns, names in known)
    bound = report.get("bound")  # missing in reports of earlier versions
    bound = message(", bound to '{armature}'", armature=bound["armature"]) if bound else ""
    others = and_others(report["others"])
    done = message(
        "Transferred {written} from '{source}'{others} to '{target}'{bound}",
        written=written,
        source=report["source"],
        others=others,
        target=report["target"],
        bound=bound,
    )
    if report["skipped"]:
        done = message("{done}; {count} skipped", done=done, count=len(report["skipped"]))
    return message(
        "{done}; {doubtful:,} of {vertices:,} vertices are doubtful",
        done=done,
        doubtful=report["low_confidence"],
        vertices=report["vertices"],
    )


def summarise_targets(reports: Iterable[dict[str, Any]], hidden: bool) -> str:
    """One sentence about several targets, with the place of bound ones, which seem to vanish.

    Args:
        reports: of transfers.
        hidden: whether the sources of bound targets were hidden.
    """
    return enumeration(
        (_place(report, hidden) if binding.write.is_at_source(report) else summary(report) for report in reports), "; "
    )


def _place(report: dict[str, Any], hidden: bool) -> str:
    """Where a bound target is."""
    place = message(
        "'{target}' is bound to '{armature}', in rest pose at the source's place",
        target=report["target"],
        armature=report["bound"]["armature"],
    )
    return message("{done}; the source is hidden", done=place) if hidden else place


def and_others(names: Sequence[str]) -> str:
    """The words after the name of a source if there are further sources."""
    return plural(len(names), " and {count} other", " and {count} others") if names else ""


def unused_settings(stored: Mapping[str, Any], settings: Mapping[str, Any]) -> list[str]:
    """A sentence about settings that differ from those of a stored match, or are not stored, if any."""
    unused = [name for name, value in settings.items() if name not in stored or stored[name] != value]
    if not unused:
        return []
    labels = enumeration(as_message(option_label(name)) for name in unused)
    return [
        warning(
            "The existing match was used: to apply the changed settings ({settings}), match again.", settings=labels
        )
    ]
