# SPDX-License-Identifier: GPL-3.0-or-later
"""Local faults of maps, which artists see first: lost parts, wrong limbs and torn edges; and the verdict."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

from tqdm import tqdm

import zoomout_core as zo
from benchmarks.everywhere.cases import LEGS, OTHER, SKIN, TOUCH, Case, cases
from benchmarks.everywhere.left_out import LEFT_OUT, cases_left_out
from benchmarks.everywhere.measures import Row, is_wrong, measure, measure_binding
from benchmarks.everywhere.pictures import draw
from benchmarks.tables import Tables
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.matching.report.verdict import AMBER, GREEN, RED

# Number of worst cases to draw for each kind.
WORST = 4
KINDS = SKIN, LEGS, TOUCH, OTHER
BASELINE = "DT "


def run(data: Path, pairs: int | None, picture_folder: Path | None, left_out: bool = False) -> Tables:
    """Match each case without hints, and measure the worst places of the map.

    `rows`, for each case: the figures of `measure`, those of Blender's Data Transfer (DT), those of `measure_binding`,
    certainty, verdict, whether the map is wrong, and seconds of a cold match. `summary`: the worst of each kind, and
    the number of verdicts that are green on a wrong map, or red on a right one.

    Args:
        data: the folder of the sets, including characters and clothes.
        pairs: approximate number of cases of each kind, evenly spread.
        picture_folder: for pictures of the worst cases of each kind.
        left_out: take the cases that set no number instead.
    """
    rows: list[Row] = []
    worst: dict[str, list[tuple[float, Row, Case, zo.SurfaceMap]]] = {}
    chosen = cases_left_out(data, pairs) if left_out else cases(data, pairs)
    for case in tqdm(chosen, desc="everywhere", leave=False):
        zo.forget_shapes()
        begin = perf_counter()
        result = zo.match(case.source, case.target)
        seconds = perf_counter() - begin
        figures = measure(case, result.surface_map)
        baseline = {f"{BASELINE}{name}": value for name, value in measure(case, _nearest(case)).items()}
        row = {
            "kind": case.kind,
            "case": case.name,
            **figures,
            **baseline,
            **measure_binding(case, result.surface_map),
            "certainty": result.certainty,
            "verdict": result.verdict.level,
            "wrong": is_wrong(figures),
            "seconds": seconds,
        }
        rows.append(row)
        if picture_folder is not None:
            of_kind = [*worst.get(case.kind, []), (_badness(row), row, case, result.surface_map)]
            worst[case.kind] = sorted(of_kind, key=lambda entry: -entry[0])[:WORST]
    for kind, entries in worst.items():
        if picture_folder is not None:
            draw(picture_folder / f"{kind}.png", [entry[1:] for entry in entries])
    kinds = LEFT_OUT if left_out else KINDS
    return {"rows": rows, "summary": [_sum_up(kind, [row for row in rows if row["kind"] == kind]) for kind in kinds]}


def _nearest(case: Case) -> zo.SurfaceMap:
    """Data Transfer's map to the nearest points, without alignment."""
    source = case.source
    return zo.SurfaceMap(*closest_points(case.target.vertices, source.vertices, source.triangles), source.triangles)


def _badness(row: Row) -> float:
    return (1 - (row["part"] or 1)) + (row["limb"] or 0) + 10 * row["torn"] + 10 * (row["off"] or 0)


def _sum_up(kind: str, rows: list[Row]) -> Row:
    def values(name: str) -> list[float]:
        return [row[name] for row in rows if row[name] is not None]

    levels = [row["verdict"] for row in rows]
    return {
        "kind": kind,
        "cases": len(rows),
        "least part": min(values("part"), default=None),
        "lost": sum(values("lost")),
        "visible": sum(values("visible")),
        "most limb": max(values("limb"), default=None),
        "most torn": max(values("torn"), default=None),
        "most off": max(values("off"), default=None),
        "most stretched": max(values("stretched"), default=None),
        "most islands": max(values("islands"), default=None),
        "wrong": sum(row["wrong"] for row in rows),
        **{level: levels.count(level) for level in (GREEN, AMBER, RED)},
        "green but wrong": sum(row["wrong"] and row["verdict"] == GREEN for row in rows),
        "red but right": sum(not row["wrong"] and row["verdict"] == RED for row in rows),
    }
