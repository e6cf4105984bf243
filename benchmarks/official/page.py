# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables, figures and the page of results, all from the records of measured pairs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.correspondence import ISOMETRIC_LIMIT, NON_ISOMETRIC_LIMIT
from benchmarks.curves import draw_curves
from benchmarks.official.lists import NONE
from benchmarks.official.measure import Setting
from benchmarks.official.records import sets_in
from benchmarks.tables import Record, Tables, as_markdown, over
from zoomout_core.arrays import Floats
from zoomout_core.matching.report.verdict import VERDICT

OURS = "zo.match"
SETTINGS = [Setting(rotate, scale).name for scale in (False, True) for rotate in (False, True)]
# Shapes whose pairs most papers leave out of a set's list, by the beginning of the set's name.
LEFT_OUT = {"SHREC19": "40"}
# Maps that should agree with the map of a pair, for sets without a truth.
AGREEMENTS = "turned", "scaled", "mirrored", "cycle"
# Percentage of the target's area above which a map that is turned over has left and right exchanged.
TURNED_OVER = 50
MAX_WRONG = 10
# Running threads for each core above which other processes slow a match down, so that its seconds do not count.
MAX_LOAD = 1.5
# Columns of the table of all sets, before the best published methods.
SUMMARY = (
    *("set", "input", "pairs", "of", "error", "without self-pairs", "success %", "mIoU", "all agree %"),
    *("certain", "certain and wrong", "certain, not all agree", "seconds"),
)
# Figures of our maps that are listed among published ones.
FIGURES = "error", "without self-pairs", "mIoU", "success %"


def tables(folder: Path, names: Sequence[str] = ()) -> Tables:
    """The tables of the sets that have records.

    `sets`: each set in each setting, next to the best published methods. For each set of these names, `NAME`: figures
    by setting; `NAME, published`: published methods and ours, the best first; `NAME, wrong`: wrong maps, the most
    certain first.

    Args:
        folder: of the records.
        names: of the sets; all if empty.
    """
    found: Tables = {"sets": []}
    for name, about, records in sets_in(folder, names):
        rows = rows_of(name, about, records)
        best = _best(_published_rows(about))
        found["sets"] += [{"set": name, **row, **best} for row in rows]
        found[name] = rows
        found[f"{name}, published"] = _standing(about, rows)
        found[f"{name}, wrong"] = _wrong(about, records)
    best_of = dict.fromkeys(column for row in found["sets"] for column in row if column.startswith("best "))
    found["sets"] = [{column: row.get(column) for column in (*SUMMARY, *best_of)} for row in found["sets"]]
    return found


def rows_of(name: str, about: Record, records: Sequence[Record]) -> list[Record]:
    """A row for each setting; for all four, if each has the same pairs; and without shapes that papers leave out."""
    row = _agreement if about["truth"] == NONE else _row
    by_setting = {setting: [record for record in records if record["setting"] == setting] for setting in SETTINGS}
    rows = [row(setting, about, chosen) for setting, chosen in by_setting.items() if chosen]
    measured = {frozenset((record["target"], record["source"]) for record in each) for each in by_setting.values()}
    if len(measured) == 1:
        rows.append(row("all four", about | {"pairs": 4 * about["pairs"]}, records))
    for beginning, shape in LEFT_OUT.items():
        if name.startswith(beginning):
            for setting, chosen in by_setting.items():
                kept = [record for record in chosen if shape not in (record["target"], record["source"])]
                if 0 < len(kept) < len(chosen):
                    rows.append(row(f"{setting}, without shape {shape}", about | {"pairs": None}, kept))
    return rows


def write(folder: Path, page: Path) -> None:
    """Write the page, and a figure for each set with a truth, from all records of a folder."""
    for name, _, records in sets_in(folder):
        curves = _curves(records)
        if curves:
            draw_curves(folder / f"{name}.png", {name: curves})
    page.write_text(as_page(folder))


def as_page(folder: Path) -> str:
    """The text of the page, which is beside the folder of the records."""
    lines = [
        "# Results on public sets",
        "",
        "`python -m benchmarks official --data FOLDER` measures the pairs of test lists and writes this page from its "
        f"records. `{OURS}` matches the two shapes alone. Nothing is trained, and no landmarks are given.",
        "",
        "- *error*: mean geodesic distance along edges between a vertex's image and its partner, over the square root "
        "of the source's area, times 100; the mean over a pair's vertices, then over pairs.",
        f"- *success*: pairs with an error below {ISOMETRIC_LIMIT / 10:.0f}, or {NON_ISOMETRIC_LIMIT / 10:.0f} where "
        "shapes are of different species.",
        f"- *certain*: pairs with a certainty of at least {100 * VERDICT.certain:.0f} %.",
        "- *mIoU*: intersection over union, by vertices of the target, of the region that has a partner by the result "
        "and by the truth, in percent.",
        "- *seconds*: of a whole match, without reading files; median and 95 % quantile. *processor seconds*: the "
        "median of the time that it computes, which depends less on what else the machine does.",
        "- *turned*: both shapes by random rotations of their own; *scaled*: the target by a random factor between 0.5 "
        "and 2.",
        "",
        "Published figures are of whole test lists, from the papers that the tables name.",
    ]
    found = tables(folder)
    if found["sets"]:
        lines += ["", as_markdown(found["sets"])]
    for name, about, records in sets_in(folder):
        lines += ["", f"## {name}", "", *_sentences(about, found[name], records)]
        lines += ["", as_markdown(found[name])]
        if found[f"{name}, published"]:
            lines += ["", "Beside published methods:", "", as_markdown(found[f"{name}, published"])]
        if found[f"{name}, wrong"]:
            lines += ["", "Wrong maps, the most certain first:", "", as_markdown(found[f"{name}, wrong"])]
        if _curves(records):
            lines += ["", f"![Share of vertices up to each error]({folder.name}/{name}.png)"]
        lines += ["", f"<sub>Code {records[0]['code']}; {about['made with']}</sub>"]
    return "\n".join(lines) + "\n"


# --- rows ---------------------------------------------------------------------------------------------------------


def _row(setting: str, about: Record, records: Sequence[Record]) -> Record:
    measured = [record for record in records if "error" in record]
    others = [record for record in measured if record["target"] != record["source"]]
    certain = _certain(measured)
    overlap = over(np.mean, measured, "IoU")
    return {
        "input": setting,
        "pairs": len(records),
        "of": about["pairs"],
        "no map": _some(len(records) - len(measured)),
        "error": over(np.mean, measured, "error"),
        "without self-pairs": over(np.mean, others, "error") if len(others) < len(measured) else None,
        "median": over(np.median, measured, "error"),
        "success %": 100 * sum(_is_right(about, record) for record in records) / len(records),
        "mIoU": None if overlap is None else 100 * overlap,
        **_certainty(measured, certain),
        "certain and wrong": sum(not _is_right(about, record) for record in certain),
        **_seconds(measured),
    }


def _agreement(setting: str, about: Record, records: Sequence[Record]) -> Record:
    """A row of a set without truth: means of distances to other maps, and the share that are close to all of them."""
    measured = [record for record in records if "certainty" in record]
    certain = _certain(measured)
    return {
        "input": setting,
        "pairs": len(records),
        "of": about["pairs"],
        "no map": _some(len(records) - len(measured)),
        **{name: over(np.mean, measured, name) for name in AGREEMENTS},
        "all agree %": 100 * sum(_agrees(about, record) for record in records) / len(records),
        "distortion": over(np.mean, measured, "distortion"),
        "turned over": sum(record["flipped %"] > TURNED_OVER for record in measured),
        **_certainty(measured, certain),
        "certain, not all agree": sum(not _agrees(about, record) for record in certain),
        **_seconds(measured),
    }


def _is_right(about: Record, record: Record) -> bool:
    return record.get("error", np.inf) < _limit(about)


def _agrees(about: Record, record: Record) -> bool:
    return "certainty" in record and all(record.get(name, 0) < _limit(about) for name in AGREEMENTS)


def _limit(about: Record) -> float:
    """Error times 100 above which a map is wrong."""
    return (NON_ISOMETRIC_LIMIT if about["is far"] else ISOMETRIC_LIMIT) / 10


def _certain(records: Sequence[Record]) -> list[Record]:
    return [record for record in records if record["certainty"] >= VERDICT.certain]


def _certainty(records: Sequence[Record], certain: Sequence[Record]) -> Record:
    mean = over(np.mean, records, "certainty")
    return {"certainty %": None if mean is None else 100 * mean, "certain": len(certain)}


def _seconds(records: Sequence[Record]) -> Record:
    undisturbed = [record for record in records if not _is_disturbed(record)]
    return {
        "seconds": over(np.median, undisturbed, "seconds"),
        "95 %": over(lambda values: np.percentile(values, 95), undisturbed, "seconds"),
        "processor seconds": over(np.median, records, "processor seconds"),
    }


def _is_disturbed(record: Record) -> bool:
    return (record.get("load") or 0) > MAX_LOAD


def _wrong(about: Record, records: Sequence[Record]) -> list[Record]:
    wrong = [record for record in records if about["truth"] != NONE and not _is_right(about, record)]
    wrong = sorted(wrong, key=lambda record: -record.get("certainty", 0))[:MAX_WRONG]
    columns = {"target": "target", "source": "source", "input": "setting", "error": "error", "certainty": "certainty"}
    return [
        {title: record.get(column) for title, column in columns.items()} | {"no map": record.get("failed")}
        for record in wrong
    ]


# --- published figures --------------------------------------------------------------------------------------------


def _published_rows(about: Record) -> list[Record]:
    """The published methods of a protocol."""
    published = about["protocol"].get("published", {})
    return [
        {
            "method": entry["method"],
            "kind": kind.removeprefix("mIoU_").replace("_", " "),
            "error": entry.get("x100"),
            "mIoU": entry.get("mIoU"),
            "source": entry.get("source", published.get("source")),
        }
        for kind, entries in published.items()
        if isinstance(entries, list)
        for entry in entries
    ]


def _best(published: Sequence[Record]) -> Record:
    """The best published method of each kind, with its figure."""
    figure = _ranking_measure(published)
    unit = "mIoU " if figure == "mIoU" else ""
    best: dict[str, Record] = {}
    for entry in sorted((entry for entry in published if entry[figure] is not None), key=lambda e: _rank(e, figure)):
        best.setdefault(entry["kind"], entry)
    return {f"best {kind}": f"{unit}{entry[figure]:.4g} ({entry['method']})" for kind, entry in best.items()}


def _standing(about: Record, rows: Sequence[Record]) -> list[Record]:
    """Published methods and ours, the best first."""
    published = _published_rows(about)
    if not published:
        return []
    ours = [
        {"method": f"{OURS}, {row['input']}", "kind": "nothing trained"}
        | {column: row.get(column) for column in FIGURES}
        for row in rows
    ]
    figure = _ranking_measure(published)
    return [
        {column: row.get(column) for column in ("method", "kind", *FIGURES, "source")}
        for row in sorted([*ours, *published], key=lambda row: _rank(row, figure))
    ]


def _ranking_measure(published: Sequence[Record]) -> str:
    """The figure that most published methods have."""
    return max(("error", "mIoU"), key=lambda figure: sum(entry[figure] is not None for entry in published))


def _rank(row: Record, figure: str) -> float:
    """A number that is smaller for better methods by a figure, and largest for those without it."""
    value = row.get(figure)
    return np.inf if value is None else value if figure == "error" else -value


# --- text and figures ---------------------------------------------------------------------------------------------


def _sentences(about: Record, rows: Sequence[Record], records: Sequence[Record]) -> list[str]:
    """Sentences about the measured sample of a list, the protocol, and the pairs whose seconds count."""
    listed = [f"*List*: {about['protocol']['protocol']}"] if "protocol" in about["protocol"] else []
    whole = all(row["pairs"] == row["of"] for row in rows if row["of"])
    measured = (
        f"All {about['pairs']} pairs of the list are measured."
        if whole
        else (
            "A random sample of the list is measured: "
            + ", ".join(f"{row['pairs']} of {row['of']} pairs {row['input']}" for row in rows if row["of"])
            + "."
        )
    )
    undisturbed = sum(not _is_disturbed(record) for record in records)
    timed = (
        f"Seconds count only pairs during which at most {MAX_LOAD} threads ran for each core: {undisturbed} of them."
        if undisturbed < len(records)
        else ""
    )
    return [*listed, *([""] if listed else []), f"{measured} {timed}".rstrip()]


def _curves(records: Sequence[Record]) -> dict[str, Floats]:
    """The mean cumulative curve of each setting that has any."""
    return {
        f"{OURS}, {setting}": np.mean([record["curve"] for record in of_setting], axis=0)
        for setting in SETTINGS
        if (of_setting := [record for record in records if record["setting"] == setting and "curve" in record])
    }


def _some(count: int) -> int | None:
    return count or None
