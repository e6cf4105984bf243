# SPDX-License-Identifier: GPL-3.0-or-later
"""Mutation testing: changed and unchanged code, and the choice of tests."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("cosmic_ray")

from mutants import chosen_mutants, mutations, nearest_tests

CODE = '''"""A module of 3 lines."""
WEIGHT = 0.3


def grown(x: int | None = None) -> float | None:
    """The 2 of them."""
    return None if x is None else WEIGHT * x
'''


def test_a_weight_is_set_to_zero_and_conditions_are_turned_round() -> None:
    changes = [mutant.change for mutant in chosen_mutants("a.py", CODE, None, 0, None)]
    for after in (
        "WEIGHT = 0",
        "return None if not x is None else WEIGHT * x",
        "return None if x is None else WEIGHT / x",
    ):
        assert any(change.endswith(f"+ {after}") for change in changes)


def test_texts_and_types_are_left_alone() -> None:
    assert {line for _, _, line in mutations(CODE)} == {2, 7}


def test_ranges_of_tuned_numbers_are_left_alone() -> None:
    changes = [mutant.change for mutant in chosen_mutants("a.py", 'tuned(0.3, "1", 2, 7)\n', None, 0, None)]
    assert changes
    assert all(change.endswith('"1", 2, 7)') for change in changes)


def test_what_reshape_infers_is_left_alone() -> None:
    changes = [mutant.change for mutant in chosen_mutants("a.py", "x.reshape(-1, 9)\n", None, 0, None)]
    assert changes
    assert all("+ x.reshape(-1, " in change for change in changes)


def test_a_draw_is_the_same_for_the_same_seed_and_keeps_to_its_size() -> None:
    first, again, other = (chosen_mutants("a.py", CODE * 5, 6, seed, None) for seed in (1, 1, 2))
    assert len(first) == 6
    assert first == again
    assert first != other


def test_the_nearest_tests_are_those_that_import_a_module_or_else_those_of_its_folder(tmp_path: Path) -> None:
    for name, text in (
        ("core/maps/test_one.py", "from zoomout_core.maps.field import near"),
        ("core/maps/test_two.py", "from zoomout_core.maps import other, field"),
        ("core/test_three.py", "from zoomout_core.maps.fields import near"),
        ("blender/test_field.py", "of something else"),
    ):
        (tmp_path / "tests" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "tests" / name).write_text(text)
    assert nearest_tests("zoomout_core/maps/field.py", tmp_path) == [
        "tests/core/maps/test_one.py",
        "tests/core/maps/test_two.py",
    ]
    assert nearest_tests("zoomout_core/maps/inner/unknown.py", tmp_path) == [
        "tests/core/maps/test_one.py",
        "tests/core/maps/test_two.py",
    ]
