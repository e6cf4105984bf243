# SPDX-License-Identifier: GPL-3.0-or-later
"""Match one pair of a test list, and measure the map."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache
from hashlib import blake2b
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from benchmarks.curves import share_below
from benchmarks.official.lists import MAPS, NONE, OfficialList
from benchmarks.tables import Record
from zoomout_core.arrays import Booleans, Floats, Integers, SingleFloats
from zoomout_core.evaluation import distance_distortion, flipped_share
from zoomout_core.mesh.input_checks import vertex_numbers
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.runtime.threads import usable_cores

# Largest factor by which a scaled target is larger or smaller.
MAX_SCALE = 2.0
# Sources of at most this many vertices have the distances between all of them kept, of 4 bytes each.
MAX_KEPT = 10_000
# Rows of distances that are computed at once.
BLOCK = 500


@dataclass(frozen=True)
class Setting:
    """How the two shapes of a pair are placed before they are matched, at random but fixed by the pair.

    Attributes:
        rotate: each of the two is turned, by a rotation of its own.
        scale: the target is scaled, by a factor between one half and two.
    """

    rotate: bool = False
    scale: bool = False

    @property
    def name(self) -> str:
        return {
            (False, False): "as is",
            (True, False): "turned",
            (False, True): "scaled",
            (True, True): "turned and scaled",
        }[self.rotate, self.scale]

    def place(self, source: Surface, target: Surface, seed: int) -> tuple[Surface, Surface]:
        """Source and target as placed for a seed."""
        drawn = np.random.default_rng(seed)
        turns = [Rotation.random(random_state=drawn).as_matrix() for _ in range(2)]
        factor = MAX_SCALE ** drawn.uniform(-1, 1)
        if self.rotate:
            source, target = (
                shape.with_vertices(shape.vertices @ turn.T)
                for shape, turn in zip((source, target), turns, strict=True)
            )
        return source, target.with_vertices(target.vertices * factor) if self.scale else target


def measure(chosen: OfficialList, target_name: str, source_name: str, setting: Setting) -> Record:
    """The record of a pair: certainty, seconds, and how good the map is.

    With a truth, `error` is the mean geodesic error of all target vertices that have a partner, times 100, and `curve`
    the shares of `benchmarks.curves.share_below`. An image that no path connects to the partner counts as far as the
    vertex that is farthest from it. If the truth is a map, `IoU` is the intersection of the vertices that have a
    partner, by the result and by the truth, over their union.

    Without a truth, the map is compared with other maps that should agree with it; mean distances times 100: `turned`,
    `scaled` and `mirrored`, from shapes placed so; `cycle`, from the target by way of the source and a third shape back
    to itself; `distortion`, the mean change of geodesic distances.

    `flipped %` is the share of the target's area that the map turns over, nearly all if it exchanges left and right.
    `seconds` pass during the match; `processor seconds` depend less on what else the machine computes. `load` is the
    number of running threads for each core, averaged over a minute, or None on systems that do not count them.
    """
    source, target = (zo.read_surface(chosen.shape_file(name)) for name in (source_name, target_name))
    seed = seed_of(chosen.name, target_name, source_name)
    placed = setting.place(source, target, seed)
    zo.forget_shapes()
    begin, begin_processor = perf_counter(), process_time()
    result = zo.match(*placed)
    record: Record = {
        "seconds": perf_counter() - begin,
        "processor seconds": process_time() - begin_processor,
        "load": os.getloadavg()[0] / usable_cores() if hasattr(os, "getloadavg") else None,
        "certainty": result.certainty,
        "flipped %": 100 * flipped_share(result.surface_map, *placed),
    }
    vertex = result.surface_map.vertex
    if chosen.truth_kind == NONE:
        return record | _agreement(chosen, (target_name, source_name), placed, vertex, seed)
    at, truth = chosen.places(target_name, source_name)
    if chosen.truth_kind == MAPS and len(image := chosen.image(target_name, source_name)) != len(target.vertices):
        raise ValueError(
            f"The truth of {target_name} has {len(image)} entries, but the shape {len(target.vertices)} vertices: use "
            "the shape that the truth was made for."
        )
    at = vertex_numbers(at, len(target.vertices), f"The truth of {target_name}")
    truth = vertex_numbers(truth, len(source.vertices), f"The truth of {source_name}")
    errors = distances(chosen.shape_file(source_name), vertex[at], truth)
    record |= {"error": 100 * float(errors.mean()), "curve": np.round(share_below(1000 * errors), 4).tolist()}
    if chosen.truth_kind == MAPS:
        record["IoU"] = overlap(result.has_partner, chosen.image(target_name, source_name) >= 0)
    return record


def seed_of(*names: str) -> int:
    """A seed that depends on names alone."""
    return int.from_bytes(blake2b("\n".join(names).encode(), digest_size=4).digest(), "big")


def overlap(one: Booleans, other: Booleans) -> float:
    """Intersection over union of two masks (n,)."""
    return float((one & other).sum() / max((one | other).sum(), 1))


def distances(path: Path, image: Integers, truth: Integers) -> Floats:
    """(c,) distances along edges between vertices (c,) of a mesh file and others (c,), over the root of its area.

    Vertices without a path between them are as far apart as the second one and the vertex farthest from it.
    """
    found = np.empty(len(truth))
    for start in range(0, len(truth), BLOCK):
        block = slice(start, start + BLOCK)
        rows = _distances_from(path, truth[block])
        distance = rows[np.arange(len(rows)), image[block]]
        farthest = np.where(np.isfinite(rows), rows, 0).max(axis=1)
        found[block] = np.where(np.isfinite(distance), distance, farthest)
    return found


def _distances_from(path: Path, vertex: Integers) -> Floats:
    """(m, n) distances along edges from vertices (m,) of a mesh file, over the root of its area; infinite for none."""
    surface = zo.read_surface(path)
    if len(surface.vertices) <= MAX_KEPT:
        return _all_distances(path)[vertex].astype(float)
    return dijkstra(edge_graph(surface.vertices, surface.triangles), indices=vertex) / np.sqrt(surface.area)


@lru_cache(maxsize=1)
def _all_distances(path: Path) -> SingleFloats:
    """(n, n) the same from all vertices of a mesh file."""
    surface = zo.read_surface(path)
    graph, n = edge_graph(surface.vertices, surface.triangles), len(surface.vertices)
    found = np.empty((n, n), dtype=np.float32)
    for start in range(0, n, BLOCK):
        rows = np.arange(start, min(start + BLOCK, n))
        found[rows] = dijkstra(graph, indices=rows) / np.sqrt(surface.area)
    return found


# --- agreement ----------------------------------------------------------------------------------------------------


def _agreement(
    chosen: OfficialList, names: tuple[str, str], placed: tuple[Surface, Surface], vertex: Integers, seed: int
) -> Record:
    """How well a vertex map (n_t,) agrees with maps of the same shapes placed otherwise, and by way of a third one."""
    source, target = placed
    every = np.arange(len(vertex))
    found: Record = {}
    for name, (other_source, other_target) in {
        "turned": Setting(rotate=True).place(source, target, seed),
        "scaled": Setting(scale=True).place(source, target, seed),
        "mirrored": (_mirror(source), _mirror(target)),
    }.items():
        other = zo.match(other_source, other_target).surface_map.vertex
        found[name] = 100 * float(distances(chosen.shape_file(names[1]), other, vertex).mean())
    others = sorted({name for pair in chosen.pairs for name in pair} - set(names))
    if others:
        third = zo.read_surface(chosen.shape_file(others[seed % len(others)]))
        on_third = zo.match(third, source).surface_map.vertex
        on_target = zo.match(target, third).surface_map.vertex
        back = on_target[on_third[vertex]]
        found["cycle"] = 100 * float(distances(chosen.shape_file(names[0]), back, every).mean())
    return found | {"distortion": 100 * distance_distortion(vertex, every, source, target)}


def _mirror(surface: Surface) -> Surface:
    """The mirror image, whose faces are wound so that they face outwards still."""
    return Surface(surface.vertices * [-1, 1, 1], surface.triangles[:, ::-1])
