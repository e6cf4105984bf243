# SPDX-License-Identifier: GPL-3.0-or-later
"""Votes on values that cannot be mixed, and on the island that a face belongs to.

If the samples of a face disagree, its neighbours influence the choice, which minimises the length of the border between
faces that disagree (a Potts model, by iterated conditional modes: Besag, On the statistical analysis of dirty pictures,
1986). Faces only take values that one of their own samples voted for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.transfer.cut_mesh import expand_ranges

# Weight of a face's votes relative to the length of border, in perimeters of the face: a border shortened by this much
# outweighs all samples of the face.
VOTE_WEIGHT = 1.0


@dataclass(frozen=True, eq=False)
class Candidates:
    """The candidates of each face, ordered by face, at least one for each.

    Attributes:
        face: (k,) the face of each candidate.
        share: (k,) its share of the face's votes, in [0, 1].
    """

    face: Integers
    share: Floats

    @property
    def range(self) -> tuple[Integers, Integers]:
        """(f,) first candidate of each face, and (f,) one past its last."""
        end = np.cumsum(np.bincount(self.face))
        return np.concatenate([[0], end[:-1]]), end

    def pairs(self, first_face: Integers, second_face: Integers) -> tuple[Integers, Integers, Integers]:
        """All pairs of candidates of one face and another.

        Args:
            first_face: (e,) one face of each edge.
            second_face: (e,) the other face.

        Returns:
            (p,) the edge, (p,) the candidate of its first face and (p,) of its second.
        """
        start, end = self.range
        every = np.arange(len(self.face))
        edge, first = expand_ranges(np.arange(len(first_face)), start[first_face], end[first_face], every)
        pair, second = expand_ranges(np.arange(len(edge)), start[second_face[edge]], end[second_face[edge]], every)
        return edge[pair], first[pair], second

    def contested_edges(self, first: Integers, second: Integers, face: Integers) -> tuple[Integers, Integers]:
        """The edges at which a face has a choice.

        Args:
            first: (e, 2) corners of one face at each edge.
            second: (e, 2) corners of the other.
            face: (c,) the face of each corner.
        """
        choice = np.bincount(self.face) > 1
        kept = choice[face[first[:, 0]]] | choice[face[second[:, 0]]]
        return first[kept], second[kept]


def tally(owner: Integers, code: Integers, weight: Floats) -> tuple[Candidates, Integers]:
    """Count votes.

    Args:
        owner: (q,) the face that each vote is for; every face has one.
        code: (q,) the value that is voted for.
        weight: (q,) the weight of the vote.

    Returns:
        The candidates, and (k,) the code of each.
    """
    count = code.max() + 1
    key, inverse = np.unique(owner * count + code, return_inverse=True)
    votes = np.bincount(inverse, weight)
    owner, code = np.divmod(key, count)
    return Candidates(owner, votes / np.bincount(owner, votes)[owner]), code


def elect(
    candidates: Candidates,
    loyalty: Floats,
    first: Integers,
    second: Integers,
    length: Floats,
    agree: Booleans,
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
    start = np.flatnonzero(np.diff(face, prepend=-1))
    top = np.flatnonzero(score >= np.maximum.reduceat(score, start)[face])
    return top[np.flatnonzero(np.diff(face[top], prepend=-1))]
