# SPDX-License-Identifier: GPL-3.0-or-later
"""Characters of many loose parts: accuracy of bones, limbs and places, and calibration of the match."""

from __future__ import annotations

from pathlib import Path

from tqdm import tqdm

from benchmarks.characters.cases import cases
from benchmarks.characters.pictures import Picture, draw
from benchmarks.characters.table import Row, badness, measure, summary

# Number of worst cases to draw for each kind.
WORST = 8


def run(data: Path, pairs: int | None, picture_folder: Path | None) -> dict[str, list[Row]]:
    """Match each case without hints.

    `rows`, for each case: loose parts of source and target, seconds of a cold match, certainty, mean confidence; by
    weights: the shares of the target with the right strongest bone and the right limb, of the sided limbs the share
    that is mapped to the other side, mean L1 error; or mean and median error in centimetres. The same for Blender's
    Data Transfer (DT), whether the case is right, and whether it is worse than Data Transfer.

    `summary`: these for each kind of case.

    Args:
        data: the folder of the sets, with characters among them.
        pairs: approximate number of cases of each kind, evenly spread.
        picture_folder: for pictures of the worst cases of each kind.
    """
    rows: list[Row] = []
    worst: dict[str, list[tuple[float, Picture]]] = {}
    for case in tqdm(cases(data / "characters", pairs), desc="characters", leave=False):
        row, result = measure(case)
        rows.append(row)
        if picture_folder is not None:
            of_kind = [*worst.get(case.kind, []), (badness(row), Picture(row, case, result))]
            worst[case.kind] = sorted(of_kind, key=lambda entry: -entry[0])[:WORST]
    for kind, entries in worst.items():
        if picture_folder is not None:
            draw(picture_folder / f"{kind}.png", [picture for _, picture in entries])
    return {"rows": rows, "summary": summary(rows) if rows else []}
