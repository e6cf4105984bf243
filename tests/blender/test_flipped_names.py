# SPDX-License-Identifier: GPL-3.0-or-later
"""Names are flipped like Blender's own tools flip them."""

from __future__ import annotations

import random

import bpy

from zoomout_core.symmetry.flip_name import flip_name

SIDES = ["l", "r", "L", "R", "left", "Right", "LEFT", "lEft", "RiGHT"]
PIECES = [*SIDES, ".", "_", "-", " ", "arm", "a", "b1", ".001", ".1a", "2", "0"]


def test_names_flip_as_in_blender() -> None:
    draw = random.Random(0)
    names = {"".join(draw.choice(PIECES) for _ in range(draw.randint(0, 5))) for _ in range(20_000)}
    for name in names:
        for strip in (False, True):
            assert flip_name(name, strip) == bpy.utils.flip_name(name, strip_digits=strip), name
