# SPDX-License-Identifier: GPL-3.0-or-later
"""Votes on values that cannot be mixed, and on the island that a face belongs to.

If the samples of a face disagree, its neighbours influence the choice: the length of the border between faces that
disagree is minimised. This is a Potts model, solved by iterated conditional modes: Besag, On the statistical analysis
of dirty pictures (1986). Faces only take values that one of their own samples voted for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.triangles import edge_lengths
from zoomout_core.transfer.groups import expand_ranges, group_starts
from zoomout_core.transfer.mapped_target import MappedTarget

# Weight of a face's votes relative to the length of a border, in perimeters of the face. A border that becomes shorter
# by this much outweighs all samples of the face.
VOTE_WEIGHT = 1.0


@dataclass(frozen=True, eq=False)
class Candidates:
    """The candidates of each face, ordered by face, at least one for each."""

    face: Integers  # (k,) the face of each candidate
    share: Floats  # (k,) its share of the face's votes, in [0, 1]

    def pairs(self, first_face: Integers, second_face: Integers) -> tuple[Integers, Integers, Integers]:
        """All pairs of candidates of one face and another, for edges between faces (e,) and (e,).

        Returns:
            (p,) the edge, (p,) the candidate of its first face and (p,) of its second.
        """
        end = np.cumsum(np.bincount(self.face))
        start = np.concatenate([[0], end[:-1]])
        edge, first = expand_ranges(start[first_face], end[first_face])
        pair, second = expand_ranges(start[second_face[edge]], end[second_face[edge]])
        return edge[pair], first[pair], second


def tally(owner: Integers, code: Integers, weight: Floats) -> tuple[Candidates, Integers]:
    """Count votes for codes (q,) of faces (q,) with weights (q,); every face has at least one vote.

    Returns the candidates, and (k,) the code of each.
    """
    count = code.max() + 1
    key, inverse = np.unique(owner * count + code, return_inverse=True)
    votes = np.bincount(inverse, weight)
    owner, code = np.divmod(key, count)
    return Candidates(owner, votes / np.bincount(owner, votes)[owner]), code


def elect_for_faces(
    candidates: Candidates, mapped: MappedTarget, agree: Callable[[Integers, Integers, Integers, Integers], Booleans]
) -> Integers:
    """(f,) the chosen candidate of each face of the target; borders between faces are measured by their edges.

    Args:
        candidates: the k candidates of f faces.
        mapped: the target on the source.
        agree: a function that returns for pairs of candidates whether there is no border between them. It takes the
            candidates (p,) and (p,), and the corners (p, 2) and (p, 2) of both faces at their common edges.
    """
    target, choice = mapped.target, np.bincount(candidates.face) > 1
    first, second = mapped.adjacent
    contested = choice[target.corner_face[first[:, 0]]] | choice[target.corner_face[second[:, 0]]]
    first, second = first[contested], second[contested]
    edge, one, other = candidates.pairs(target.corner_face[first[:, 0]], target.corner_face[second[:, 0]])
    length = edge_lengths(target.vertices[target.corner_vertex], first)[edge]
    agreeing = agree(one, other, first[edge], second[edge])
    return elect(candidates, VOTE_WEIGHT * mapped.circumference, one, other, length, agreeing)


def elect(
    candidates: Candidates, loyalty: Floats, first: Integers, second: Integers, length: Floats, agree: Booleans
) -> Integers:
    """Choose a candidate for each face, with a short border between faces that disagree.

    Args:
        candidates: the k candidates of f faces.
        loyalty: (f,) length of border that outweighs all votes of a face.
        first: (p,) first candidates of all relevant pairs.
        second: (p,) second candidates, of a neighbouring face.
        length: (p,) length of the edge between the two faces.
        agree: (p,) whether there is no border between the two.

    Returns:
        (f,) the chosen candidates.
    """
    face, count = candidates.face, len(candidates.face)
    own = loyalty[face] * candidates.share
    chosen = _best(face, own)
    here, there = np.concatenate([first, second]), np.concatenate([second, first])
    bond = np.concatenate([length * agree, length * agree])
    while True:
        taken = np.zeros(count, dtype=bool)
        taken[chosen] = True
        support = own + np.bincount(here, bond * taken[there], minlength=count)
        best = _best(face, support)
        gain = support[best] - support[chosen]
        gain[gain <= 1e-9 * (loyalty + loyalty.mean())] = 0
        if not gain.any():
            return chosen
        # If two neighbours would change, only the one that gains more does, so the border always shortens.
        rank = np.empty(len(gain), dtype=np.int64)
        rank[np.argsort(gain, kind="stable")] = np.arange(len(gain))
        highest = rank.copy()
        np.maximum.at(highest, face[here], rank[face[there]])
        chosen = np.where((gain > 0) & (highest == rank), best, chosen)


def _best(face: Integers, score: Floats) -> Integers:
    """(f,) the candidate of each face with the highest score; the first one of ties."""
    top = np.flatnonzero(score >= np.maximum.reduceat(score, group_starts(face))[face])
    return top[group_starts(face[top])]
