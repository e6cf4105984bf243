# SPDX-License-Identifier: GPL-3.0-or-later
"""Time of a match, from a few thousand vertices to a million, compared with pyFMaps on the same pairs in one run."""

from __future__ import annotations

import gc
import resource
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
from pyFM.mesh import TriMesh
from pyFM.refine.zoomout import zoomout_refine
from pyFM.spectral import FM_to_p2p
from trimesh.remesh import subdivide

import zoomout_core as zo
from benchmarks.datasets import load_pair
from zoomout_core.arrays import Floats, Integers
from zoomout_core.matching.presets import DETAIL
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.surface import Surface

Record = dict[str, Any]

REPEATS = 3
# The peer: sizes of its maps, number of samples, and the largest meshes that it finishes within ten minutes.
K_INITIAL, K_FINAL, STEP, SAMPLES = 20, 200, 5, 1000
MAX_FOR_PEER = 60_000
# Noise of subdivided meshes relative to their mean edge, so that the spectra are not exactly equal.
NOISE = 0.05


@dataclass(frozen=True)
class SizedPair:
    """Two meshes with corresponding places.

    Attributes:
        name: of the pair.
        target: the surface to be mapped.
        source: the surface with the images.
        target_vertex: (c,) vertices of the target.
        source_vertex: (c,) their true images on the source.
    """

    name: str
    target: Surface
    source: Surface
    target_vertex: Integers
    source_vertex: Integers

    def error(self, vertex: Integers) -> float:
        """Mean Euclidean error of a vertex map (n_t,), relative to the square root of the area, times 1000."""
        off = self.source.vertices[vertex[self.target_vertex]] - self.source.vertices[self.source_vertex]
        return float(1000 * np.linalg.norm(off, axis=1).mean() / np.sqrt(self.source.area))


def run(data: Path, pairs: int | None) -> dict[str, list[Record]]:
    """Compute the tables.

    `rows`, for each pair and library: median seconds of a match of two new meshes, and of another
    match with the same source; the longest time between two progress reports; the mean error; the peak memory of
    the process meanwhile (`peak MB`), which includes modules and the pair's meshes. The peer gets the true map of
    size 20, ours no hints.

    `stages`: seconds of each stage of the first match.

    Args:
        data: the folder of the sets; missing sets are left out.
        pairs: number of pairs, the smallest first.
    """
    rows: list[Record] = []
    stages: list[Record] = []
    for number, pair in enumerate(sized_pairs(data)):
        if number == pairs:
            break
        for system, measured in SYSTEMS.items():
            if system != "pyFMaps" or len(pair.target.vertices) <= MAX_FOR_PEER:
                _forget_peak()
                row, of_stages = measured(pair)
                about = {"pair": pair.name, "vertices": len(pair.target.vertices), "system": system}
                rows.append(about | row | {"peak MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024})
                stages += [about | {"stage": stage, "seconds": seconds} for stage, seconds in of_stages.items()]
    return {"rows": rows, "stages": stages}


def _forget_peak() -> None:
    """Have the peak memory of the process start from what it uses now; only Linux can, elsewhere it is that so far."""
    gc.collect()
    with suppress(FileNotFoundError):
        Path("/proc/self/clear_refs").write_text("5")


def sized_pairs(data: Path) -> Iterator[SizedPair]:
    """Pairs of meshes from a few thousand to a million vertices, the smallest first."""
    if (data / "tosca_r").is_dir():
        pair = load_pair(data / "tosca_r", "horse0", "horse6")
        yield SizedPair("horse0 horse6, remeshed", pair.target, pair.source, pair.target_vertex, pair.source_vertex)
    # Meshes of one class have the same vertex order, so the identity is the truth.
    for names, levels in ((("horse0", "horse6"), 0), *((("michael0", "michael10"), level) for level in range(3))):
        paths = [data / "tosca_full" / f"{name}.off" for name in names]
        if all(path.is_file() for path in paths):
            target, source = (subdivide_triangles(read_surface(path), levels, seed) for seed, path in enumerate(paths))
            identity = np.arange(len(target.vertices))
            name = " ".join(names) + f", subdivided {levels} times" * (levels > 0)
            yield SizedPair(name, target, source, identity, identity)


def subdivide_triangles(surface: Surface, levels: int, seed: int) -> Surface:
    """Subdivide each triangle into four, several times, and add noise."""
    vertices, triangles = surface.vertices, surface.triangles
    for _ in range(levels):
        vertices, triangles = subdivide(vertices, triangles)
        edge = np.linalg.norm(vertices[triangles[:, 0]] - vertices[triangles[:, 1]], axis=1).mean()
        vertices = vertices + NOISE * edge * np.random.default_rng(seed).standard_normal(vertices.shape)
    return Surface(vertices, triangles)


@dataclass(frozen=True)
class TimedMatch:
    """A match and its times.

    Attributes:
        seconds: total time.
        stages: seconds of each stage.
        longest_wait: the longest time between two progress reports.
        result: of the match.
    """

    seconds: float
    stages: dict[str, float]
    longest_wait: float
    result: zo.MatchResult


def time_match(source: Surface, target: Surface, warm: bool = False, detail: str = "balanced") -> TimedMatch:
    """Match two meshes as loaded from a file, with a preset; if `warm`, the source has been matched before."""
    options: dict[str, Any] = DETAIL[detail]
    zo.forget_shapes()
    source, target = (Surface(surface.vertices, surface.triangles) for surface in (source, target))
    if warm:
        zo.match(source, source, **options)
    stage, longest = "Reading the meshes", 0.0
    stages: dict[str, float] = {}
    start = last = perf_counter()

    def enter(title: str) -> None:
        nonlocal stage, longest, last
        now = perf_counter()
        stages[stage] = stages.get(stage, 0.0) + now - last
        stage, longest, last = title or stage, max(longest, now - last), now

    result = zo.match(source, target, progress=lambda progress: enter(progress.stage), **options)
    enter("")
    return TimedMatch(last - start, stages, longest, result)


def _ours(pair: SizedPair, detail: str) -> tuple[Record, dict[str, float]]:
    runs = [time_match(pair.source, pair.target, False, detail) for _ in range(REPEATS)]
    warm = [time_match(pair.source, pair.target, True, detail) for _ in range(REPEATS)]
    return {
        "seconds": median(run.seconds for run in runs),
        "warm source": median(run.seconds for run in warm),
        "longest wait": median(run.longest_wait for run in runs),
        "mean error": pair.error(runs[-1].result.surface_map.vertex),
    }, {stage: median(run.stages[stage] for run in runs) for stage in runs[0].stages}


def _peer(pair: SizedPair) -> tuple[Record, dict[str, float]]:
    """Run pyFMaps with its own eigenbases and samples, from the true map."""
    stages: dict[str, float] = {}

    def time_stage(stage: str, work: Callable[[], Any]) -> Any:
        start = perf_counter()
        done = work()
        stages[stage] = perf_counter() - start
        return done

    source, target = (TriMesh(surface.vertices, surface.triangles) for surface in (pair.source, pair.target))
    time_stage("eigenbases", lambda: [mesh.process(k=K_FINAL, verbose=False) for mesh in (source, target)])
    samples = time_stage("sampling", lambda: [mesh.farthest_point_sampling(SAMPLES) for mesh in (source, target)])
    rows: list[Floats] = [source.eigenvectors[pair.source_vertex], target.eigenvectors[pair.target_vertex]]
    start = np.linalg.lstsq(rows[1][:, :K_INITIAL], rows[0][:, :K_INITIAL], rcond=None)[0]
    eigenvectors = source.eigenvectors, target.eigenvectors

    def refine() -> Integers:
        C = zoomout_refine(start, *eigenvectors, nit=(K_FINAL - K_INITIAL) // STEP, step=STEP, subsample=samples)
        return np.asarray(FM_to_p2p(C, *eigenvectors))

    vertex = time_stage("refinement and map", refine)
    seconds = sum(stages.values())
    return {"seconds": seconds, "warm source": None, "longest wait": None, "mean error": pair.error(vertex)}, stages


SYSTEMS: dict[str, Callable[[SizedPair], tuple[Record, dict[str, float]]]] = {
    "zoomout_core": partial(_ours, detail="balanced"),
    "zoomout_core, fine": partial(_ours, detail="fine"),
    "pyFMaps": _peer,
}
