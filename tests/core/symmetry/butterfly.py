# SPDX-License-Identifier: GPL-3.0-or-later
"""Small shapes with exact left and right sides, so that mirror tests take milliseconds."""

from __future__ import annotations

import numpy as np
from creatures import directions
from scipy.spatial import cKDTree

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples import grids
from zoomout_core.symmetry.self_map import SelfMap

MIRROR = np.array([-1.0, 1, 1])
HALF = directions(150, seed=4)
HALF = HALF[HALF[:, 0] > 0.08]
# Places on the sphere whose mirror images are also in the set.
EVEN = np.concatenate([HALF, HALF * MIRROR, [[0, np.cos(t), np.sin(t)] for t in np.arange(24) * np.pi / 12]])


def grid(columns: int = 12, rows: int = 5, width: float = 2.4, height: float = 1.0) -> Surface:
    """A flat grid of quads around the plane x = 0; with an even number of columns it has vertices on the plane."""
    return grids.grid((np.arange(columns + 1) / columns - 0.5) * width, np.arange(rows + 1) / rows * height)


def mirrored_vertex(surface: Surface) -> np.ndarray:
    """(n,) vertex nearest to the mirror image of each vertex."""
    return np.asarray(cKDTree(surface.vertices).query(surface.vertices * MIRROR)[1])


def self_map(surface: Surface, distance: np.ndarray | None = None) -> SelfMap:
    """The mirror x -> -x as a symmetry of a mirror-symmetric surface; x > 0 is left."""
    return SelfMap(
        surface=surface,
        surface_map=SurfaceMap.from_vertices(mirrored_vertex(surface), surface),
        confidence=np.ones(len(surface.vertices)),
        reverses_orientation=True,
        distance=surface.vertices[:, 0] if distance is None else distance,
    )
