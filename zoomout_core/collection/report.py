# SPDX-License-Identifier: GPL-3.0-or-later
"""Report on a collection: `report.json` for programs, and `report.html`, one page that opens in any browser."""

from __future__ import annotations

import json
from base64 import b64encode
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from zoomout_core.collection.collection import CollectionResult
from zoomout_core.collection.cycles import Agreement
from zoomout_core.collection.pair_map import PairName
from zoomout_core.collection.transfer_records import TransferOutcome
from zoomout_core.matching.report.verdict import AMBER, GREEN, LEVELS, RED, VERDICT, select_notes
from zoomout_core.messages import note_figures, note_lines, probability
from zoomout_core.runtime.outputs import atomic_write

REPORT, PAGE = "report.json", "report.html"
# Maximum pairs in the table of pairs to check first.
MAX_ROWS = 100


def figures_of_collection(
    result: CollectionResult, received: Mapping[str, TransferOutcome] | None = None
) -> dict[str, Any]:
    """How a collection went, in values that JSON can store; pairs are sorted by trust, lowest first.

    With a transfer, `received` is its outcome for each target.
    """
    agreement, levels = result.agreement, _levels(result)
    pairs = []
    for pair in sorted(result.records, key=lambda each: (result.trust(each), each)):
        record = asdict(result.records[pair])
        del record["key"]
        record |= note_figures(record["notes"])
        row = {"source": pair.source, "target": pair.target, "trust": result.trust(pair)}
        row |= {"verdict": result.verdict(pair)._asdict(), **record}
        if agreement is not None and pair in agreement.after:
            row |= {"cycle_error": agreement.after[pair], "cycle_error_before": agreement.before[pair]}
        pairs.append(row)
    found: dict[str, Any] = {
        "shapes": list(result.items),
        "matched_now": result.matched,
        "verdicts": {level: levels[level] for level in LEVELS},
        "pairs": pairs,
        "failures": result.failures,
    }
    if agreement is not None:
        found["cycles"] = {
            "error_before": float(np.mean(list(agreement.before.values()))),
            "error_after": float(np.mean(list(agreement.after.values()))),
            "changed": [{"source": pair.source, "target": pair.target} for pair in agreement.changed],
        }
    if received is not None:
        found["transferred"] = {name: list(each.notes) for name, each in received.items()}
        found["transfer_warnings"] = {name: note_figures(each.notes)["warnings"] for name, each in received.items()}
        motions = {name: list(each.motions) for name, each in received.items() if each.motions}
        if motions:
            found["motions"] = motions
    return found


def _levels(result: CollectionResult) -> Counter[str]:
    """The number of pairs of each level of verdict."""
    return Counter(result.verdict(pair).level for pair in result.records)


def lines_of_collection(result: CollectionResult) -> list[str]:
    """Summarise a collection in sentences for the user."""
    records, agreement = result.records, result.agreement
    levels = _levels(result)
    doubtful = ", ".join(f"{levels[level]} {level}" for level in (RED, AMBER) if levels[level])
    lines = [
        f"Matched {_pairs(len(records))} of {len(result.items)} shapes, {result.matched} of them in this run; "
        f"{len(result.failures)} failed.",
        f"Verdicts: {levels[GREEN]} green{f', {doubtful} (check these first)' if doubtful else ''}.",
    ]
    if agreement is not None:
        before, after = (float(np.mean(list(each.values()))) for each in (agreement.before, agreement.after))
        cycles = f"Around cycles, maps miss their start by {before:.3f} at unit area"
        changed = ", ".join(map(str, agreement.changed))
        lines.append(
            f"{cycles}, and by {after:.3f} with other candidates for {changed}."
            if changed
            else f"{cycles}; no other candidates close them better."
        )
    return [*lines, *(f"{name}: failed. {message}" for name, message in result.failures.items())]


def _pairs(count: int) -> str:
    return "1 pair" if count == 1 else f"{count} pairs"


def write_reports(
    result: CollectionResult, pictures: Mapping[str, bytes], received: Mapping[str, TransferOutcome] | None = None
) -> None:
    """Write `report.json` and `report.html`, with PNG files of the shapes by name, to the folder of a collection.

    Raises:
        OutputError: they cannot be written.
    """
    figures = figures_of_collection(result, received)
    with atomic_write(result.folder / REPORT) as part:
        part.write_text(f"{json.dumps(figures, indent=1)}\n", encoding="utf-8")
    with atomic_write(result.folder / PAGE) as part:
        part.write_text(page_of(result, pictures, received), encoding="utf-8", errors="backslashreplace")


def page_of(
    result: CollectionResult, pictures: Mapping[str, bytes], received: Mapping[str, TransferOutcome] | None = None
) -> str:
    """The HTML page of a collection."""
    least: dict[str, tuple[float, PairName]] = {}
    for pair in result.records:
        # With a template, each shape is shown with the map onto it; otherwise with its least certain map.
        for name in (pair.target,) if _template_of(result) == pair.source else pair:
            least[name] = min(least.get(name, (2.0, pair)), (result.trust(pair), pair))
    order = sorted(least, key=lambda name: least[name][0])
    # Shapes without a map of their own, such as a template, come first.
    cards = [_card(name, pictures[name]) for name in pictures if name not in least]
    cards += [_card(name, pictures.get(name), result, least[name][1]) for name in order]
    rows = sorted(result.records, key=lambda pair: (result.trust(pair), pair))[:MAX_ROWS]
    return PAGE_TEMPLATE.substitute(
        title=escape(result.folder.name),
        summary="".join(f"<p>{escape(line)}</p>" for line in lines_of_collection(result)),
        cards="".join(cards),
        rows="".join(_row(result, pair) for pair in rows),
        shown=_shown(len(rows), len(result.records)),
        cycles=_about_cycles(result.agreement),
        received=_transfers(received or {}),
        failures=_failures(result.failures),
    )


def _shown(rows: int, pairs: int) -> str:
    """Which pairs the table shows."""
    if rows < pairs:
        return f"The {rows} least trusted of {pairs} pairs."
    return f"All {pairs} pairs, the least trusted first." if pairs > 1 else ""


def _about_cycles(agreement: Agreement | None) -> str:
    """The meaning of trust, and of a cycle's error if there are cycles."""
    if agreement is None:
        return "Trust is the certainty of the map."
    changed = ", before and after other candidates were chosen for some pairs" if agreement.changed else ""
    return (
        "Trust combines the certainty of the map and the errors of the cycles around it: a cycle's error is the mean "
        f"distance, at unit area, by which maps around three shapes miss their start{changed}."
    )


def _template_of(result: CollectionResult) -> str | None:
    """The shape that is the source of more than half of the pairs, if there is one."""
    sources = [pair.source for pair in result.records]
    most = max(set(sources), key=sources.count, default=None)
    return most if most is not None and 2 * sources.count(most) > len(sources) else None


def _card(
    name: str, picture: bytes | None, result: CollectionResult | None = None, pair: PairName | None = None
) -> str:
    """A shape with the verdict on the map of a pair, or without a map of its own."""
    image = ""
    if picture is not None:
        data = b64encode(picture).decode()
        image = (
            f'<img loading="lazy" alt="{escape(name)}, coloured through its map" src="data:image/png;base64,{data}">'
        )
    if result is None or pair is None:
        return f"<figure>{image}<figcaption><b>{escape(name)}</b></figcaption></figure>"
    verdict, trust = result.verdict(pair), result.trust(pair)
    about = f"{escape(str(pair))}: {escape(verdict.sentence)} {result.records[pair].seconds:.1f} s"
    return (
        f'<figure class="{verdict.level}">{image}<figcaption><b>{escape(name)}</b>'
        f'<meter min="0" max="1" low="{VERDICT.wrong}" high="{VERDICT.certain}" optimum="1" '
        f'value="{trust:.3f}"></meter>'
        f"<small>{about}</small></figcaption></figure>"
    )


def _row(result: CollectionResult, pair: PairName) -> str:
    record, agreement, verdict = result.records[pair], result.agreement, result.verdict(pair)
    cycle = ""
    if agreement is not None and pair in agreement.after:
        errors = dict.fromkeys(f"{each[pair]:.3f}" for each in (agreement.before, agreement.after))
        cycle = " → ".join(errors)
    chosen = f"candidate {record.candidate}" if record.candidate else ""
    if record.through:
        chosen = f"through {record.through}"
    cells = (
        pair.source,
        pair.target,
        result.verdict(pair).level,
        probability(result.trust(pair)),
        probability(record.certainty),
        f"{record.mean_confidence:.2f}",
        f"{record.low_confidence:.1%}",
        cycle,
        chosen,
        f"{record.seconds:.1f}",
        " ".join((verdict.line, *note_lines(select_notes(record.notes, verdict)))),
    )
    return f"<tr>{_cells(cells)}</tr>"


def _cells(values: Iterable[str]) -> str:
    return "".join(f"<td>{escape(value)}</td>" for value in values)


def _transfers(received: Mapping[str, TransferOutcome]) -> str:
    """A table of the meshes with transferred data."""
    cells = [(name, " ".join(note_lines(each.notes))) for name, each in received.items()]
    return _section("Transferred", ("mesh", "notes"), cells)


def _failures(failures: Mapping[str, str]) -> str:
    return _section("Failed", ("what", "why"), list(failures.items()))


def _section(title: str, columns: Sequence[str], cells: Sequence[Sequence[str]]) -> str:
    """A table with a title; nothing without rows."""
    if not cells:
        return ""
    head = "".join(f"<th>{each}</th>" for each in columns)
    rows = "".join(f"<tr>{_cells(each)}</tr>" for each in cells)
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
    return f'<h2>{title}</h2><div class="scroll">{table}</div>'


PAGE_TEMPLATE = Template((Path(__file__).parent / "report_page.html").read_text(encoding="utf-8"))
