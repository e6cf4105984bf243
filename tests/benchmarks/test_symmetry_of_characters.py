# SPDX-License-Identifier: GPL-3.0-or-later
"""Characters as cases of symmetry: bones are exchanged with their partners, and rows report the result."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import LIMBS, creature

import zoomout_core as zo
from benchmarks.characters.cases import Case
from benchmarks.characters.game import Body, Character
from benchmarks.characters.mirrored import AT_REST, WORN, mirrored_bones, symmetry_record, symmetry_rows
from benchmarks.characters.skeleton import Skeleton
from benchmarks.characters.truth import Rest

pytestmark = pytest.mark.slow

BONES = ("Body", "Arm.L", "Arm.R", "Leg.L", "Leg.R", "Head", "Tail", "Weapon.R")
PARENT = (-1, 0, 0, 0, 0, 0, 0, 2)


@pytest.fixture(scope="module")
def character() -> Character:
    """A creature with a bone for each limb; part of its right arm is a weapon."""
    made = creature(900, 0)
    axes = LIMBS / np.linalg.norm(LIMBS, axis=1, keepdims=True)
    bone = 1 + np.argmax(made.directions @ axes.T, axis=1)
    bone[(bone == 2) & (made.directions[:, 1] < -0.3)] = BONES.index("Weapon.R")
    body = Body(made.surface.vertices, made.surface.triangles, np.eye(len(BONES), dtype=np.float32)[bone])
    skeleton = Skeleton(BONES, np.array(PARENT), np.vstack([np.zeros(3), LIMBS, LIMBS[1]]))
    return Character("pack", "creature", skeleton, body, body, body, "none")


def test_bones_map_to_partners_and_lone_bones_to_none(character: Character) -> None:
    truth = mirrored_bones(character)
    column = {name: truth.names.index(name) for name in truth.names}
    for name, other in (("Arm.L", "Arm.R"), ("Leg.R", "Leg.L"), ("Head", "Head")):
        np.testing.assert_array_equal(truth.target[:, column[other]], truth.source[:, column[name]])
    armed = truth.source[:, column["Weapon.R"]] > 0
    assert armed.any()
    assert (truth.target[armed] == 0).all()


def test_a_symmetry_becomes_a_record_and_records_a_row(character: Character) -> None:
    surface = zo.Surface(character.rest.vertices, character.rest.triangles)
    record = symmetry_record(Case(AT_REST, "creature", surface, surface, mirrored_bones(character)))
    assert record["right"]
    assert record["limb"] > 0.95
    assert record["sides"] > 0.95
    wrong = record | {"certainty": 0.95, "right": False, "limb": 0.4}
    (row,) = symmetry_rows([record, wrong])
    assert (row["cases"], row["right"], row["certain and wrong"], row["worst limb"]) == (2, 1, 1, 0.4)


def test_worn_objects_are_measured_at_rest(character: Character) -> None:
    surface = zo.Surface(character.rest.vertices, character.rest.triangles)
    places, part = character.rest.vertices, np.zeros(len(character.rest.vertices), dtype=np.int64)
    rest = Rest(places, places * [-1, 1, 1], 0.02, part, part)
    record = symmetry_record(Case(WORN, "creature", surface, surface, rest))
    assert record["right"]
    assert record["cm"] < 5
    assert record["sides"] > 0.95
