# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairing objects by similar names."""

import pytest

from blender_addon.services.matching.name_matching import Words, pair_by_name


def pairs(sources, targets):
    return {(sources[i], targets[j]) for i, j in pair_by_name(sources, targets)}


@pytest.mark.parametrize(
    ("name", "plain", "sides"),
    [
        ("King_Body", {"king", "body"}, set()),
        ("leftUpperArm", {"upper", "arm"}, {"left"}),
        ("LEye", {"eye"}, {"left"}),
        ("Glove.R", {"glove"}, {"right"}),
        ("visor.001", {"visor"}, set()),
        ("plate-07 Gloves", {"plate", "7", "glove"}, set()),
        ("Körper", {"körper"}, set()),
    ],
)
def test_names_are_split_into_words(name, plain, sides):
    assert Words.of(name) == (plain, sides)


def test_the_name_of_the_character_is_not_compared():
    king = ["King_Body", "King_Head", "King_Legs", "King_Crown"]
    casual = ["Casual_Head", "Casual_Body", "Casual_Legs", "Casual_Bag"]
    assert pairs(king, casual) == {
        ("King_Body", "Casual_Body"),
        ("King_Head", "Casual_Head"),
        ("King_Legs", "Casual_Legs"),
    }


def test_equal_names_match_despite_appended_numbers():
    sources, targets = ["visor", "suit", "suit visor"], ["suit.001", "visor.001", "belt"]
    assert pairs(sources, targets) == {("visor", "visor.001"), ("suit", "suit.001")}


def test_left_is_not_right():
    assert pairs(["HeroGlove.L", "HeroBody"], ["Scan_glove_r", "Scan_body"]) == {("HeroBody", "Scan_body")}
    sources, targets = ["HeroGlove.L", "HeroGlove.R"], ["Scan right glove", "Scan left glove"]
    assert pairs(sources, targets) == {("HeroGlove.L", "Scan left glove"), ("HeroGlove.R", "Scan right glove")}


def test_name_without_side_matches_neither_side():
    assert pairs(["Boot.L", "Hat"], ["Boots", "Cap"]) == set()


@pytest.mark.parametrize(
    ("sources", "targets"),
    [
        (["Jacket_Fur", "Jacket_Leather"], ["Jacket", "Trousers"]),  # either
        (["Cube", "Cube.001"], ["Cube.002", "Cube.003"]),
        (["Cube", "Cube.001"], ["Cube.002", "Cube.003", "Cube.004"]),
        (["King_Body"], ["Casual_Body", "Casual_Head"]),  # the one is all of the other
        (["Hero_Visor", "Hero_Belt"], ["Hero_Cape", "Hero_Shoe"]),  # the character alone
        (["Arm upper", "Leg upper", "Head"], ["Arm lower", "Leg lower", "Head band"]),
    ],
)
def test_ambiguous_names_are_not_paired(sources, targets):
    assert pairs(sources, targets) == set()


def test_rare_words_count_for_more():
    sources = ["Mesh plate collar", "Mesh plate belt", "Mesh plate knee"]
    targets = ["Mesh collar", "Mesh plate shoe", "Mesh hat"]
    assert pairs(sources, targets) == {("Mesh plate collar", "Mesh collar")}
