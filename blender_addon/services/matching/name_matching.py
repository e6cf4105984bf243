# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects of two characters whose names match: `King_Body` and `Casual_Body`, `visor` and `visor.001`.

Names are compared by their common words, weighted by rarity. The character's own name, which most of its objects share,
is ignored. Only clear matches are returned, because a wrong pair is worse than none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.transfer.keys.key_words import COPY, SIDES, words_of

# A word that at least this fraction of a character's objects share, and the other character lacks, is its own name.
OWN_NAME = 0.75
# Minimum similarity, the weighted fraction of common words, of matching names; and the maximum similarity of any other
# name, as a fraction of that.
MIN_SIMILARITY, MAX_RUNNER_UP = 0.6, 0.75


class Words(NamedTuple):
    """The words of a name.

    Attributes:
        plain: words in lower case, except those for a side.
        sides: "left", "right", both or none.
    """

    plain: frozenset[str]
    sides: frozenset[str]

    @classmethod
    def of(cls, name: str) -> Words:
        """The words of an object's name, without the number that Blender appends."""
        found = {_plain(word) for word in words_of(name)}
        return cls(frozenset(found.difference(SIDES)), frozenset(SIDES[word] for word in found.intersection(SIDES)))


def pair_by_name(sources: Sequence[str], targets: Sequence[str]) -> list[tuple[int, int]]:
    """Pairs of objects with clearly similar names; each object is in at most one pair.

    Equal names always match, apart from a number that Blender appended, unless several objects of a character share
    the name. Left never matches right. There are no pairs if a character has a single object, which corresponds to the
    whole other character.

    Args:
        sources: names of one character's objects.
        targets: names of the other character's objects.

    Returns:
        Numbers of the source and the target of each pair, in order of targets.
    """
    if min(len(sources), len(targets)) < 2:
        return []
    similarity = _similarities([Words.of(name) for name in sources], [Words.of(name) for name in targets])
    for i, j in _equal(sources, targets):
        similarity[i], similarity[:, j] = 0, 0
        similarity[i, j] = 1
    return [(i, j) for j, i in enumerate(_clear_winners(similarity)) if i >= 0]


def _plain(word: str) -> str:
    """A word in lower case in normal form: in the singular, numbers without leading zeros."""
    if word.isdigit():
        return word.lstrip("0") or "0"
    return word[:-1] if len(word) > 3 and word.endswith("s") and not word.endswith("ss") else word


def _equal(sources: Sequence[str], targets: Sequence[str]) -> list[tuple[int, int]]:
    """Pairs of objects with the same name, which is unique on either side."""
    ours, theirs = ([COPY.sub("", name) for name in names] for names in (sources, targets))
    unique = {name for name in ours if ours.count(name) == theirs.count(name) == 1}
    return [(ours.index(name), theirs.index(name)) for name in sorted(unique)]


def _similarities(sources: Sequence[Words], targets: Sequence[Words]) -> Floats:
    """(p, q) weighted fraction of the words that two names share; 0 if their sides differ."""
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
    """The words that most objects of a character share, and the other character lacks."""
    return {word for word, number in count.items() if number >= OWN_NAME * objects and not of_other[word]}


def _clear_winners(similarity: Floats) -> list[int]:
    """(q,) for each target the source if both are by far the most similar to each other; -1 for none."""
    winners = []
    for j in range(similarity.shape[1]):
        i = int(np.argmax(similarity[:, j]))
        best = similarity[i, j]
        others = max(np.delete(similarity[:, j], i).max(initial=0), np.delete(similarity[i], j).max(initial=0))
        winners.append(i if best >= MIN_SIMILARITY and others <= MAX_RUNNER_UP * best else -1)
    return winners
