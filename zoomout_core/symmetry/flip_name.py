# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of the other side: Arm.L and Arm.R, l_hand and r_hand, LeftFoot and RightFoot, paired as in Blender.

Rigs of other programs have the side in the middle of a name, which Blender ignores: mixamorig:LeftArm, Bip01 L Thigh,
J_Bip_L_UpperArm. These are paired if both names exist.
"""

from __future__ import annotations

import re
from collections.abc import Container

SEPARATORS = ". -_"
LETTERS = {"l": "r", "r": "l", "L": "R", "R": "L"}
# Side words with their partners: in lower case, capitalised, and in upper case.
WORDS = {"right": ("left", "Left", "LEFT"), "left": ("right", "Right", "RIGHT")}
# Shorter names have no side: minimum length with a letter, and with a word.
SHORTEST_WITH_LETTER, SHORTEST_WITH_WORD = 3, 6
# A side in the middle of a name: a letter between separators, or a word.
MIDST = re.compile(r"(?<=[. _:-])[lrLR](?=[. _:-])|left|right|Left|Right|LEFT|RIGHT")


def flip_name(name: str, strip_digits: bool = False) -> str:
    """The name of the partner on the other side; the same name if it has no side.

    The side is at the beginning or end: a letter separated by one of ". -_", or the word in any spelling. A number at
    the end, such as .001, does not count as a part of the name.

    Args:
        name: name of a vertex group, a bone or a shape key.
        strip_digits: whether to drop that number.

    Returns:
        The same as `bpy.utils.flip_name`.
    """
    if len(name) < SHORTEST_WITH_LETTER:
        return name
    stem, number = _without_number(name)
    number = "" if strip_digits else number
    if len(stem) > 1 and stem[-2] in SEPARATORS and stem[-1] in LETTERS:
        return stem[:-1] + LETTERS[stem[-1]] + number
    if len(stem) > 1 and stem[1] in SEPARATORS and stem[0] in LETTERS:
        return LETTERS[stem[0]] + stem[1:] + number
    if len(stem) >= SHORTEST_WITH_WORD:
        for word in WORDS:
            at = stem.lower().find(word)
            end = at + len(word)
            if at in (0, len(stem) - len(word)):
                return stem[:at] + _other_side(stem[at:end]) + stem[end:] + number
    return stem + number


def partner_of(name: str, names: Container[str | None]) -> str:
    """The name of the partner on the other side; the same name if it has no side.

    A side in the middle of the name counts only if the names contain the other side's name.
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
    """The letter or word of the other side, in the spelling of the first two letters."""
    if side in LETTERS:
        return LETTERS[side]
    small, capital, capitals = WORDS[side.lower()]
    if side[0].islower():
        return small
    return capitals if side[1].isupper() else capital


def _without_number(name: str) -> tuple[str, str]:
    """Split a name from its number, such as .001; the second part may be empty."""
    stem, period, ending = name.rpartition(".")
    numbered = period and name[-1] in "0123456789" and ending[0] in "0123456789"
    return (stem, period + ending) if numbered else (name, "")
