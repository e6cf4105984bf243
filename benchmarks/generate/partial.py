# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets whose targets lack a part of the source, or have a part that the source lacks.

Extremities are found by geodesic farthest point sampling (Eldar et al. 1997); a limb's thickness is estimated from
the areas of slices between two distances from its extremity.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import cycle, groupby
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree
from tqdm import tqdm

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph, vertex_areas, vertex_normals

from .folder import Pair, class_of, spread, write_set

# Number of extremities; the first farthest points are at the ends of the longest limbs.
TIPS = 5
# Range of the cut of a limb and of its end, relative to half the distance to the nearest other extremity.
LIMB, END, SLICE = (0.5, 1.0), (0.2, 0.45), 0.05
# Lengths relative to the square root of the area.
HOLE_RADIUS, HOLES = 0.05, 6
TAIL_RADIUS, TAIL_LENGTH = 0.055, 0.7
HORN_RADIUS, HORN_LENGTH = 0.035, 0.25
# Distance between horns, and its maximum from the end of the head (a tail is too thin for that); a vertex that is
# nearer to its mirror image than the last number is in the middle.
APART, ON_HEAD, MIDDLE = 0.12, 0.15, 0.04
# Bend of the axis of an added part, relative to its length, and thickness of its tip, relative to its base.
BEND, TIP = 0.3, 0.3


@dataclass(frozen=True, eq=False)
class Whole:
    """A mesh of a set with its known places.

    Attributes:
        surface: the mesh.
        places: (c,) vertices that correspond on all meshes of the class.
        mirrored: (c,) the places' mirror images, if the set has them.
    """

    surface: Surface
    places: Integers
    mirrored: Integers | None

    @property
    def unit(self) -> float:
        """The square root of the area."""
        return float(np.sqrt(self.surface.area))


@dataclass(frozen=True, eq=False)
class Changed:
    """A mesh that has lost or gained a part.

    Attributes:
        surface: the mesh.
        vertex_of: (n,) its vertex for each vertex of the whole mesh; -1 for removed ones.
        gained: (n',) which of its vertices were added.
    """

    surface: Surface
    vertex_of: Integers
    gained: Booleans


def write_partial(output: Path, data: Iterable[Path], seed: int, count: int) -> None:
    """Write pairs of a changed mesh and a whole one of another pose, and `partial.npz`.

    The latter lists for each mesh which of its vertices (n,) have no partner on the other mesh of the pair.

    Args:
        output: folder of the set.
        data: folders of sets with `pairs.txt` and `correspondence.npz`, whose pairs are modified.
        seed: for all random choices.
        count: number of pairs for each class, evenly spread over the set's list.
    """
    meshes: dict[str, Surface] = {}
    correspondence: dict[str, Integers] = {}
    alone: dict[str, Any] = {}
    pairs: list[Pair] = []
    for folder in data:
        random = np.random.default_rng([seed, *folder.name.encode()])
        chosen = _pairs_by_class(folder, count)
        for (first, second), change in tqdm(list(zip(chosen, cycle(CHANGES), strict=False)), desc=folder.name):
            name = f"{first}_{second}_{change}"
            target, source = load_whole(folder, first), load_whole(folder, second)
            changed = CHANGES[change](target, random)
            vertex = changed.vertex_of[target.places]
            lost = vertex < 0
            meshes |= {name: changed.surface, f"{name}_whole": source.surface}
            correspondence |= {name: vertex[~lost], f"{name}_whole": source.places[~lost]}
            if source.mirrored is not None:
                correspondence[f"{name}_whole.sym"] = source.mirrored[~lost]
            nearest = cKDTree(source.surface.vertices[source.places]).query(source.surface.vertices)[1]
            alone |= {name: changed.gained, f"{name}_whole": lost[nearest]}
            pairs.append((name, f"{name}_whole"))
    write_set(output, meshes, correspondence, pairs)
    np.savez_compressed(output / "partial.npz", **alone)


def _pairs_by_class(folder: Path, count: int) -> list[Pair]:
    lines = (folder / "pairs.txt").read_text().splitlines()
    listed = sorted((line.split() for line in lines if line.strip()), key=lambda pair: class_of(pair[0]))
    groups = [[(a, b) for a, b in group] for _, group in groupby(listed, key=lambda pair: class_of(pair[0]))]
    return [pair for group in groups for pair in spread(group, count)]


def load_whole(folder: Path, name: str) -> Whole:
    """A mesh of a set with `correspondence.npz`."""
    with np.load(folder / "correspondence.npz") as known:
        mirrored = known.get(f"{name}.sym")
        return Whole(read_surface(folder / f"{name}.off"), known[name], mirrored)


# --- changes ------------------------------------------------------------------------------------------------


def without_limb(whole: Whole, random: np.random.Generator) -> Changed:
    """Remove one limb, or head and neck, up to where it widens into the trunk."""
    return _severed(whole, LIMB, lambda area: int(np.argmax(np.diff(area))), random)


def without_end(whole: Whole, random: np.random.Generator) -> Changed:
    """Remove the end of a limb, such as a hand, up to where the limb is thinnest."""
    return _severed(whole, END, lambda area: int(np.argmin(area)), random)


def with_holes(whole: Whole, random: np.random.Generator) -> Changed:
    """Cut round holes into the surface."""
    centres = random.choice(whole.places, HOLES, replace=False)
    near = _distances(whole.surface, centres).min(axis=0) < HOLE_RADIUS * whole.unit
    return _without(_unchanged(whole.surface), near)


def with_tail(whole: Whole, random: np.random.Generator) -> Changed:
    """Add a limb to the trunk that the source lacks, in the middle if the shape has one."""
    places = whole.places if whole.mirrored is None else whole.places[_in_middle(whole)]
    remoteness = _remoteness(whole, random)[places]
    centre = int(random.choice(places[remoteness <= np.quantile(remoteness, 0.1)]))
    length = TAIL_LENGTH * whole.unit
    return _grown(_unchanged(whole.surface), centre, TAIL_RADIUS * whole.unit, length, random)


def with_horns(whole: Whole, random: np.random.Generator) -> Changed:
    """Add two horns to the head, or anywhere on shapes without left and right."""
    if whole.mirrored is None:
        first = int(random.choice(whole.places))
        amiss = np.abs(_distances(whole.surface, [first])[0] - APART * whole.unit)
        centres = np.array([first, np.argmin(amiss)])
    else:
        ends = _ends_in_middle(whole, random)
        on_head = _distances(whole.surface, ends)[:, whole.places].min(axis=0) < ON_HEAD * whole.unit
        amiss = np.where(on_head, np.abs(_apart(whole) - APART * whole.unit), np.inf)
        best = int(np.argmin(amiss))
        centres = np.array([whole.places[best], whole.mirrored[best]])
    changed = _unchanged(whole.surface)
    for centre in centres:
        changed = _grown(changed, changed.vertex_of[centre], HORN_RADIUS * whole.unit, HORN_LENGTH * whole.unit, random)
    return changed


CHANGES: dict[str, Callable[[Whole, np.random.Generator], Changed]] = {
    "limb": without_limb,
    "tail": with_tail,
    "end": without_end,
    "horns": with_horns,
    "holes": with_holes,
}


def _severed(
    whole: Whole,
    reach: tuple[float, float],
    choose: Callable[[Floats], int],
    random: np.random.Generator,
) -> Changed:
    """The surface beyond one slice around an extremity, which is chosen by the areas of all slices."""
    surface = whole.surface
    tips = _tips(whole, random)
    distance = _distances(surface, tips[:1])[0]
    half = distance[tips[1:]].min() / 2
    slices = half * np.arange(*reach, SLICE)
    area = vertex_areas(surface.vertices, surface.triangles)
    lost = distance < slices[1 + choose(np.histogram(distance, slices, weights=area)[0])]
    body, loose = np.isfinite(distance), np.isinf(distance)
    # Parts that are connected only to the limb, such as a feather, are removed with it.
    graph = edge_graph(surface.vertices, surface.triangles)
    left = np.flatnonzero(body & ~lost)
    piece = connected_components(graph[left][:, left], directed=False)[1]
    lost[left] = piece != np.argmax(np.bincount(piece))
    # Clothes and eyes are removed with the flesh under them.
    under = cKDTree(surface.vertices[body]).query(surface.vertices[loose])[1]
    lost[loose] = lost[body][under]
    return _without(_unchanged(surface), lost)


def _tips(whole: Whole, random: np.random.Generator) -> Integers:
    """Extremities, a random one first."""
    surface, start = whole.surface, whole.places[:1]
    tips: list[int] = []
    nearest = _distances(surface, start)[0]
    for _ in range(TIPS):
        tips.append(int(np.argmax(np.where(np.isfinite(nearest), nearest, -1))))
        nearest = _distances(surface, tips).min(axis=0)
    return random.permutation(tips)


def _distances(surface: Surface, vertices: Integers | list[int]) -> Floats:
    """(len(vertices), n) distances along edges; infinite to other components."""
    return np.asarray(dijkstra(edge_graph(surface.vertices, surface.triangles), indices=vertices))


def _remoteness(whole: Whole, random: np.random.Generator) -> Floats:
    """(n,) average distance to places: smallest on the trunk, largest at the ends of limbs."""
    return _distances(whole.surface, random.choice(whole.places, 50)).mean(axis=0)


def _ends_in_middle(whole: Whole, random: np.random.Generator) -> Integers:
    """The ends of head and tail, or of the head alone."""
    middle = whole.places[_in_middle(whole)]
    remoteness = _remoteness(whole, random)[middle]
    first = np.argmax(remoteness)
    second = np.argmax(_distances(whole.surface, middle[[first]])[0, middle])
    return middle[[first, second]] if remoteness[second] > remoteness.mean() else middle[[first]]


def _apart(whole: Whole) -> Floats:
    """(c,) Euclidean distances of places from their mirror images."""
    points = whole.surface.vertices
    return np.linalg.norm(points[whole.places] - points[whole.mirrored], axis=1)


def _in_middle(whole: Whole) -> Booleans:
    return _apart(whole) < MIDDLE * whole.unit


# --- meshes -------------------------------------------------------------------------------------------------


def _unchanged(surface: Surface) -> Changed:
    count = len(surface.vertices)
    return Changed(surface, np.arange(count), np.zeros(count, dtype=bool))


def _without(changed: Changed, lost: Booleans) -> Changed:
    triangles = changed.surface.triangles
    return _with_faces(changed, triangles[~lost[triangles].any(axis=1)], np.empty((0, 3)))


def _with_faces(changed: Changed, triangles: Integers, new: Floats) -> Changed:
    """Replace triangles, using old vertices and new ones (m, 3) numbered after them; unused vertices are removed."""
    vertices = np.concatenate([changed.surface.vertices, new])
    gained = np.concatenate([changed.gained, np.ones(len(new), dtype=bool)])
    used, compact = np.unique(triangles, return_inverse=True)
    number = np.full(len(vertices), -1)
    number[used] = np.arange(len(used))
    vertex_of = np.where(changed.vertex_of >= 0, number[changed.vertex_of], -1)
    return Changed(Surface(vertices[used], compact.reshape(triangles.shape)), vertex_of, gained[used])


def _grown(changed: Changed, centre: int, radius: float, length: float, random: np.random.Generator) -> Changed:
    """Replace a disc around a vertex by a limb: rings that taper along a bent axis, and a tip."""
    surface = changed.surface
    triangles = surface.triangles
    in_disc, loop = _disc(surface, centre, radius)
    base = surface.vertices[loop]
    middle = base.mean(axis=0)
    axis = vertex_normals(surface.vertices, triangles)[centre]
    outward = base - middle
    flat = outward - np.outer(outward @ axis, axis)
    width = np.linalg.norm(flat, axis=1).mean()
    circle = width * flat / np.linalg.norm(flat, axis=1, keepdims=True)
    side = np.cross(axis, random.normal(size=3))
    edge = np.linalg.norm(base - np.roll(base, -1, axis=0), axis=1).mean()

    along = np.linspace(0, 1, max(3, round(length / edge)))[1:, None, None]
    spine = middle + length * (along * axis + BEND * along**2 * side / np.linalg.norm(side))
    rounded = np.minimum(3 * along, 1)
    rings = spine + ((1 - rounded) * outward + rounded * circle) * (1 - (1 - TIP) * along)
    first = len(surface.vertices)
    tip = first + rings[..., 0].size
    ring = np.concatenate([loop[None], np.arange(first, tip).reshape(len(rings), -1)])
    a, b = ring, np.roll(ring, -1, axis=1)
    sides = [np.stack([a[:-1], b[:-1], b[1:]], axis=-1), np.stack([a[:-1], b[1:], a[1:]], axis=-1)]
    cap = np.stack([a[-1], b[-1], np.full(len(loop), tip)], axis=-1)
    point = spine[-1] + TIP * width * axis
    return _with_faces(
        changed,
        np.concatenate([triangles[~in_disc], *(each.reshape(-1, 3) for each in sides), cap]),
        np.concatenate([rings.reshape(-1, 3), point]),
    )


def _disc(surface: Surface, centre: int, radius: float) -> tuple[Booleans, Integers]:
    """Triangles around a vertex that form a disc of at most the radius, and the vertices of its border in order."""
    triangles = surface.triangles
    distance = _distances(surface, [centre])[0]
    while True:
        chosen = (distance < radius)[triangles].any(axis=1)
        starts, ends = np.stack([triangles[chosen], np.roll(triangles[chosen], -1, axis=1)], axis=-1).reshape(-1, 2).T
        inner = np.isin(starts * len(distance) + ends, ends * len(distance) + starts)
        following = dict(zip(starts[~inner].tolist(), ends[~inner].tolist(), strict=True))
        loop = [int(starts[~inner][0])]
        while (vertex := following[loop[-1]]) != loop[0] and len(loop) < len(following):
            loop.append(vertex)
        if len(loop) == np.count_nonzero(~inner):
            return chosen, np.array(loop)
        radius *= 0.8
