"""Names change sides as they do in Blender; `tests/blender/test_flip_name.py` compares with Blender itself."""

from __future__ import annotations

import pytest

from zoomout_core.symmetry.flip_name import flip_name

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
def test_both_sides_have_each_others_names(left: str, right: str) -> None:
    assert flip_name(left) == right


@pytest.mark.parametrize("name", ["", "L", ".L", "spine", "brightness", "Left", "arm.L.upper", "arm.L001"])
def test_what_has_no_side_keeps_its_name(name: str) -> None:
    assert flip_name(name) == name


def test_numbers_stay_unless_they_are_stripped() -> None:
    assert flip_name("Arm.L.004") == "Arm.R.004"
    assert flip_name("Arm.L.004", strip_digits=True) == "Arm.R"
    assert flip_name("spine.004", strip_digits=True) == "spine"
