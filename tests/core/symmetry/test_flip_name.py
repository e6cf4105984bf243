# SPDX-License-Identifier: GPL-3.0-or-later
"""Names flip sides as in Blender; `tests/blender/test_flipped_names.py` compares with Blender itself."""

from __future__ import annotations

import pytest

from zoomout_core.symmetry.flip_name import flip_name, partner_of

PAIRS = [
    ("Arm.L", "Arm.R"),
    ("arm_l", "arm_r"),
    ("finger-R.001", "finger-L.001"),
    ("L foot", "R foot"),
    ("leftHand", "rightHand"),
    ("HandLeft", "HandRight"),
    ("RIGHT_EYE", "LEFT_EYE"),
]


@pytest.mark.parametrize(("left", "right"), [*PAIRS, *(pair[::-1] for pair in PAIRS)])
def test_names_of_both_sides_are_flipped_into_each_other(left: str, right: str) -> None:
    assert flip_name(left) == right


@pytest.mark.parametrize("name", ["", "L", ".L", "spine", "brightness", "Left", "arm.L.upper", "arm.L001", "arm.L.a4"])
def test_name_without_a_side_is_unchanged(name: str) -> None:
    assert flip_name(name) == name


def test_number_suffix_is_kept_unless_stripped() -> None:
    assert flip_name("Arm.L.004") == "Arm.R.004"
    assert flip_name("Arm.L.4") == "Arm.R.4"
    assert flip_name("Arm.L.004", strip_digits=True) == "Arm.R"
    assert flip_name("spine.004", strip_digits=True) == "spine"


INFIXES = [
    ("mixamorig:LeftArm", "mixamorig:RightArm"),
    ("Bip01 L Thigh", "Bip01 R Thigh"),
    ("J_Bip_L_UpperArm", "J_Bip_R_UpperArm"),
    ("CC_Base_l_Hand_01", "CC_Base_r_Hand_01"),
    ("rig-LEFT-foot", "rig-RIGHT-foot"),
    ("upright_left_ear", "upright_right_ear"),
]


@pytest.mark.parametrize(("left", "right"), INFIXES)
def test_side_inside_a_name_counts_if_the_partner_exists(left: str, right: str) -> None:
    assert (partner_of(left, {left, right}), partner_of(right, {left, right})) == (right, left)
    assert partner_of(left, {left}) == left


def test_other_names_have_the_partners_that_blender_gives_them() -> None:
    assert partner_of("Arm.L", ()) == "Arm.R"
    assert partner_of("brightness", {"brightness", "spine"}) == "brightness"
