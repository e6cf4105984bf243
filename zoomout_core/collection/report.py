# SPDX-License-Identifier: GPL-3.0-or-later
"""Report on a collection: `report.json` for programs, and `report.html`, one page that opens in any browser."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from zoomout_core.collection.collection import CollectionResult
from zoomout_core.collection.cycles import CYCLES
from zoomout_core.collection.pair_map import PairName, PairRecord
from zoomout_core.runtime.outputs import atomic_write

REPORT, PAGE = "report.json", "report.html"
# Maximum pairs in the table of pairs to check first.
MAX_ROWS = 100
# Smallest certainty of a map that the commands call sure.
SURE = 0.9


def trust(result: CollectionResult, pair: PairName) -> float:
    """How far to trust a pair's map as a whole, in [0, 1], from its certainty and the cycles around it."""
    certainty, agreement = result.records[pair].certainty, result.agreement
    if agreement is None or pair not in agreement.after:
        return certainty
    # A map that was composed, or chosen by other pairs, has little certainty by itself.
    own = agreement.certainty[pair] if agreement.candidate[pair] else certainty
    openness = (agreement.after[pair] - CYCLES.closed) / (CYCLES.open - CYCLES.closed)
    return own * (1 - min(1.0, max(0.0, openness)) / 2)


def figures_of_collection(result: CollectionResult, received: Mapping[str, list[str]] | None = None) -> dict[str, Any]:
    """How a collection went, in values that JSON can store; pairs are sorted by trust, lowest first.

    Args:
        result: the collection.
        received: the notes of a transfer on each target.
    """
    agreement = result.agreement
    pairs = []
    for pair in sorted(result.records, key=lambda each: (trust(result, each), each)):
        record = asdict(result.records[pair])
        del record["key"]
        row = {"source": pair.source, "target": pair.target, "trust": trust(result, pair), **record}
        if agreement is not None and pair in agreement.after:
            row |= {"cycle_error": agreement.after[pair], "cycle_error_before": agreement.before[pair]}
        pairs.append(row)
    found: dict[str, Any] = {
        "shapes": list(result.items),
        "matched_now": result.matched,
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
        found["transferred"] = dict(received)
    return found


def lines_of_collection(result: CollectionResult) -> list[str]:
    """Summarise a collection in sentences for the user."""
    records, agreement = result.records, result.agreement
    unsure = sum(trust(result, pair) < SURE for pair in records)
    lines = [
        f"{len(records)} pairs of {len(result.items)} shapes are matched, {result.matched} of them in this run; "
        f"{len(result.failures)} failed.",
        *([f"Trust is below {SURE:.0%} for {unsure}: check these first."] if unsure else []),
    ]
    if agreement is not None:
        before, after = (float(np.mean(list(each.values()))) for each in (agreement.before, agreement.after))
        changed = ", ".join(map(str, agreement.changed)) or "none"
        lines.append(
            f"Maps miss by {before:.3f} around cycles, and by {after:.3f} after they were made consistent (at unit "
            f"area); changed: {changed}."
        )
    return [*lines, *(f"{name}: failed. {message}" for name, message in result.failures.items())]


def write_reports(
    result: CollectionResult, pictures: Mapping[str, bytes], received: Mapping[str, list[str]] | None = None
) -> None:
    """Write `report.json` and `report.html` to the folder of a collection.

    Args:
        result: the collection.
        pictures: PNG files of its shapes, by name.
        received: the notes of a transfer on each target.

    Raises:
        OutputError: they cannot be written.
    """
    figures = figures_of_collection(result, received)
    with atomic_write(result.folder / REPORT) as part:
        part.write_text(f"{json.dumps(figures, indent=1)}\n", encoding="utf-8")
    with atomic_write(result.folder / PAGE) as part:
        part.write_text(page_of(result, pictures), encoding="utf-8")


def page_of(result: CollectionResult, pictures: Mapping[str, bytes]) -> str:
    """The HTML page of a collection."""
    least: dict[str, tuple[float, PairName]] = {}
    for pair in result.records:
        # With a template, each shape is shown with the map onto it; otherwise with its least certain map.
        for name in (pair.target,) if _template_of(result) == pair.source else pair:
            least[name] = min(least.get(name, (2.0, pair)), (trust(result, pair), pair))
    order = sorted(least, key=lambda name: least[name][0])
    # Shapes without a map of their own, such as a template, come first.
    cards = [_card(name, None, None, None, pictures[name]) for name in pictures if name not in least]
    cards += [_card(name, *least[name], result.records[least[name][1]], pictures.get(name)) for name in order]
    rows = sorted(result.records, key=lambda pair: (trust(result, pair), pair))[:MAX_ROWS]
    return PAGE_TEMPLATE.substitute(
        title=escape(result.folder.name),
        summary="".join(f"<p>{escape(line)}</p>" for line in lines_of_collection(result)),
        cards="".join(cards),
        rows="".join(_row(result, pair) for pair in rows),
        shown=f"The {len(rows)} least trusted of {len(result.records)}" if len(rows) < len(result.records) else "All",
        failures=_failures(result.failures),
    )


def _template_of(result: CollectionResult) -> str | None:
    """The shape that is the source of more than half of the pairs, if there is one."""
    sources = [pair.source for pair in result.records]
    most = max(set(sources), key=sources.count, default=None)
    return most if most is not None and 2 * sources.count(most) > len(sources) else None


def _card(
    name: str, certain: float | None, pair: PairName | None, record: PairRecord | None, picture: bytes | None
) -> str:
    image = ""
    if picture is not None:
        data = b64encode(picture).decode()
        image = (
            f'<img loading="lazy" alt="{escape(name)}, coloured through its map" src="data:image/png;base64,{data}">'
        )
    if certain is None or record is None or pair is None:
        return f"<figure>{image}<figcaption><b>{escape(name)}</b></figcaption></figure>"
    about = f"{escape(str(pair))}: {certain:.0%}, {record.low_confidence:.0%} doubtful, {record.seconds:.1f} s"
    return (
        f'<figure class="{_grade(certain)}">{image}<figcaption><b>{escape(name)}</b>'
        f'<meter min="0" max="1" low="0.5" high="{SURE}" optimum="1" value="{certain:.3f}"></meter>'
        f"<small>{about}</small></figcaption></figure>"
    )


def _grade(certain: float) -> str:
    return "sure" if certain >= SURE else "unsure" if certain >= 0.5 else "doubtful"


def _row(result: CollectionResult, pair: PairName) -> str:
    record, agreement = result.records[pair], result.agreement
    cycle = ""
    if agreement is not None and pair in agreement.after:
        cycle = f"{agreement.before[pair]:.3f} → {agreement.after[pair]:.3f}"
    chosen = "" if not record.candidate else f"candidate {record.candidate}"
    chosen = f"through {record.through}" if record.through else chosen
    cells = (
        pair.source,
        pair.target,
        f"{trust(result, pair):.0%}",
        f"{record.certainty:.0%}",
        f"{record.mean_confidence:.2f}",
        f"{record.low_confidence:.1%}",
        cycle,
        chosen,
        f"{record.seconds:.1f}",
        " ".join(record.notes),
    )
    return f"<tr>{_cells(cells)}</tr>"


def _cells(values: Iterable[str]) -> str:
    return "".join(f"<td>{escape(value)}</td>" for value in values)


def _failures(failures: Mapping[str, str]) -> str:
    if not failures:
        return ""
    rows = "".join(f"<tr>{_cells(each)}</tr>" for each in failures.items())
    return f"<h2>Failed</h2><table><thead><tr><th>what</th><th>why</th></tr></thead><tbody>{rows}</tbody></table>"


PAGE_TEMPLATE = Template((Path(__file__).parent / "report_page.html").read_text(encoding="utf-8"))
