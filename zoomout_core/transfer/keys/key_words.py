# SPDX-License-Identifier: GPL-3.0-or-later
"""The words of key names, and the forms of a name by which names of several programs are compared."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import lru_cache

# The suffix that Blender appends to a name in use.
COPY = re.compile(r"\.\d{3,}$")
# Beginnings of words within letters: armUpper, LEye.
NEW_WORD = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
WORD = re.compile(r"[^\W\d_]+|\d+")
SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
# The node or mesh that a program adds before a name.
NODE = re.compile(r"^.*[.:|](?=.)")
MANY_NAMES = 4096  # names whose forms are cached: those of one head are looked up several times


def words_of(name: str) -> list[str]:
    """The words of a name, in lower case, without the number that Blender appends."""
    return [word.lower() for word in WORD.findall(NEW_WORD.sub(" ", COPY.sub("", name)))]


@lru_cache(MANY_NAMES)
def forms_of(name: str) -> tuple[str, ...]:
    """The forms of a name to compare: its words with a single side at the end, its letters, and both without a node."""
    name = COPY.sub("", name)
    bare = NODE.sub("", name)
    texts = (name, bare if bare.lower() not in SIDES else name)
    return tuple(form for text in texts for form in (_join(words_of(text)), "".join(WORD.findall(text)).lower()))


def _join(words: Sequence[str]) -> str:
    sides = [SIDES[word] for word in words if word in SIDES]
    if len(sides) != 1:
        return "".join(SIDES.get(word, word) for word in words)
    return "".join(word for word in words if word not in SIDES) + sides[0]


def common_words(names: Sequence[str]) -> list[str]:
    """The words that most of the names begin with."""
    every = [words_of(name) for name in names]
    common: list[str] = []
    while every:
        following = Counter(words[len(common)] for words in every if len(words) > len(common) + 1)
        word = max(following, key=lambda each: following[each], default="")
        if 2 * following[word] <= len(names):
            break
        every = [words for words in every if words[: len(common) + 1] == [*common, word]]
        common.append(word)
    return common


def forms_without(prefix: Sequence[str], name: str) -> Iterator[str]:
    """The form of a name without some words at its beginning."""
    words = words_of(name)
    if prefix and words[: len(prefix)] == list(prefix):
        yield _join(words[len(prefix) :])
