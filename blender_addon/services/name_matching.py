# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects of two characters whose names match: `King_Body` and `Casual_Body`, `visor` and `visor.001`.

Names are compared by their common words, weighted by rarity. The character's own name, which most of its objects share,
is ignored. Only clear matches are returned: a wrong pair does more harm than none.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Floats

# What Blender appends to a name that is taken.
COPY = re.compile(r"\.\d{3,}$")
# Where a word begins within letters: armUpper, LEye.
NEW_WORD = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
WORD = re.compile(r"[^\W\d_]+|\d+")
SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
# Part of a character's objects from which a word that they share, and the other character lacks, is its own name.
OWN_NAME = 0.75
# Smallest similarity, the weighted part of words in common, at which names match; and the largest similarity of any
# other name, as a part of that.
MIN_SIMILARITY, MAX_RUNNER_UP = 0.6, 0.75


class Words(NamedTuple):
    """The words of a name.

    Attributes:
        plain: in small letters, but those that say a side.
        sides: "left" and "right", as far as they are there.
    """

    plain: frozenset[str]
    sides: frozenset[str]

    @classmethod
    def of(cls, name: str) -> Words:
        """Those of an object's name, without the number that Blender appends."""
        found = {_plain(word) for word in WORD.findall(NEW_WORD.sub(" ", COPY.sub("", name)))}
        return cls(frozenset(found.difference(SIDES)), frozenset(SIDES[word] for word in found.intersection(SIDES)))


def pair_by_name(sources: Sequence[str], targets: Sequence[str]) -> list[tuple[int, int]]:
    """Pairs of objects, each in one pair at most, that are clearly called alike.

    Equal names bind, whatever number Blender appended, unless several objects of one character have the same. Left
    and right are never confused. A character of a single object is all of the other one, whatever it is called.

    Args:
        sources: names of the one character's objects.
        targets: names of the other one's.

    Returns:
        Numbers of a source and a target for each pair, by target.
    """
    if min(len(sources), len(targets)) < 2:
        return []
    similarity = _similarities([Words.of(name) for name in sources], [Words.of(name) for name in targets])
    for i, j in _equal(sources, targets):
        similarity[i], similarity[:, j] = 0, 0
        similarity[i, j] = 1
    return [(i, j) for j, i in enumerate(_clear_winners(similarity)) if i >= 0]


def _plain(word: str) -> str:
    """A word as others may have written it: in small letters, of one thing rather than several, numbers without 0."""
    word = word.lower()
    if word.isdigit():
        return word.lstrip("0") or "0"
    return word[:-1] if len(word) > 3 and word.endswith("s") and not word.endswith("ss") else word


def _equal(sources: Sequence[str], targets: Sequence[str]) -> list[tuple[int, int]]:
    """Objects of the same name, of which either side has one."""
    ours, theirs = ([COPY.sub("", name) for name in names] for names in (sources, targets))
    unique = {name for name in ours if ours.count(name) == theirs.count(name) == 1}
    return [(ours.index(name), theirs.index(name)) for name in sorted(unique)]


def _similarities(sources: Sequence[Words], targets: Sequence[Words]) -> Floats:
    """(p, q) part of the words that two names share, by weight; none where they are of other sides."""
    counts = [Counter(word for words in each for word in words.plain) for each in (sources, targets)]
    sizes = len(sources), len(targets)
    own_names = _own_name(counts[0], counts[1], sizes[0]) | _own_name(counts[1], counts[0], sizes[1])
    weight = {
        word: np.log1p(min(size / count[word] for count, size in zip(counts, sizes, strict=True) if count[word]))
        for word in (counts[0] + counts[1]).keys() - own_names
    }

    def shared_weight(ours: Words, theirs: Words) -> float:
        every = sum(weight.get(word, 0) for word in ours.plain | theirs.plain)
        common = sum(weight.get(word, 0) for word in ours.plain & theirs.plain)
        return common / every if ours.sides == theirs.sides and every else 0

    return np.array([[shared_weight(ours, theirs) for theirs in targets] for ours in sources]).reshape(sizes)


def _own_name(count: Counter[str], of_other: Counter[str], objects: int) -> set[str]:
    """The words that most objects of a character share, and that the other has not."""
    return {word for word, number in count.items() if number >= OWN_NAME * objects and not of_other[word]}


def _clear_winners(similarity: Floats) -> list[int]:
    """(q,) for each target the source that is most similar to it, and it to that, by far; -1 for none."""
    winners = []
    for j in range(similarity.shape[1]):
        i = int(np.argmax(similarity[:, j]))
        best = similarity[i, j]
        others = max(np.delete(similarity[:, j], i).max(initial=0), np.delete(similarity[i], j).max(initial=0))
        winners.append(i if best >= MIN_SIMILARITY and others <= MAX_RUNNER_UP * best else -1)
    return winners
