# SPDX-License-Identifier: GPL-3.0-or-later
"""ZoomOut on parts of shapes, compared with methods for partial matching."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.baselines.bcicp import Side
from benchmarks.baselines.cpd import cpd
from benchmarks.baselines.fc import fc
from benchmarks.baselines.gtm import gtm
from benchmarks.baselines.pfm import Partial, first_map, pfm
from benchmarks.curves import draw_curves, share_below
from benchmarks.datasets import PairOfParts, kind_of_part, part_names, region_of, sets_of_parts_in
from benchmarks.stored import read_or_compute
from benchmarks.tables import Record, Tables
from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.triangles import vertex_areas

# Kinds of missing pieces that are measured.
KINDS = ("cuts", "holes", "missing pieces")
# Size of PFM's functional map, initial and final number of the whole's functions for ZoomOut, and its step.
K, K_INITIAL, STEP = 100, 20, 4
# More functions are computed of the part than are used of the whole: as low as the whole's last one may be up to these.
K_BASIS = 110
# Radius of the SHOT descriptors, relative to the square root of the source's area.
RADIUS = 0.09
# Number of known places at which a map is measured, and mean error times 1000 above which it counts as wrong.
PLACES, LIMIT = 500, 80
# Factor by which the target is scaled if units are to differ: inches to millimetres.
ANOTHER_UNIT = 25.4
# Number of pairs of each kind for slow methods.
FEW = 3
# Melzi et al. 2019: seconds on SHREC'16 cuts. The paper shows errors only as curves.
PUBLISHED_SECONDS = {"PFM": 70.0, "ZoomOut": 6.0}


@dataclass(frozen=True, eq=False)
class Part(PairOfParts):
    """A part and a whole in another pose, with the inputs that methods share."""

    @cached_property
    def share(self) -> float:
        """The target's area over the source's."""
        return self.target.area / self.source.area

    @cached_property
    def sides(self) -> tuple[Side, Side]:
        """Source and target at unit area, each with its eigenfunctions."""
        return Side(self.source, zo.eigenbasis(self.source, K_BASIS)), Side(
            self.target, zo.eigenbasis(self.target, min(K_BASIS, len(self.target.vertices) - 1))
        )

    @cached_property
    def descriptors(self) -> tuple[Floats, Floats]:
        """(n_s, 352) and (n_t, 352) SHOT within balls of one size."""
        return zo.shot(self.source, RADIUS), zo.shot(self.target, RADIUS / np.sqrt(self.share))

    @cached_property
    def by_pfm(self) -> Partial:
        """The result of PFM."""
        return pfm(*self.sides, *self.descriptors, K)

    @cached_property
    def initial(self) -> Integers:
        """(n_t,) PFM's initial map, before it estimates a region."""
        return first_map(*self.sides, *self.descriptors, K)


class Method(NamedTuple):
    """A method of partial matching.

    Attributes:
        vertex: computes (n_t,) the source vertex of each target vertex of a part; -1 for none.
        needs: the inputs that it uses, each after those that it depends on.
        is_slow: measured on few pairs only.
    """

    vertex: Callable[[Part], Integers]
    needs: tuple[str, ...] = ()
    is_slow: bool = False


def _zoomout(part: Part, start: Integers) -> Integers:
    """ZoomOut with rectangular (slanted) functional maps, on all vertices."""
    source, target = (side.basis for side in part.sides)
    target = target.at_area(part.share)
    sizes = zo.slanted_sizes(source, target, K_INITIAL, min(K, len(target.eigenvalues)), STEP)
    return zo.zoomout(source, target, start, sizes=sizes, samples=None).vertex


def _match(part: Part, times: float = 1.0) -> Integers:
    zo.forget_shapes()
    return zo.match(part.source, part.target.with_vertices(times * part.target.vertices)).surface_map.vertex


FROM_DESCRIPTORS = ("sides", "descriptors")
METHODS: dict[str, Method] = {
    "initial": Method(lambda part: part.initial, (*FROM_DESCRIPTORS, "initial")),
    "PFM": Method(lambda part: part.by_pfm.vertex, (*FROM_DESCRIPTORS, "by_pfm"), is_slow=True),
    "GTM": Method(lambda part: gtm(part.source, part.target), is_slow=True),
    "FC": Method(lambda part: fc(*part.sides), ("sides",), is_slow=True),
    "CPD": Method(lambda part: cpd(part.source.vertices, part.target.vertices), is_slow=True),
    "ZoomOut": Method(lambda part: _zoomout(part, part.initial), (*FROM_DESCRIPTORS, "initial")),
    "ZoomOut after PFM": Method(
        lambda part: _zoomout(part, part.by_pfm.vertex), (*FROM_DESCRIPTORS, "by_pfm"), is_slow=True
    ),
    "zo.match, nothing given": Method(_match),
    "the same, units differ": Method(lambda part: _match(part, ANOTHER_UNIT)),
}


def run(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Match the parts of the sets in a folder to their wholes with every method.

    `rows`, for each kind of part and each method: mean and median over the pairs of the mean geodesic error times 1000,
    the share of pairs below `LIMIT`, the mean share of the true region that images cover, median seconds including all
    that the method needs (bases, descriptors, initial map), and the published seconds. Slow methods run on `FEW`
    pairs of each kind, next to the mean of ZoomOut on the same pairs. A target vertex without an image counts in the
    curves as an infinite error, and is left out of the mean error.

    Args:
        data: the folder of the sets, or a set.
        pairs: number of pairs of each, evenly spread over the list.
        figure: an image file for the share of places below each error.

    Returns:
        The tables by name, and under `pairs` a record for each pair and method, with its curve (`benchmarks.curves`).
    """
    records: list[Record] = []
    seen = dict.fromkeys(KINDS, 0)
    for folder in sets_of_parts_in(data):
        for name in tqdm(part_names(folder, pairs, KINDS), desc=folder.name, leave=False):
            kind = kind_of_part(name)
            with_slow = seen[kind] < FEW
            seen[kind] += 1
            records += read_or_compute(
                (name, *(["slow"] if with_slow else [])), partial(_of_name, folder, name, with_slow)
            )
    if not records:
        return {"rows": []}
    if figure is not None:
        _draw(records, figure)
    return {"rows": _rows(records), "pairs": records}


def _of_name(folder: Path, name: str, with_slow: bool) -> list[Record]:
    part = Part.load(folder, name)
    took: dict[str, float] = {}
    records: list[Record] = []
    for method, (vertex_of, needs, is_slow) in METHODS.items():
        if is_slow and not with_slow:
            continue
        for need in needs:
            if need not in took:
                begin = perf_counter()
                getattr(part, need)
                took[need] = perf_counter() - begin
        begin = perf_counter()
        vertex = vertex_of(part)
        seconds = perf_counter() - begin + sum(took[need] for need in needs)
        records.append({"set": part.kind, "pair": part.name, "method": method, "seconds": seconds})
        records[-1] |= figures(vertex, part)
    return records


def figures(vertex: Integers, part: PairOfParts) -> Record:
    """The figures of a vertex map (n_t,)."""
    errors = part.errors(vertex, PLACES)
    known = np.flatnonzero(part.truth >= 0)
    reached = region_of(vertex[known[vertex[known] >= 0]], part.source)
    areas = vertex_areas(part.source.vertices, part.source.triangles)
    return {
        "error": float(np.nanmean(errors)),
        "covered %": 100 * float(areas[part.region & reached].sum() / areas[part.region].sum()),
        "curve": share_below(errors),
    }


def _rows(records: list[Record]) -> list[Record]:
    rows = []
    for kind, method in dict.fromkeys((record["set"], record["method"]) for record in records):
        chosen = [record for record in records if (record["set"], record["method"]) == (kind, method)]
        errors = np.array([record["error"] for record in chosen])
        pairs = {record["pair"] for record in chosen}
        beside = [record["error"] for record in records if record["method"] == "ZoomOut" and record["pair"] in pairs]
        rows.append(
            {
                "set": kind,
                "method": method,
                "pairs": len(chosen),
                "mean": float(errors.mean()),
                "ZoomOut there": float(np.mean(beside)),
                "median": float(np.median(errors)),
                "right %": 100 * float((errors < LIMIT).mean()),
                "covered %": float(np.mean([record["covered %"] for record in chosen])),
                "seconds": float(np.median([record["seconds"] for record in chosen])),
                "published s": PUBLISHED_SECONDS.get(method) if kind == "cuts" else None,
            }
        )
    return rows


def _draw(records: list[Record], figure: Path) -> None:
    """Cumulative curves, a panel for each kind."""
    panels: dict[str, dict[str, Floats]] = {}
    for kind, method in dict.fromkeys((record["set"], record["method"]) for record in records):
        curves = [r["curve"] for r in records if (r["set"], r["method"]) == (kind, method)]
        panels.setdefault(kind, {})[method] = np.mean(curves, axis=0)
    draw_curves(figure, panels)
