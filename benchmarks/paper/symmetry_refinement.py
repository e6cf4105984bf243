# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's table of symmetries: the same initial map of each shape onto itself, refined by several methods.

The initial map is fitted to wave kernel signatures, with the sign of the orientation operators reversed, at size 10
(OrientRev); ZoomOut takes it to size 100.
"""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.baselines.bcicp import Side, bcicp
from benchmarks.baselines.sampled_zoomout import sampled_zoomout
from benchmarks.datasets import MAX_PLACES, mirrored_places, sets_in, shapes_with_symmetry
from benchmarks.paper.refinement_methods import K_FIXED
from benchmarks.paper.starts import K_SIGNATURES
from benchmarks.tables import Record
from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.functional_map import vertex_map_of
from zoomout_core.mesh.surface import Surface

INITIAL, FINAL, STEP, SAMPLES = 10, 100, 5, 500
# Sets of people, and maximum number of shapes, which take 6 s each.
SETS, MAX_SHAPES = ("faust_r",), 10
START, BCICP, ZOOMOUT, SAMPLED = "OrientRev", "OrientRev + BCICP", "OrientRev + ZoomOut", "OrientRev + ZoomOut*"
# Melzi et al. 2019: mean errors on FAUST in its original meshes and on SCAPE, and seconds on FAUST.
PUBLISHED: dict[str, tuple[float, float, float]] = {
    "BIM": (65.4, 133, 34.6),
    "GroupRep": (224, 347, 8.5),
    "IntSymm": (33.9, 60.3, 1.35),
    START: (68.0, 110, 0.59),
    BCICP: (29.2, 49.7, 195),
    ZOOMOUT: (16.1, 46.2, 22.6),
    SAMPLED: (18.5, 46.6, 1.8),
}


def records_of(data: Path, shapes: int | None) -> list[Record]:
    """A record for each method and shape of the sets of people: mean error times 1000, and seconds without the basis.

    Args:
        data: the folder of the sets.
        shapes: number of shapes of each set, evenly spread; ten at most.
    """
    records: list[Record] = []
    for folder in sets_in(data):
        if folder.name in SETS:
            names = shapes_with_symmetry(folder, min(shapes or MAX_SHAPES, MAX_SHAPES))
            for name in tqdm(names, desc=f"{folder.name}, refined", leave=False):
                surface, vertex, mirrored = mirrored_places(folder, name)
                for method, (image, seconds) in _refine(surface).items():
                    error = float(1000 * np.mean(zo.geodesic_error(image, surface, vertex, mirrored, MAX_PLACES)))
                    about = {"set": folder.name, "shape": name, "method": method}
                    records.append(about | {"error": error, "seconds": seconds})
    return records


def rows_of(records: list[Record]) -> list[Record]:
    """For each of the paper's methods its figures, and our mean and median error and median seconds."""
    rows = []
    for method, (faust, scape, seconds) in PUBLISHED.items():
        ours = [record for record in records if record["method"] == method]
        errors = [record["error"] for record in ours]
        rows.append(
            {
                "method": method,
                "published FAUST": faust,
                "published SCAPE": scape,
                "published s": seconds,
                "shapes": len(ours) or None,
                "mean": float(np.mean(errors)) if ours else None,
                "median": float(np.median(errors)) if ours else None,
                "seconds": float(np.median([record["seconds"] for record in ours])) if ours else None,
            }
        )
    return rows


def reversing(surface: Surface, basis: zo.SpectralBasis) -> Floats:
    """(10, 10) the functional map of a surface onto itself fitted to signatures, with reversed orientation."""
    signatures = zo.wave_kernel_signature(basis)
    operators = zo.orientation_operators(surface, basis, signatures, INITIAL)
    return zo.fit_functional_map(
        basis,
        basis,
        signatures,
        signatures,
        INITIAL,
        orientation_operators=(operators, operators),
        orientation="reverse",
    )


def _refine(surface: Surface) -> dict[str, tuple[Integers, float]]:
    """The image (n,) of each vertex and the seconds, by method."""
    basis = zo.eigenbasis(surface, K_SIGNATURES)
    begin = perf_counter()
    start = reversing(surface, basis)
    initial = vertex_map_of(start, basis, basis)
    maps = {START: (initial, perf_counter() - begin)}
    side = Side(surface, basis)
    begin = perf_counter()
    maps[ZOOMOUT] = zo.zoomout(basis, basis, start, FINAL, STEP, samples=None).vertex, perf_counter() - begin
    begin = perf_counter()
    maps[SAMPLED] = sampled_zoomout(basis, basis, start, FINAL, STEP, SAMPLES).vertex, perf_counter() - begin
    begin = perf_counter()
    there, _ = bcicp(side, side, initial, initial, K_FIXED)
    maps[BCICP] = there.vertex, perf_counter() - begin
    return maps
