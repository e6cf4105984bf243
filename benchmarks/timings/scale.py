# SPDX-License-Identifier: GPL-3.0-or-later
"""Growth of the cost of a match with the vertices, the eigenfunctions and the samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import matplotlib
import numpy as np

import zoomout_core as zo
from benchmarks.timings.speed import subdivide_triangles, time_match
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.surface import Surface

Record = dict[str, Any]

REPEATS = 3
PAIR = "michael0", "michael10"
DECIMATED = 5000, 13_000
SUBDIVIDED = 0, 1, 2
# Larger meshes compute eigenfunctions on proxies.
MAX_FOR_FULL_BASIS = 250_000
FUNCTIONS = 50, 100, 200, 400
SAMPLES = 500, 1000, 2000, 4000
# Growth is also fitted to meshes of at least this size, on which reading and extending the map dominate.
LARGE = 50_000


def run(data: Path, pairs: int | None, figure: Path | None) -> dict[str, list[Record]]:
    """Time each stage at several sizes, and fit cost = constant * size ** exponent.

    Args:
        data: the folder of the sets.
        pairs: number of sizes of the meshes, the smallest first.
        figure: an image file for the growth with the vertices, on logarithmic axes.

    Returns:
        `rows`: for each quantity and variable the exponent, fitted to all sizes and to the large ones alone.
        `points`: the measurements.
    """
    meshes = [*_sizes(data)][:pairs]
    if not meshes:
        return {"rows": []}
    points = [*_over_vertices(meshes), *_over_functions(meshes[0][0]), *_over_samples(meshes[0])]
    rows = []
    for over, what in dict.fromkeys((point["over"], point["what"]) for point in points):
        of_both = [
            (point["size"], point["seconds"]) for point in points if (point["over"], point["what"]) == (over, what)
        ]
        large = [(size, seconds) for size, seconds in of_both if size >= LARGE]
        rows.append(
            {
                "what": what,
                "over": over,
                "exponent": _exponent(of_both),
                f"from {LARGE} on": _exponent(large) if over == "vertices" else None,
                "smallest": of_both[0][0],
                "largest": of_both[-1][0],
            }
        )
    if figure is not None:
        _draw([point for point in points if point["over"] == "vertices"], figure)
    return {"rows": rows, "points": points}


def _sizes(data: Path) -> Iterator[tuple[Surface, Surface]]:
    """One pair of meshes at several sizes."""
    paths = [data / "tosca_full" / f"{name}.off" for name in PAIR]
    if not all(path.is_file() for path in paths):
        return
    surfaces = [read_surface(path) for path in paths]
    for count in DECIMATED:
        yield tuple(Surface(*decimate(s.vertices, s.triangles, count)[:2]) for s in surfaces)  # type: ignore[misc]
    for levels in SUBDIVIDED:
        yield tuple(subdivide_triangles(surface, levels, seed) for seed, surface in enumerate(surfaces))  # type: ignore[misc]


def _over_vertices(meshes: list[tuple[Surface, Surface]]) -> Iterator[Record]:
    for source, target in meshes:
        n = len(target.vertices)
        runs = [time_match(source, target) for _ in range(REPEATS)]
        yield _point("vertices", "match", n, median(run.seconds for run in runs))
        for stage in runs[0].stages:
            yield _point("vertices", stage.lower(), n, median(run.stages[stage] for run in runs))
        if n < MAX_FOR_FULL_BASIS:
            fresh = Surface(target.vertices, target.triangles)
            yield _point("vertices", "full eigenbasis, k = 200", n, _seconds(partial(zo.eigenbasis, fresh)))


def _over_functions(surface: Surface) -> Iterator[Record]:
    for k in FUNCTIONS:
        yield _point("functions", "full eigenbasis", k, _seconds(partial(zo.eigenbasis, surface, k)))
    basis = zo.eigenbasis(surface, max(FUNCTIONS))
    start = np.eye(20)
    for k in FUNCTIONS:
        seconds = _seconds(partial(zo.zoomout, basis, basis, start, k, samples=max(SAMPLES)))
        yield _point("functions", f"zoomout, {max(SAMPLES)} samples", k, seconds)


def _over_samples(pair: tuple[Surface, Surface]) -> Iterator[Record]:
    source, target = (zo.eigenbasis(surface, 200) for surface in pair)
    start = np.eye(20)
    for samples in SAMPLES:
        seconds = _seconds(partial(zo.zoomout, source, target, start, 200, samples=samples))
        yield _point("samples", "zoomout to 200", samples, seconds)


def _seconds(work: Callable[[], object]) -> float:
    taken = []
    for _ in range(REPEATS):
        start = perf_counter()
        work()
        taken.append(perf_counter() - start)
    return median(taken)


def _point(over: str, what: str, size: int, seconds: float) -> Record:
    return {"over": over, "what": what, "size": size, "seconds": seconds}


def _exponent(points: list[tuple[int, float]]) -> float | None:
    if len(points) < 2:
        return None
    sizes, seconds = np.log(np.array(points)).T
    return float(np.polyfit(sizes, seconds, 1)[0])


def _draw(points: list[Record], figure: Path) -> None:
    matplotlib.use("Agg")
    from matplotlib import pyplot

    fig, axes = pyplot.subplots(figsize=(7, 5), layout="constrained")
    for what in dict.fromkeys(point["what"] for point in points):
        of_it = np.array([(point["size"], point["seconds"]) for point in points if point["what"] == what])
        axes.loglog(*of_it.T, marker="o", linewidth=2.5 if what == "match" else 1, label=what)
    sizes = np.array([min(point["size"] for point in points), max(point["size"] for point in points)])
    least = min(point["seconds"] for point in points if point["what"] == "match")
    axes.loglog(sizes, least * sizes / sizes[0], "k:", linewidth=1, label="proportional to the vertices")
    axes.set(xlabel="vertices of each mesh", ylabel="seconds, cold, 2 cores")
    axes.grid(which="both", alpha=0.3)
    axes.legend(fontsize="small")
    fig.savefig(figure, dpi=120)
    pyplot.close(fig)
