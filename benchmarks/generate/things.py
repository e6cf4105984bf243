# SPDX-License-Identifier: GPL-3.0-or-later
"""Things with several symmetries: a vase with two handles, a table, a starfish, and a letter S that only turns."""

from __future__ import annotations

import numpy as np

from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.implicit import Ellipsoid, Limb, Solid, both_sides, bounds, surface_net

from .remeshing import isotropic

CELL = 0.035


def _around(count: int, reach: float) -> list[Solid]:
    turns = np.arange(count) * 2 * np.pi / count
    return [
        Limb(((0.1 * np.cos(t), 0.1 * np.sin(t), 0, 0.13), (reach * np.cos(t), reach * np.sin(t), 0, 0.07)), blend=0.05)
        for t in turns
    ]


def _handle() -> Limb:
    turns = np.linspace(-np.pi / 2, np.pi / 2, 9)
    return Limb(
        tuple((0.30 + 0.3 * float(np.cos(t)), 0.0, 0.05 + 0.28 * float(np.sin(t)), 0.05) for t in turns), blend=0.02
    )


# The solids of each thing, and its number of symmetries besides the identity.
THINGS: dict[str, tuple[list[Solid], int]] = {
    "vase": (
        [
            Limb(
                ((0, 0, -0.5, 0.24), (0, 0, -0.2, 0.36), (0, 0, 0.15, 0.3), (0, 0, 0.45, 0.14), (0, 0, 0.65, 0.2)),
                blend=0.05,
            ),
            *both_sides([_handle()]),
        ],
        3,
    ),
    "table": (
        [
            Ellipsoid((0, 0, 0), (0.5, 0.5, 0.1), blend=0.05),
            *(Limb(((x, y, 0, 0.09), (x, y, -0.8, 0.07)), blend=0.04) for x in (-0.3, 0.3) for y in (-0.3, 0.3)),
        ],
        7,
    ),
    "starfish": ([Ellipsoid((0, 0, 0.08), (0.22, 0.22, 0.16), blend=0.05), *_around(5, 0.8)], 9),
    "letter S": (
        [
            Limb(((-0.7, -0.3, 0, 0.09), (-0.3, -0.3, 0, 0.12)), blend=0.03),
            Limb(((-0.3, -0.3, 0, 0.12), (0.3, 0.3, 0, 0.12)), blend=0.03),
            Limb(((0.3, 0.3, 0, 0.12), (0.7, 0.3, 0, 0.09)), blend=0.03),
            Ellipsoid((0, 0, 0.1), (0.15, 0.15, 0.12), blend=0.03),
        ],
        1,
    ),
}


def thing(name: str, vertices: int = 4000, seed: int = 0) -> Surface:
    """A thing, turned at random and remeshed, so that its mesh does not have its symmetries."""
    solids, _ = THINGS[name]
    random = np.random.default_rng(seed)
    points, faces = surface_net(CELL, solids, bounds(solids, 5 * CELL))
    turn = np.linalg.qr(random.standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    rebuilt = isotropic(Surface(points @ turn.T, faces), vertices, random)
    return Surface(rebuilt.vertices @ turn, rebuilt.triangles)
