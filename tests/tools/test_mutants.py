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


def test_mutants_zero_weights_and_invert_conditions() -> None:
    changes = [mutant.change for mutant in chosen_mutants("a.py", CODE, None, 0, None)]
    for after in (
        "WEIGHT = 0",
        "return None if not x is None else WEIGHT * x",
        "return None if x is None else WEIGHT / x",
    ):
        assert any(change.endswith(f"+ {after}") for change in changes)


def test_strings_and_annotations_are_not_mutated() -> None:
    assert {line for _, _, line in mutations(CODE)} == {2, 7}


def test_ranges_of_tuned_numbers_are_left_alone() -> None:
    changes = [mutant.change for mutant in chosen_mutants("a.py", 'tuned(0.3, "1", 2, 7)\n', None, 0, None)]
    assert changes
    assert all(change.endswith('"1", 2, 7)') for change in changes)


def test_inferred_reshape_size_is_not_mutated() -> None:
    changes = [mutant.change for mutant in chosen_mutants("a.py", "x.reshape(-1, 9)\n", None, 0, None)]
    assert changes
    assert all("+ x.reshape(-1, " in change for change in changes)


def test_sample_is_reproducible_by_seed_and_has_requested_size() -> None:
    first, again, other = (chosen_mutants("a.py", CODE * 5, 6, seed, None) for seed in (1, 1, 2))
    assert len(first) == 6
    assert first == again
    assert first != other


def test_nearest_tests_import_the_module_or_share_its_folder(tmp_path: Path) -> None:
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
