# SPDX-License-Identifier: GPL-3.0-or-later
"""The other side's name: Arm.L and Arm.R, l_hand and r_hand, LeftFoot and RightFoot, paired as Blender does.

Rigs of other programs have the side in the midst of a name, which Blender does not read: mixamorig:LeftArm, Bip01 L
Thigh, J_Bip_L_UpperArm. Those are paired where both names are there.
"""

from __future__ import annotations

import re
from collections.abc import Container

SEPARATORS = ". -_"
LETTERS = {"l": "r", "r": "l", "L": "R", "R": "L"}
# Whole words, with the words that stand for them: as written small, with a capital, or all in capitals.
WORDS = {"right": ("left", "Left", "LEFT"), "left": ("right", "Right", "RIGHT")}
# Names that are shorter have no side, by a letter or by a word.
SHORTEST_WITH_LETTER, SHORTEST_WITH_WORD = 3, 6
# A side in the midst of a name: a letter that is set off on both sides, or a word.
MIDST = re.compile(r"(?<=[. _:-])[lrLR](?=[. _:-])|left|right|Left|Right|LEFT|RIGHT")


def flip_name(name: str, strip_digits: bool = False) -> str:
    """The name of the same thing on the other side; the name itself where it has no side.

    The side stands at the beginning or at the end: a letter set off by one of ". -_", or the word in any spelling.
    A number at the end, such as .001, does not count as a part of the name.

    Args:
        name: of a vertex group, a bone or a shape key.
        strip_digits: leave that number away.

    Returns:
        What `bpy.utils.flip_name` returns.
    """
    if len(name) < SHORTEST_WITH_LETTER:
        return name
    stem, number = _without_number(name)
    if strip_digits:
        number = ""
    if len(stem) > 1 and stem[-2] in SEPARATORS and stem[-1] in LETTERS:
        return stem[:-1] + LETTERS[stem[-1]] + number
    if len(stem) > 1 and stem[1] in SEPARATORS and stem[0] in LETTERS:
        return LETTERS[stem[0]] + stem[1:] + number
    if len(stem) >= SHORTEST_WITH_WORD:
        for word, others in WORDS.items():
            at = stem.lower().find(word)
            if at in (0, len(stem) - len(word)):
                found = stem[at : at + len(word)]
                other = others[0] if found[0].islower() else others[2] if found[1].isupper() else others[1]
                return stem[:at] + other + stem[at + len(word) :] + number
    return stem + number


def counterpart_of(name: str, names: Container[str | None]) -> str:
    """The name of the same thing on the other side; the name itself where it has no side.

    Args:
        name: of a vertex group, a bone, a shape key or a material.
        names: of all of these. A side in the midst of a name counts only if the other side's name is among them.
    """
    flipped = flip_name(name)
    if flipped != name:
        return flipped
    for side in MIDST.finditer(name):
        other = name[: side.start()] + _other_side(side.group()) + name[side.end() :]
        if other in names:
            return other
    return name


def _other_side(side: str) -> str:
    """The other one of two letters or words."""
    if side in LETTERS:
        return LETTERS[side]
    small, capital, capitals = WORDS[side.lower()]
    return small if side.islower() else capitals if side.isupper() else capital


def _without_number(name: str) -> tuple[str, str]:
    """Split a name from its number, such as .001; the second part may be empty."""
    stem, period, ending = name.rpartition(".")
    numbered = period and name[-1] in "0123456789" and ending[0] in "0123456789"
    return (stem, period + ending) if numbered else (name, "")
