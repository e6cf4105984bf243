# SPDX-License-Identifier: GPL-3.0-or-later
"""Match hands, feet, heads and tails that are cut off a body to another whole body in the same unit."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import dijkstra
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.datasets import CORRESPONDENCE, PairOfParts
from benchmarks.tables import Record, Tables
from zoomout_core.arrays import Integers
from zoomout_core.matching.report.verdict import VERDICT
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph

# Mean error times 1000 above which a map counts as wrong, and number of known places at which it is measured.
LIMIT, PLACES = 40, 150
# Default number of pairs of each limb, and first random seed of their shapes and sizes.
PAIRS, SEED = 6, 7
# Range of factors of a limb's radius for the cut.
FACTORS = 0.9, 1.15


class Limb(NamedTuple):
    """A part of the bodies of a class.

    Attributes:
        folder: name of the set.
        body: prefix of the names of the class's shapes.
        name: of the limb.
        tip: index of its tip among the corresponding places.
        other_tip: index of the tip on the other side, if there is one.
        radius: geodesic distance of the cut from the tip, relative to the square root of the body's area.
    """

    folder: str
    body: str
    name: str
    tip: int
    other_tip: int | None
    radius: float


LIMBS = (
    Limb("faust_r", "tr_reg", "hand", 1, 3, 0.15),
    Limb("faust_r", "tr_reg", "other hand", 3, 1, 0.15),
    Limb("faust_r", "tr_reg", "foot", 2, 3559, 0.2),
    Limb("faust_r", "tr_reg", "head", 4, None, 0.24),
    Limb("faust_r", "tr_reg", "arm", 1, 3, 0.5),
    Limb("tosca_r", "michael", "hand", 1, 3, 0.13),
    Limb("tosca_r", "michael", "foot", 0, 2, 0.2),
    Limb("tosca_r", "michael", "head", 5, None, 0.24),
    Limb("tosca_r", "cat", "paw", 2, 2186, 0.2),
    Limb("tosca_r", "cat", "tail", 3909, None, 0.4),
    Limb("tosca_r", "horse", "hoof", 0, 3, 0.3),
    Limb("tosca_r", "horse", "head", 1, None, 0.3),
    Limb("smal_r", "", "paw", 1517, 3517, 0.25),
    Limb("smal_r", "", "head", 1863, None, 0.3),
    Limb("shrec19_r", "", "hand", 2435, 5831, 0.15),
    Limb("shrec19_r", "", "foot", 6531, 3230, 0.2),
    Limb("shrec19_r", "", "head", 412, None, 0.24),
)


def run(data: Path, pairs: int | None) -> Tables:
    """Match each limb of a shape with other shapes of its class.

    `rows`, for each limb: the share of pairs below `LIMIT`, the mean and the median over the pairs of the mean geodesic
    error times 1000, how many are mapped to the other side, how many have a certainty of 90 % and how many of these are
    right, and median seconds.

    Args:
        data: the folder of the sets.
        pairs: number of pairs of each limb.

    Returns:
        The tables by name, and under `pairs` a record for each pair.
    """
    records: list[Record] = []
    for limb in tqdm([limb for limb in LIMBS if (data / limb.folder / CORRESPONDENCE).is_file()], leave=False):
        with np.load(data / limb.folder / CORRESPONDENCE) as file:
            known = {name: file[name] for name in file if name.startswith(limb.body)}
        records += [_record(data / limb.folder, limb, known, number) for number in range(pairs or PAIRS)]
    return {"rows": _rows(records), "pairs": records}


def cut_limb(surface: Surface, tip: int, radius: float) -> tuple[Surface, Integers]:
    """The part of a surface within a geodesic distance of a vertex, and (n,) which vertices belong to it."""
    near = dijkstra(edge_graph(surface.vertices, surface.triangles), indices=[tip])[0] < radius
    inside = surface.triangles[near[surface.triangles].all(axis=1)]
    left, kept = Surface(surface.vertices, inside), np.unique(inside)
    # At the rim, geodesically close triangles may be connected only by single vertices.
    kept = kept[left.components[kept] == left.components[tip]]
    number = np.full(len(surface.vertices), -1)
    number[kept] = np.arange(len(kept))
    triangles = number[inside]
    return Surface(surface.vertices[kept], triangles[(triangles >= 0).all(axis=1)]), kept


def _record(folder: Path, limb: Limb, known: dict[str, Integers], number: int) -> Record:
    random = np.random.default_rng([SEED, number, *map(ord, limb.body + limb.name)])
    names = sorted(name for name in known if not name.endswith(".sym"))
    target_name, source_name = random.choice(names, 2, replace=False)
    body, source = (read_surface(folder / f"{name}.off") for name in (target_name, source_name))
    here, there = known[target_name], known[source_name]
    radius = limb.radius * random.uniform(*FACTORS) * np.sqrt(body.area)
    target, kept = cut_limb(body, int(here[limb.tip]), radius)
    place = np.full(len(body.vertices), -1)
    place[here] = np.arange(len(here))
    truth = np.where(place[kept] >= 0, there[place[kept]], -1)
    pair = PairOfParts(f"{target_name} {limb.name}", source, target, truth)
    zo.forget_shapes()
    begin = perf_counter()
    result = zo.match(source, target)
    seconds = perf_counter() - begin
    vertex = result.surface_map.vertex
    error = float(np.nanmean(pair.errors(vertex, PLACES)))
    image_of_tip = vertex[np.searchsorted(kept, here[limb.tip])]
    tips = there[[limb.tip] if limb.other_tip is None else [limb.tip, limb.other_tip]]
    to_tips = dijkstra(edge_graph(source.vertices, source.triangles), indices=[int(image_of_tip)])[0][tips]
    return {
        "set": folder.name,
        "limb": " ".join(filter(None, (limb.body, limb.name))),
        "target": target_name,
        "source": source_name,
        "vertices": len(kept),
        "error": error,
        "right": error < LIMIT,
        "other side": bool(np.argmin(to_tips) == 1 and error >= LIMIT),
        "certainty": result.certainty,
        "seconds": seconds,
    }


def _rows(records: list[Record]) -> list[Record]:
    rows = []
    for name, limb in dict.fromkeys((record["set"], record["limb"]) for record in records):
        chosen = [record for record in records if (record["set"], record["limb"]) == (name, limb)]
        sure = [record for record in chosen if record["certainty"] >= VERDICT.certain]
        errors = [record["error"] for record in chosen]
        rows.append(
            {
                "set": name,
                "limb": limb,
                "pairs": len(chosen),
                "right %": 100 * float(np.mean([record["right"] for record in chosen])),
                "mean": float(np.mean(errors)),
                "median": float(np.median(errors)),
                "other side": sum(record["other side"] for record in chosen),
                "announced": len(sure),
                "of these right": sum(record["right"] for record in sure),
                "seconds": float(np.median([record["seconds"] for record in chosen])),
            }
        )
    return rows
