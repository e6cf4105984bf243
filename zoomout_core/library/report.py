# SPDX-License-Identifier: GPL-3.0-or-later
"""Report on the sources of many targets: `report.json` for programs, and `report.html` with pictures."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

from zoomout_core.collection.picture_page import picture_card, picture_page
from zoomout_core.collection.report import PAGE, REPORT
from zoomout_core.library.find_all import FoundForAll
from zoomout_core.library.target_records import TargetRecord, place_of_picture
from zoomout_core.matching.report.verdict import LEVELS, select_notes
from zoomout_core.messages import note_figures, note_lines
from zoomout_core.runtime.outputs import atomic_write, make_folder


def figures_of_targets(result: FoundForAll) -> dict[str, Any]:
    """The source of each target, in values that JSON can store; those to look at come first."""
    rows = []
    for name, record in _in_order(result):
        row = asdict(record)
        for unused in ("key", "level", "sentence", "advice"):
            del row[unused]
        rows.append({"name": name, "verdict": record.verdict._asdict(), **row, **note_figures(record.notes)})
    return {"new": result.new, "targets": rows, "failures": result.failures}


def lines_of_targets(result: FoundForAll) -> list[str]:
    """The same in sentences."""
    fitting = sum(bool(record.source) for record in result.records.values())
    count = len(result.records) + len(result.failures)
    lines = [f"A source was found for {fitting} of {count} targets."]
    lines += [f"{name}: {_line(record)}" for name, record in _in_order(result)]
    return lines + [f"{name}: failed. {reason}" for name, reason in result.failures.items()]


def write_reports(result: FoundForAll) -> None:
    """Write `report.json` and `report.html` to the folder of the results.

    Raises:
        OutputError: they cannot be written.
    """
    make_folder(result.folder)
    with atomic_write(result.folder / REPORT) as part:
        part.write_text(f"{json.dumps(figures_of_targets(result), indent=1)}\n", encoding="utf-8")
    page = picture_page(
        result.folder.absolute().name,
        lines_of_targets(result)[0],
        "All targets, those to look at first",
        "The source is on the left, the target beside it, and the written target with its joints on the right. Equal "
        "colours correspond.",
        (_card(result, name, record) for name, record in _in_order(result)),
        result.failures,
    )
    with atomic_write(result.folder / PAGE) as part:
        part.write_text(page, encoding="utf-8", errors="backslashreplace")


def _card(result: FoundForAll, name: str, record: TargetRecord) -> str:
    others = [f"{row['file']}: fit {row['fit']:.0%}." for row in record.ranked]
    png = place_of_picture(result.folder, name).read_bytes()
    return picture_card(
        name, record.level, png, [_line(record), *others, *note_lines(select_notes(record.notes, record.verdict))]
    )


def _line(record: TargetRecord) -> str:
    return " ".join(filter(None, (f"{record.source}." * bool(record.source), record.verdict.line)))


def _in_order(result: FoundForAll) -> list[tuple[str, TargetRecord]]:
    """The worst verdicts first, then by name."""
    return sorted(result.records.items(), key=lambda row: (-LEVELS.index(row[1].level), row[0]))
