# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences about the tables of the paper's page, each computed from the figures of its table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.tables import Record, Tables

# Rows of methods that start from the two shapes alone.
OURS = "zo.match"
# Rows that no method refined: the start, and maps that others published.
NOT_REFINED = ("initial", "BIM, published", "PMF_hk, published", "WKSini_direct_BCICP, published")
# The paper's claim is about steps up to this one.
LARGEST_EQUAL_STEP = 10
# Number of symmetries of the vase among the signs of its first four eigenfunctions.
SYMMETRIES_OF_VASE = 3


def refinement(tables: Tables) -> list[str]:
    sentences = []
    for rows in _by("set", tables.get("rows", []) + tables.get("not isometric", [])):
        start, given = rows[0], [row for row in rows if _is_refined(row)]
        others = [row for row in given if row["method"] != "ZoomOut"]
        sentences.append(
            f"{start['set']}, from an initial mean of {_n(start['mean'])}: the smallest mean is "
            f"{_best(given, 'mean')}, and the smallest median {_best(given, 'median')}. ZoomOut fails on "
            f"{_n(_of(rows, 'ZoomOut')['failed %'])} % of the pairs, the others on {_range(others, 'failed %')} %."
            f"{_ours(rows)}"
        )
    return sentences + _times_as_fast(tables.get("rows", []), "BCICP", ("ZoomOut", "ZoomOut*"))


def step_size(tables: Tables) -> list[str]:
    steps = [row for row in tables["rows"] if row["step"].isdecimal()]
    small = [row for row in steps if int(row["step"]) <= LARGEST_EQUAL_STEP]
    large = [row for row in steps if int(row["step"]) > LARGEST_EQUAL_STEP]
    sentences = [f"Steps of up to {LARGEST_EQUAL_STEP} end with mean errors of {_range(small, 'mean error')}."]
    if large:
        sentences.append(f"Larger ones end with {_range(large, 'mean error')}.")
    return sentences


def initial_size(tables: Tables) -> list[str]:
    rows = tables["rows"]
    first = min(n for n in range(len(rows)) if all(row["right"] == rows[-1]["right"] for row in rows[n:]))
    sentences = [
        f"From a size of {rows[first]['size']} on, {rows[first]['right']} of {rows[first]['pairs']} pairs end right, "
        f"with mean errors of {_range(rows[first:], 'mean error')}."
    ]
    if first:
        sentences.append(f"From smaller starts, {_range(rows[:first], 'right')} do.")
    noise = tables.get("noise", [])
    if noise:
        counts = [f"{row['converged']} of {row['draws']} with noise of {_n(row['noise'])}" for row in noise]
        sentences.append(f"Of noisy true maps, {_and(counts)} end right.")
    return sentences


def overfitting(tables: Tables) -> list[str]:
    sentences = []
    for name, what in (
        ("fitted", "The mean error of fitted maps"),
        ("ZoomOut from 20", "That of ZoomOut from the map of size 20"),
        ("true", "That of true maps of the same size"),
    ):
        known = [row for row in tables["rows"] if row.get(f"{name}: mean") is not None]
        if known:
            best = min(known, key=lambda row: row[f"{name}: mean"])
            first, last = known[0], known[-1]
            sentences.append(
                f"{what} is {_n(first[f'{name}: mean'])} at size {first['size']}, {_n(best[f'{name}: mean'])} at best "
                f"(size {best['size']}), and {_n(last[f'{name}: mean'])} at size {last['size']}."
            )
    return sentences


def signs(tables: Tables) -> list[str]:
    vase = [row["commutativity"] for row in tables["rows"] if row["shape"] == "vase"]
    if len(vase) <= SYMMETRIES_OF_VASE:
        return []
    last, following = vase[SYMMETRIES_OF_VASE - 1 : SYMMETRIES_OF_VASE + 1]
    return [
        f"The commutator of the vase's third choice of signs is {_n(last)}, and that of the fourth {_n(following)}, "
        f"{_n(following / last)} times as large."
    ]


def symmetry(tables: Tables) -> list[str]:
    sentences = []
    for rows in _by("set", tables.get("rows", [])):
        found, truth = rows[0], rows[1] if len(rows) > 1 else None
        sentences.append(
            f"{found['set']}: `{found['method']}` is right on {_n(found['success %'])} % of {found['shapes']} shapes, "
            f"with a mean error of {_n(found['mean'])}"
            + (f"; {truth['method']}, has one of {_n(truth['mean'])}." if truth and truth["mean"] else ".")
        )
    refined = [row for row in tables.get("refined", []) if row.get("mean") is not None]
    if refined:
        sentences.append(
            "Refined from the same start, mean and median errors are "
            + _and([f"{_n(row['mean'])} and {_n(row['median'])} ({row['method']})" for row in refined])
            + "."
        )
        sentences += _times_as_fast(refined, "OrientRev + BCICP", ("OrientRev + ZoomOut", "OrientRev + ZoomOut*"))
    return sentences


def large(tables: Tables) -> list[str]:
    sentences = []
    for rows in _by("vertices", tables["rows"]):
        given = [row for row in rows if _is_refined(row)]
        ours = _of(rows, OURS)
        sentences.append(
            f"At {rows[0]['vertices']} vertices, from an initial mean of {_n(rows[0]['mean error'])}, the smallest "
            f"mean error is {_best(given, 'mean error')}, and the largest {_best(given, 'mean error', max)}. `{OURS}` "
            f"has {_n(ours['mean error'])}."
        )
    return sentences


def downsampled(tables: Tables) -> list[str]:
    every = next((row for row in tables["rows"] if row["method"] == "ZoomOut on all vertices"), None)
    sentences = [] if every is None else [f"ZoomOut on all vertices has a mean error of {_n(every['mean error'])}."]
    for rows in _by("method", [row for row in tables["rows"] if row is not every and row["method"] != "initial"]):
        errors = _and([f"{_n(row['mean error'])} on {row['vertices']}" for row in rows])
        sentences.append(f"{rows[0]['method'][0].upper()}{rows[0]['method'][1:]}: {errors}.")
    return sentences


def point_clouds(tables: Tables) -> list[str]:
    sentences = []
    for rows in _by("set", tables["rows"]):
        given = [row for row in rows if _is_refined(row)]
        sentences.append(
            f"{rows[0]['set']}, from an initial mean of {_n(rows[0]['mean error'])}: the smallest mean is "
            f"{_best(given, 'mean error')}."
        )
    for rows in _by("set", tables.get("match", [])):
        pairs, right, sure, wrong = (
            sum(row[column] for row in rows) for column in ("pairs", "right", "certain", "certain and wrong")
        )
        sentences.append(
            f"On {rows[0]['set']}, `{OURS}` is right on {right} of {pairs} pairs. It is certain of {sure} maps; wrong "
            f"among these: {wrong}."
        )
    return sentences


def discretisation(tables: Tables) -> list[str]:
    counts = [_numbers(value) for row in tables["right"] for name, value in row.items() if name != "target" and value]
    errors = [value for row in tables["rows"] for name, value in row.items() if name != "target" and value is not None]
    right, pairs = (sum(count[part] for count in counts) for part in (0, 1))
    return [
        f"{right} of {pairs} pairs are right. Mean errors are between {_n(min(errors))} and {_n(max(errors))}, by the "
        "kinds of target and source."
    ]


def clutter(tables: Tables) -> list[str]:
    given = [row for row in tables["rows"] if not row["method"].startswith((OURS, "initial", "PFM"))]
    alone = [row for row in tables["rows"] if row["method"].startswith((OURS, "PFM"))]
    sentences = [
        f"From the given matches, the smallest mean error is {_best(given, 'mean')}, and the largest part of the "
        f"object that is covered {_best(given, 'covered %', max, ' %')}."
    ]
    if alone:
        errors = _and([f"{_n(row['mean'])} ({row['method'].split(',')[0]})" for row in alone])
        sentences.append(f"Without them, mean errors are {errors}.")
    return sentences


def partial(tables: Tables) -> list[str]:
    sentences = []
    for rows in _by("set", tables["rows"]):
        order = sorted((row for row in rows if row["method"] != "initial"), key=lambda row: -row["right %"])
        sentences.append(
            f"{rows[0]['set'].capitalize()}: right pairs in %, with the number of pairs that a method is measured on: "
            + ", ".join(f"{row['method']} {_n(row['right %'])} ({row['pairs']})" for row in order)
            + "."
        )
    return sentences


# --- parts of sentences -------------------------------------------------------------------------------------------


def _ours(rows: Sequence[Record]) -> str:
    """How many pairs our match of the shapes alone fails on."""
    ours = next((row for row in rows if row["method"].startswith(OURS)), None)
    if ours is None:
        return ""
    return f" `{OURS}` has a mean of {_n(ours['mean'])} and fails on {_n(ours['failed %'])} %."


def _times_as_fast(rows: Sequence[Record], slow: str, fast: Sequence[str]) -> list[str]:
    """How many times as fast as one method others are, over the sets."""
    sentences = []
    for name in fast:
        ratios = [
            _of(of_set, slow)["seconds"] / _of(of_set, name)["seconds"]
            for of_set in _by("set", rows)
            if {slow, name} <= {row["method"] for row in of_set}
        ]
        if ratios:
            sentences.append(f"{name} is {_span(ratios)} times as fast as {slow}.")
    return sentences


def _is_refined(row: Record) -> bool:
    return row["method"] not in NOT_REFINED and not row["method"].startswith(OURS)


def _by(column: str, rows: Sequence[Record]) -> list[list[Record]]:
    """The rows with each value of a column, in the order of the table; all of them if they do not have it."""
    values = dict.fromkeys(row.get(column) for row in rows)
    return [[row for row in rows if row.get(column) == value] for value in values]


def _of(rows: Sequence[Record], method: str) -> Record:
    return next(row for row in rows if row["method"] == method)


def _best(rows: Sequence[Record], column: str, choose: Callable[..., Any] = min, unit: str = "") -> str:
    """The method with the smallest, or largest, figure, and the figure."""
    best = choose(rows, key=lambda row: row[column])
    return f"{_n(best[column])}{unit} ({best['method']})"


def _range(rows: Sequence[Record], column: str) -> str:
    return _span([row[column] for row in rows])


def _span(values: Sequence[float]) -> str:
    low, high = _n(min(values)), _n(max(values))
    return low if low == high else f"{low} to {high}"


def _n(value: float) -> str:
    return f"{value:.3g}"


def _and(items: Sequence[str]) -> str:
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"


def _numbers(fraction: str) -> tuple[int, int]:
    """The two numbers of a text such as 1/2."""
    right, pairs = fraction.split("/")
    return int(right), int(pairs)
