# SPDX-License-Identifier: GPL-3.0-or-later
"""Accuracy of transferred data by our method and by the tools of artists; the truth is known at every corner."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from tqdm import tqdm

from benchmarks.transfer.cases import Case, make_cases
from benchmarks.transfer.figures import figures
from benchmarks.transfer.methods import WAYS


def run(data: Path, max_count: int | None) -> dict[str, list[dict[str, Any]]]:
    """Transfer from every source to remeshed versions of itself, in its own and in another pose.

    Args:
        data: folder of the sets.
        max_count: maximum number of shapes; None for all.

    Returns:
        `rows`: medians of the figures for each pose and method; `pairs`: the figures of each shape.
    """
    pairs = [row for case in tqdm(make_cases(data, max_count), desc="targets") for row in _rows(case)]
    pairs.sort(key=lambda row: (row["pose"], list(WAYS).index(row["way"])))
    rows = [
        {"pose": pose, "way": way, **_medians(list(group))}
        for (pose, way), group in groupby(pairs, key=lambda row: (row["pose"], row["way"]))
    ]
    return {"rows": rows, "pairs": pairs}


def _rows(case: Case) -> list[dict[str, Any]]:
    rows = []
    for name, way in WAYS.items():
        target = case.target.copy()
        target.data = case.target.data.copy()
        bpy.context.scene.collection.objects.link(target)
        seconds = way(case, target)
        rows.append({"shape": case.name, "pose": case.pose, "way": name, **figures(case, target), "seconds": seconds})
        bpy.data.meshes.remove(target.data)
    return rows


def _medians(rows: list[dict[str, Any]]) -> dict[str, float | None]:
    numbers = [name for name in rows[0] if name not in ("shape", "pose", "way")]
    known = {name: [row[name] for row in rows if row[name] is not None] for name in numbers}
    return {"shapes": len(rows), **{name: float(np.median(v)) if v else None for name, v in known.items()}}
