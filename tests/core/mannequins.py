# SPDX-License-Identifier: GPL-3.0-or-later
"""Generated characters that are assembled from loose shells, one per limb, with the true place of every vertex.

A mannequin consists of ellipsoids along a skeleton, which overlap a little at the joints. Each seed meshes them
differently.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from creatures import directions
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.voxel_remesh import voxel_remesh
from zoomout_core.samples.spheres import outward_hull

# Each part: its parent, the joint about which it rotates, its centre and its radii. +x is left, -y is front.
Part = tuple[str, tuple[float, ...], tuple[float, ...], tuple[float, ...]]
MIDDLE: dict[str, Part] = {
    "torso": ("", (0, 0, 1.0), (0, 0, 1.25), (0.21, 0.14, 0.36)),
    "head": ("torso", (0, 0, 1.58), (0, -0.03, 1.72), (0.11, 0.13, 0.16)),
}
LEFT: dict[str, Part] = {
    "upper arm": ("torso", (0.2, 0, 1.5), (0.36, 0, 1.5), (0.19, 0.06, 0.06)),
    "forearm": ("upper arm", (0.52, 0, 1.5), (0.66, -0.01, 1.5), (0.17, 0.05, 0.05)),
    "hand": ("forearm", (0.81, 0, 1.5), (0.9, -0.02, 1.49), (0.1, 0.05, 0.025)),
    "thigh": ("torso", (0.1, 0, 0.95), (0.11, 0, 0.74), (0.09, 0.1, 0.25)),
    "shin": ("thigh", (0.11, 0, 0.5), (0.12, 0.01, 0.3), (0.065, 0.075, 0.24)),
    "foot": ("shin", (0.12, 0.02, 0.09), (0.13, -0.07, 0.05), (0.055, 0.14, 0.05)),
}


def _on_side(part: Part, side: str) -> Part:
    """A part of the left side, mirrored if `side` is not "L"."""
    above, joint, centre, radii = part
    sign = np.array([1 if side == "L" else -1, 1, 1])
    return above if above == "torso" else f"{above}.{side}", tuple(sign * joint), tuple(sign * centre), radii


PARTS = MIDDLE | {f"{name}.{side}": _on_side(part, side) for side in "LR" for name, part in LEFT.items()}
# Rotations about the joints, in degrees about x, y and z: a step, with bent, lowered arms.
STEP: Mapping[str, tuple[float, float, float]] = {
    "upper arm.L": (0, 55, -20), "forearm.L": (0, 15, -55), "upper arm.R": (0, -50, -35), "forearm.R": (0, 0, 40),
    "thigh.L": (-40, 0, 0), "shin.L": (35, 0, 0), "thigh.R": (30, 0, 0), "shin.R": (20, 0, 0), "head": (0, 0, 25),
}  # fmt: skip


@dataclass(frozen=True)
class Mannequin:
    """A mannequin.

    Attributes:
        surface: all parts as one mesh.
        part: (n,) the name of each vertex's part.
        keys: (n, 3) the place of each vertex on its part, in the part's own frame at rest.
    """

    surface: Surface
    part: np.ndarray
    keys: np.ndarray


def mannequin(
    pose: Mapping[str, tuple[float, float, float]] | None = None,
    count: int = 150,
    seed: int = 0,
    build: tuple[float, float, float] = (1, 1, 1),
    without: tuple[str, ...] = (),
) -> Mannequin:
    """A mannequin in a pose.

    Args:
        pose: rotations of parts about their joints, in degrees about x, y and z; their children follow.
        count: vertices of each part.
        seed: seed of the mesh.
        build: scale of the body along x, y and z.
        without: names of the parts to omit.
    """
    motions: dict[str, tuple[np.ndarray, np.ndarray]] = {"": (np.eye(3), np.zeros(3))}
    points, triangles, names, keys = [], [], [], []
    for number, (name, (above, joint, centre, radii)) in enumerate(PARTS.items()):
        turn, shift = motions[above]
        own = Rotation.from_euler("xyz", (pose or {}).get(name, (0, 0, 0)), degrees=True).as_matrix()
        joint, centre = np.array(joint) * build, np.array(centre) * build
        motions[name] = turn @ own, turn @ (joint - own @ joint) + shift
        if name in without:
            continue
        where = directions(count, 100 * seed + number)
        triangles.append(outward_hull(where) + count * len(points))
        points.append((centre + where * radii * build) @ motions[name][0].T + motions[name][1])
        names += [name] * count
        keys.append(where * radii)
    return Mannequin(Surface(np.vstack(points), np.vstack(triangles)), np.array(names), np.vstack(keys))


def as_one_skin(pose: Mapping[str, tuple[float, float, float]] | None = None) -> Mannequin:
    """Rebuild a mannequin as a single skin; vertices take the name of the nearest part, and keys are meaningless."""
    dense = mannequin(pose, 600)
    surface = Surface(*voxel_remesh(dense.surface.vertices, dense.surface.triangles, 90))
    near = cKDTree(dense.surface.vertices).query(surface.vertices)[1]
    return Mannequin(surface, dense.part[near], dense.keys[near])
