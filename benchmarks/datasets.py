# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets of meshes with known correspondences, in the format of the benchmark data's README."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Self, TypeVar

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.evaluation import geodesic_error
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_shape, read_surface
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.mesh.surface import Surface

Item = TypeVar("Item")

# In sets with this file: corresponding places of all shapes.
CORRESPONDENCE = "correspondence.npz"
# In sets with this file: the nearest vertex of a common template for each vertex.
TEMPLATE = "template_vertex.npz"
# In sets with this file: pairs NAME_source and NAME_target, one or both of which lack pieces.
TRUTH = "truth.npz"
# Prefixes of the names of these pairs, and the kinds of missing pieces.
PARTS = {"cut": "cuts", "holes": "holes", "pfarm": "missing pieces", "both_partial": "both cut, other species"}
# Maximum number of known places at which a map is measured.
MAX_PLACES = 1000
# Fewer are enough to classify an error.
FEW_PLACES = 200


@dataclass(frozen=True)
class PairOfMeshes:
    """Two meshes of a set, or the surfaces of its clouds: target vertices are mapped to the source.

    Attributes:
        target_name: the first name of a line of `pairs.txt`.
        source_name: the second one.
        target: the first mesh.
        source: the second mesh.
        target_vertex: (c,) vertices of the target whose true image is known.
        source_vertex: (c,) their true images on the source.
        mirrored_vertex: (c,) these images with left and right exchanged; None if the set does not list them.
    """

    target_name: str
    source_name: str
    target: Surface
    source: Surface
    target_vertex: Integers
    source_vertex: Integers
    mirrored_vertex: Integers | None

    def errors(self, maps: Integers) -> Floats:
        """(c, m) geodesic errors, times 1000, of m vertex maps (n_t, m) at the known places; NaN for no image.

        An image on a loose part has no distance to the body, and counts as none.
        """
        known = self.target_vertex, self.source_vertex
        errors = 1000 * geodesic_error(np.maximum(maps, 0), self.source, *known, max_count=len(self.target_vertex))
        return np.where((maps[self.target_vertex] < 0) | np.isinf(errors), np.nan, errors)

    def mirrored_error(self, vertex: Integers) -> float | None:
        """Mean error, times 1000, of a vertex map (n_t,) against the truth with left and right exchanged."""
        if self.mirrored_vertex is None:
            return None
        errors = geodesic_error(vertex, self.source, self.target_vertex, self.mirrored_vertex, FEW_PLACES)
        return float(1000 * errors[np.isfinite(errors)].mean())


def sets_in(folder: Path) -> list[Path]:
    """The sets of whole shapes with known correspondences in a folder, or the folder itself if it is one."""
    marks = (CORRESPONDENCE, TEMPLATE, f"*/{CORRESPONDENCE}", f"*/{TEMPLATE}")
    found = sorted({path.parent for mark in marks for path in folder.glob(mark)})
    return [each for each in found if (each / TEMPLATE).is_file() or (each / "pairs.txt").is_file()]


@dataclass(frozen=True, eq=False)
class PairOfParts:
    """Two shapes in one unit, of which the target, or both, lack pieces.

    Attributes:
        name: of the pair.
        source: the surface that the map lands on.
        target: the surface that it starts from.
        truth: (n_t,) source vertex of each target vertex; -1 where there is none.
    """

    name: str
    source: Surface
    target: Surface
    truth: Integers

    @classmethod
    def load(cls, folder: Path, name: str) -> Self:
        """Load a pair of a set by its name."""
        source, target = (read_surface(folder / f"{name}_{side}.off") for side in ("source", "target"))
        return cls(name, source, target, _truth(folder / TRUTH)[name])

    @property
    def kind(self) -> str:
        """The kind of part that is missing."""
        return kind_of_part(self.name)

    @cached_property
    def region(self) -> Booleans:
        """(n_s,) which source vertices correspond to some part of the target."""
        return region_of(self.truth, self.source)

    def errors(self, vertex: Integers, max_count: int) -> Floats:
        """(c,) geodesic errors, times 1000, of a vertex map (n_t,) at up to `max_count` places that have a partner;
        NaN for no image.

        An image on a loose part has no distance to the body, and counts as none.
        """
        known = np.flatnonzero(self.truth >= 0)
        places = known[np.unique(np.linspace(0, len(known) - 1, min(max_count, len(known))).astype(int))]
        errors = 1000 * geodesic_error(vertex, self.source, places, self.truth[places], len(places))
        return np.where((vertex[places] < 0) | np.isinf(errors), np.nan, errors)


def region_of(images: Integers, source: Surface) -> Booleans:
    """(n_s,) the vertices of all faces that have an image at a corner."""
    is_image = np.zeros(len(source.vertices), dtype=bool)
    is_image[images[images >= 0]] = True
    region = np.zeros_like(is_image)
    region[source.triangles[is_image[source.triangles].any(axis=1)]] = True
    return region


def kind_of_part(name: str) -> str:
    """The kind of part that is missing in a pair, from the pair's name."""
    for beginning, kind in PARTS.items():
        if name.startswith(f"{beginning}_"):
            return kind
    raise MeshError(f"The pair {name} is of no known kind: begin its name with {', '.join(PARTS)}.")


def sets_of_parts_in(folder: Path) -> list[Path]:
    """The sets of pairs with missing pieces in a folder, or the folder itself if it is such a set."""
    return sorted({path.parent for mark in (TRUTH, f"*/{TRUTH}") for path in folder.glob(mark)})


def part_names(folder: Path, max_count: int | None, kinds: Collection[str] = tuple(PARTS.values())) -> list[str]:
    """The pairs of a set of the given kinds, or `max_count` of them evenly spread over the list."""
    names = sorted(_truth(folder / TRUTH))
    return evenly([name for name in names if kind_of_part(name) in kinds], max_count)


def is_far(name: str) -> bool:
    """Whether the shapes of the set with this name are far from isometric."""
    return "nonisometric" in name or name.startswith("smal")


def evenly(items: Sequence[Item], max_count: int | None) -> list[Item]:
    """All items, or `max_count` of them evenly spread over the list."""
    if max_count is None or max_count >= len(items):
        return list(items)
    return [items[i] for i in np.linspace(0, len(items) - 1, max_count).round().astype(int)]


def pair_names(folder: Path, max_count: int | None) -> list[tuple[str, str]]:
    """The pairs of a set in both directions, or `max_count` of them evenly spread over the list."""
    if (folder / TEMPLATE).is_file():
        lines = _every_kind_against_every_kind(folder)
    else:
        listed = [line.split() for line in (folder / "pairs.txt").read_text().splitlines() if line.strip()]
        lines = listed + [pair[::-1] for pair in listed if pair[::-1] not in listed]
    return [(first, second) for first, second in evenly(lines, max_count)]


def load_pair(folder: Path, target_name: str, source_name: str) -> PairOfMeshes:
    """Load a pair with its true correspondence."""
    by_template = (folder / TEMPLATE).is_file()
    truth = _truth(folder / (TEMPLATE if by_template else CORRESPONDENCE))
    ending = "ply" if by_template else "off"
    target, source = (as_surface(read_shape(folder / f"{name}.{ending}")) for name in (target_name, source_name))
    target_vertex, source_vertex = truth[target_name], truth[source_name]
    mirrored_vertex = truth.get(f"{source_name}.sym")
    if by_template:
        target_vertex, source_vertex = _through_template(target_vertex, source_vertex, source)
    picked = np.unique(np.linspace(0, len(target_vertex) - 1, min(MAX_PLACES, len(target_vertex))).astype(int))
    return PairOfMeshes(
        target_name,
        source_name,
        target,
        source,
        target_vertex[picked],
        source_vertex[picked],
        None if mirrored_vertex is None else mirrored_vertex[picked],
    )


def load_same_order(folder: Path, target_name: str, source_name: str) -> PairOfMeshes:
    """Load two meshes with the same order of vertices, some of which have known images."""
    target, source = (read_surface(folder / f"{name}.off") for name in (target_name, source_name))
    places = np.unique(np.linspace(0, len(target.vertices) - 1, MAX_PLACES).astype(int))
    return PairOfMeshes(target_name, source_name, target, source, places, places, None)


def shipped_pairs(folder: Path, method: str) -> list[tuple[str, str]]:
    """The pairs, target first, for which a set has a method's map in which every vertex has an image."""
    path = folder / f"map_{method}.npz"
    if not path.is_file():
        return []
    with np.load(path) as maps:
        return [(target, source) for target, source in pair_names(folder, None) if _is_complete(maps, target, source)]


def shipped_map(folder: Path, method: str, target_name: str, source_name: str) -> Integers:
    """(n_t,) the source vertex of each target vertex in a map of a set."""
    with np.load(folder / f"map_{method}.npz") as maps:
        return np.asarray(maps[f"{target_name}__{source_name}"], dtype=np.int64)


def _is_complete(maps: Mapping[str, Integers], target: str, source: str) -> bool:
    name = f"{target}__{source}"
    return name in maps and bool(maps[name].min() >= 0)


def shapes_with_symmetry(folder: Path, max_count: int | None) -> list[str]:
    """The shapes of a set whose mirror images are known, or `max_count` of them evenly spread over the list."""
    path = folder / CORRESPONDENCE
    truth = _truth(path) if path.is_file() else {}
    return evenly([name.removesuffix(".sym") for name in truth if name.endswith(".sym")], max_count)


def mirrored_places(folder: Path, name: str) -> tuple[Surface, Integers, Integers]:
    """A shape, (c,) some of its vertices, and (c,) their mirror images on its other side."""
    truth = _truth(folder / CORRESPONDENCE)
    return read_surface(folder / f"{name}.off"), truth[name], truth[f"{name}.sym"]


def _every_kind_against_every_kind(folder: Path) -> list[list[str]]:
    """All ordered pairs of meshes and clouds KIND_SUBJECT of different subjects."""
    names = sorted(_truth(folder / TEMPLATE))
    return [[a, b] for a in names for b in names if a.split("_")[1] != b.split("_")[1]]


def _through_template(of_target: Integers, of_source: Integers, source: Surface) -> tuple[Integers, Integers]:
    """Pairs of vertices with the same template vertex, given the template vertex of each; on the largest part."""
    first = np.full(max(of_target.max(), of_source.max()) + 1, -1)
    on_body = np.flatnonzero(source.components == 0)
    first[of_source[on_body]] = on_body
    known = np.flatnonzero(first[of_target] >= 0)
    return known, first[of_target[known]]


@lru_cache(maxsize=8)
def _truth(path: Path) -> dict[str, Integers]:
    with np.load(path) as file:
        return dict(file)
