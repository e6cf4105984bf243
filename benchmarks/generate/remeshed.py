# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets of meshes with the same vertex order, paired with remeshed versions of themselves and of each other."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from pathlib import Path

import numpy as np
from tqdm import tqdm

from zoomout_core.arrays import Integers
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import vertex_normals

from .folder import PLACES, Pair, by_class, known_on_all, standing_for, write_set
from .remeshing import REMESHINGS

# Ratio of the vertices of a remeshed version to the original's.
THINNED = 0.3


def write_remeshed(output: Path, data: Iterable[Path], seed: int, count: int) -> None:
    """Write a set of original and remeshed meshes.

    Args:
        output: folder of the set.
        data: folders of OFF files; files whose names agree up to the first digit have corresponding vertices.
        seed: for the noise and the places.
        count: number of pairs for each class, drawn at random.
    """
    originals = {path.stem: read_surface(path) for folder in data for path in sorted(folder.glob("*.off"))}
    meshes: dict[str, Surface] = dict(originals)
    correspondence: dict[str, Integers] = {}
    pairs: list[Pair] = []
    for members in by_class(originals):
        random = np.random.default_rng([seed, *members[0].encode()])
        remade = {f"{name}_{how}": (name, how) for name, how in product(members, REMESHINGS)}
        every: list[Pair] = [(new, name) for name in members for new in remade]
        chosen = [every[i] for i in np.sort(random.permutation(len(every))[:count])]
        made = sorted({new for new, _ in chosen})
        body = np.flatnonzero(originals[members[0]].components == 0)
        rows = np.sort(random.permutation(body)[:PLACES])
        places = dict.fromkeys(members, rows)
        for new in tqdm(made, desc=members[0], leave=False):
            name, how = remade[new]
            original = originals[name]
            meshes[new] = REMESHINGS[how](original, round(THINNED * len(original.vertices)), random)
            normals = vertex_normals(original.vertices, original.triangles)
            places[new] = standing_for(original.vertices[rows], normals[rows], meshes[new])
        correspondence |= known_on_all(places, random)
        pairs += chosen
    write_set(output, meshes, correspondence, pairs)
