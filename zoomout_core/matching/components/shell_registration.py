# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs of shells registered by similarities: many pairs at once, by iterated closest points both ways.

Besl and McKay, A method for registration of 3-D shapes (1992), with the scale of Umeyama, Least-squares estimation of
transformation parameters between two point patterns (1991).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.geometry.procrustes import Similarities, procrustes
from zoomout_core.tuning import Tuning, tuned

# Shells are this far apart in the fourth coordinate of a tree that holds them all.
APART = 1e3


@dataclass(frozen=True)
class ShellIcpTuning(Tuning, set_by="characters"):
    """How densely shells are sampled, and how they are registered by iterated closest points."""

    dense: int = tuned(320, "points", 48, 100_000)  # samples of a shell
    sparse: int = tuned(48, "points", 3, 48)  # those of them that are projected onto the other shell
    rounds: int = tuned(12, "rounds", 1, 1000)  # of iterated closest points
    # A start along principal axes is taken instead of the body's rotation where it leaves less than this part of the
    # distances.
    clearly_less: float = tuned(0.8, "1", 0, 1)
    max_scale: float = tuned(1.35, "1", 1, 100)  # of a shell's size to that by the body's map, and inversely


SHELL_ICP = ShellIcpTuning()


@dataclass(frozen=True, eq=False)
class Shells:
    """Points on several shells, for searches of the nearest point of one of them."""

    dense: Floats  # (p, d, 3)

    @classmethod
    def of(cls, meshes: Sequence[tuple[Floats, Integers]]) -> Shells:
        """Those of some meshes, each given by its vertices (n, 3) and triangles (m, 3)."""
        return cls(np.stack([surface_samples(*mesh, SHELL_ICP.dense)[0] for mesh in meshes]))

    @cached_property
    def sparse(self) -> Floats:
        """(p, s, 3) some of them, evenly spread."""
        step = self.dense.shape[1] // SHELL_ICP.sparse
        return self.dense[:, ::step][:, : SHELL_ICP.sparse]

    @cached_property
    def centre(self) -> Floats:
        """(p, 3)."""
        return np.asarray(self.dense.mean(axis=1))

    @cached_property
    def size(self) -> Floats:
        """(p,) root mean square distance from the centre."""
        return np.asarray(np.sqrt(((self.dense - self.centre[:, None]) ** 2).sum(axis=2).mean(axis=1)))

    @cached_property
    def axes(self) -> Floats:
        """(p, 3, 3) rows: principal axes, the longest first."""
        offset = self.dense - self.centre[:, None]
        return np.asarray(np.swapaxes(np.linalg.eigh(np.swapaxes(offset, 1, 2) @ offset)[1], 1, 2)[:, ::-1])

    @cached_property
    def _tree(self) -> cKDTree:
        number = np.broadcast_to(APART * np.arange(len(self.dense))[:, None, None], (*self.dense.shape[:2], 1))
        return cKDTree(np.concatenate([self.dense, number], axis=2).reshape(-1, 4))

    def nearest(self, points: Floats, shell: Integers) -> tuple[Floats, Floats]:
        """Distances (q, s) from points (q, s, 3) to the nearest ones of the shells (q,), and these (q, s, 3)."""
        number = np.broadcast_to(APART * shell[:, None, None], (*points.shape[:2], 1))
        distance, near = self._tree.query(np.concatenate([points, number], axis=2).reshape(-1, 4))
        return np.reshape(distance, points.shape[:2]), self.dense.reshape(-1, 3)[near].reshape(points.shape)


def register_shells(
    target: Shells, source: Shells, of_target: Integers, of_source: Integers, prior: Similarities, handedness: float
) -> tuple[Similarities, Floats]:
    """Register shells (q,) of the target with shells (q,) of the source, given by their numbers.

    The body's map moves the target's shells by `prior` (p,), and mirrors them if `handedness` is -1. Returns (q,) the
    similarities, and (q,) the remaining root mean square distances in both directions.
    """
    start = prior[of_target]
    scales = start.scale / SHELL_ICP.max_scale, start.scale * SHELL_ICP.max_scale
    both, left = [], []
    along_axes = _along_axes(start.rotation, target.axes[of_target], source.axes[of_source], handedness)
    for rotation in (start.rotation, along_axes):
        centre = np.einsum("qij,qj->qi", rotation, target.centre[of_target]) * start.scale[:, None]
        motion = Similarities(start.scale, rotation, source.centre[of_source] - centre)
        for _ in range(SHELL_ICP.rounds):
            here, there, _ = _partners(target, source, of_target, of_source, motion)
            motion = procrustes(here, there, None, handedness, scales)
        both.append(motion)
        left.append(np.sqrt((_partners(target, source, of_target, of_source, motion)[2] ** 2).mean(axis=1)))
    second = left[1] < SHELL_ICP.clearly_less * left[0]
    q = np.arange(len(of_target))
    return Similarities.concatenate(both)[q + len(q) * second], np.where(second, left[1], left[0])


def _partners(
    target: Shells, source: Shells, of_target: Integers, of_source: Integers, motion: Similarities
) -> tuple[Floats, Floats, Floats]:
    """Points (q, 2s, 3) of target shells, the points (q, 2s, 3) of source shells nearest to them, and distances."""
    here, there = target.sparse[of_target], source.sparse[of_source]
    off, forth = source.nearest(motion(here), of_source)
    off_back, back = target.nearest(motion.inverse(there), of_target)
    distances = np.concatenate([off, off_back * motion.scale[:, None]], axis=1)
    return np.concatenate([here, back], axis=1), np.concatenate([forth, there], axis=1), distances


def _along_axes(rotation: Floats, of_target: Floats, of_source: Floats, handedness: float) -> Floats:
    """(q, 3, 3) rotations of principal axes to principal axes, in the senses that are nearest to `rotation`."""
    agreement = np.einsum("qax,qxy,qay->qa", of_source, rotation, of_target)
    sign = np.where(agreement < 0, -1.0, 1.0)
    aligned = np.einsum("qax,qa,qay->qxy", of_source, sign, of_target)
    wrong = np.linalg.det(aligned) * handedness < 0
    weakest = np.argmin(np.abs(agreement), axis=1)
    sign[wrong, weakest[wrong]] *= -1
    return np.asarray(np.einsum("qax,qa,qay->qxy", of_source, sign, of_target))
