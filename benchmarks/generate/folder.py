# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a set in the format of the benchmark data's README, and find the vertices at known places."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import vertex_normals

Pair = tuple[str, str]  # target, source

# A place farther from the mesh, relative to the square root of its area, is not on it.
NEAR = 0.025
# Number of nearby vertices whose normals are compared with the place's.
ASKED = 8
# Maximum number of recorded places for each class.
PLACES = 5000


def write_set(
    folder: Path,
    meshes: Mapping[str, Surface],
    correspondence: Mapping[str, Any],
    pairs: Iterable[Pair],
) -> None:
    """Write meshes as OFF, `correspondence.npz` and `pairs.txt`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, mesh in meshes.items():
        _write_off(folder / f"{name}.off", mesh)
    np.savez_compressed(folder / "correspondence.npz", **correspondence)
    (folder / "pairs.txt").write_text("".join(f"{target} {source}\n" for target, source in pairs))


def standing_for(places: Floats, normals: Floats, mesh: Surface) -> Integers:
    """For each place the nearest vertex of a mesh's largest part whose normal agrees.

    Args:
        places: (c, 3) points near the mesh.
        normals: (c, 3) of the surface there.
        mesh: the mesh.

    Returns:
        (c,) vertices; -1 if the mesh has no such vertex nearby.
    """
    body = np.flatnonzero(mesh.components == 0)
    distance, near = cKDTree(mesh.vertices[body]).query(places, ASKED)
    vertex = body[near]
    agrees = np.einsum("cax,cx->ca", vertex_normals(mesh.vertices, mesh.triangles)[vertex], normals) > 0
    found = agrees & (distance < NEAR * np.sqrt(mesh.area))
    first = np.argmax(found, axis=1)
    rows = np.arange(len(places))
    return np.where(found[rows, first], vertex[rows, first], -1)


def known_on_all(places: Mapping[str, Integers], random: np.random.Generator) -> dict[str, Integers]:
    """The places of a class that every mesh has (none is -1), at most a given number, drawn at random."""
    known = np.flatnonzero(np.min(list(places.values()), axis=0) >= 0)
    kept = np.sort(random.permutation(known)[:PLACES])
    return {name: vertices[kept] for name, vertices in places.items()}


def by_class(names: Iterable[str]) -> list[list[str]]:
    """Group names that agree up to the first digit."""
    return [list(group) for _, group in groupby(sorted(names), key=class_of)]


def class_of(name: str) -> str:
    """The part of a name before its first digit."""
    return re.split(r"\d", name, maxsplit=1)[0]


def spread(items: list[Pair], max_count: int) -> list[Pair]:
    """At most a given number of items, evenly spread over the list."""
    picked = np.unique(np.linspace(0, len(items) - 1, min(max_count, len(items))).astype(int))
    return [items[i] for i in picked]


def _write_off(path: Path, mesh: Surface) -> None:
    with path.open("w") as file:
        file.write(f"OFF\n{len(mesh.vertices)} {len(mesh.triangles)} 0\n")
        np.savetxt(file, mesh.vertices, "%.7g")
        np.savetxt(file, np.insert(mesh.triangles, 0, 3, axis=1), "%d")
