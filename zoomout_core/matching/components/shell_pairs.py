# SPDX-License-Identifier: GPL-3.0-or-later
"""Pair the shells of two surfaces one to one, by place, size, shape and rotation.

Lengths are at unit area of the hull.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.procrustes import Similarities, procrustes
from zoomout_core.matching.components.parts import Part, Side, relation_of
from zoomout_core.matching.components.shell_registration import Shells, register_shells
from zoomout_core.matching.components.similarity_field import SimilarityField, transform_in_blocks
from zoomout_core.matching.pair import Pair
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class ShellPairTuning(Tuning, set_by="characters"):
    """Which pairs of shells are tried, and the cost of a pair."""

    rivals: int = tuned(6, "shells", 1, 300)  # candidates, nearest in position and size, to register a shell to
    max_miss: float = tuned(0.3, "sizes of the source's shell", 0, 1)  # maximum residual of the registration of a pair
    max_move: float = tuned(0.17, "at unit area", 0, 1)  # maximum distance of a pair from its place by the body's map
    max_unlike: float = tuned(1.65, "1", 1, 10)  # maximum ratio of the sizes of a pair
    miss_cost: float = tuned(1.0, "1", 0, 10)  # cost of a residual of `max_miss`
    move_cost: float = tuned(1.2, "1", 0, 10)  # cost of a distance of `max_move`
    turn_cost: float = tuned(0.1, "1 / radian", 0, 10)  # cost of a rotation by one radian relative to the body's
    scale_cost: float = tuned(1.0, "1", 0, 10)  # cost of a unit logarithm of the scale relative to the body's
    max_cost: float = tuned(1.5, "1", 0, 10)  # maximum sum of these costs for a pair


SHELL_PAIRS = ShellPairTuning()


def pair_shells(
    pair: Pair, motion: SimilarityField, ours: list[Part], theirs: list[Part], source: Side, target: Side
) -> tuple[list[tuple[int, int]], list[Similarities]]:
    """Pair shells one to one: their numbers, and the similarities that register them."""
    here = Shells.of([(target.points, target.mesh.triangles[part.triangles]) for part in ours])
    there = Shells.of([(source.points, source.mesh.triangles[part.triangles]) for part in theirs])
    flat = here.sparse.reshape(-1, 3)
    moved = transform_in_blocks(motion, flat, np.zeros_like(flat))[0].reshape(here.sparse.shape)
    prior = procrustes(here.sparse, moved, None, motion.handedness)  # how the body moves each shell
    # Regions only exclude pairs. A bonus for shared regions would pair a left shoe with a right one, because both are
    # shoes.
    strangers = np.isinf(
        relation_of(
            target.members([of_target for _, of_target in pair.regions])[: len(ours)],
            source.members([of_source for of_source, _ in pair.regions])[: len(theirs)],
        )
    )
    i, j = _rivals(here, there, prior, strangers)
    if not len(i):
        return [], []
    found, miss = register_shells(here, there, i, j, prior, motion.handedness)
    cost = _cost(here, there, i, j, prior, found, miss)
    table = np.full((len(ours), len(theirs)), 10 * SHELL_PAIRS.max_cost)
    table[i, j] = np.minimum(cost, 10 * SHELL_PAIRS.max_cost)
    number = np.zeros(table.shape, dtype=np.int64)
    number[i, j] = np.arange(len(i))
    assigned = np.column_stack(scipy.optimize.linear_sum_assignment(table)).tolist()
    chosen = [(a, b) for a, b in assigned if table[a, b] <= SHELL_PAIRS.max_cost]
    return chosen, [found[number[a, b] : number[a, b] + 1] for a, b in chosen]


def _rivals(here: Shells, there: Shells, prior: Similarities, strangers: Booleans) -> tuple[Integers, Integers]:
    """Pairs (q,), (q,) of shells that are near each other, of similar size, and may be registered.

    `prior` are the motions of the target's shells with the body, `strangers` (n_t, n_s) pairs that may not be.
    """
    images = prior(here.centre[:, None])[:, 0]
    size = prior.scale * here.size
    apart = np.linalg.norm(images[:, None] - there.centre, axis=2)
    unlike = np.abs(np.log(size[:, None] / there.size))
    rough = apart / SHELL_PAIRS.max_move + unlike / np.log(SHELL_PAIRS.max_unlike)
    # On 13 pairs of characters these two limits changed no figure: they save up to half of the registrations.
    too_far = apart > SHELL_PAIRS.max_move + size[:, None] / 2
    rough[(unlike > np.log(SHELL_PAIRS.max_unlike)) | too_far | strangers] = np.inf
    nearest = np.argsort(rough, axis=1, kind="stable")[:, : SHELL_PAIRS.rivals]
    i, j = np.repeat(np.arange(len(rough)), nearest.shape[1]), nearest.ravel()
    possible = np.isfinite(rough[i, j])
    return i[possible], j[possible]


def _cost(
    here: Shells,
    there: Shells,
    i: Integers,
    j: Integers,
    prior: Similarities,
    found: Similarities,
    miss: Floats,
) -> Floats:
    """(q,) costs of pairs i, j (q,) that were registered by `found` with residuals `miss` (q,)."""
    miss = miss / there.size[j]
    images = prior(here.centre[:, None])[:, 0]
    move = np.linalg.norm(found(here.centre[i][:, None])[:, 0] - images[i], axis=1)
    cosine = (np.einsum("qij,qij->q", found.rotation, prior.rotation[i]) - 1) / 2
    cost = (
        SHELL_PAIRS.miss_cost * miss / SHELL_PAIRS.max_miss
        + SHELL_PAIRS.move_cost * move / SHELL_PAIRS.max_move
        + SHELL_PAIRS.turn_cost * np.arccos(np.clip(cosine, -1, 1))
        + SHELL_PAIRS.scale_cost * np.abs(np.log(found.scale / prior.scale[i]))
    )
    cost[(miss > SHELL_PAIRS.max_miss) | (move > SHELL_PAIRS.max_move)] = np.inf
    return np.asarray(cost)
