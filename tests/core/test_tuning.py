# SPDX-License-Identifier: GPL-3.0-or-later
"""Tuned numbers declare their meaning, unit, range and the benchmark that set them."""

from __future__ import annotations

import ast
import inspect
import re
from dataclasses import FrozenInstanceError, dataclass, fields, replace
from pathlib import Path

import pytest

import zoomout_core
from zoomout_core.tuning import Tuning, retune, stages, tuned

ROOT = Path(zoomout_core.__file__).parents[1]


@dataclass(frozen=True)
class Toy(Tuning, set_by="tuning"):
    """A stage for tests.

    Attributes:
        width: width of a Gaussian.
        quotas: pairs of quotas.
    """

    width: float = tuned(0.05, "at unit area", 0, 1)
    quotas: tuple[tuple[int, int], ...] = tuned(((1, 4), (2, 8)), "candidates", 1, 100)


def test_numbers_out_of_their_range_are_refused() -> None:
    with pytest.raises(ValueError, match=r"Toy\.width is 2: give 0 to 1 \(at unit area\)"):
        replace(Toy(), width=2)
    with pytest.raises(ValueError, match="quotas"):
        Toy(quotas=((1, 4), (0, 8)))
    with pytest.raises(ValueError, match="width"):
        Toy(width=float("nan"))


def test_retune_changes_numbers_only_within_its_context() -> None:
    toy = Toy()
    with retune(toy, width=0.5):
        assert toy.width == 0.5
    assert toy.width == 0.05
    with pytest.raises(ValueError, match="width"), retune(toy, width=5.0):
        pass
    assert toy == Toy()
    with pytest.raises(FrozenInstanceError):
        toy.width = 0.5  # type: ignore[misc]


def test_every_tuned_number_names_its_meaning_and_benchmark() -> None:
    paths = (ROOT / "benchmarks" / "commands").glob("*.py")
    nodes = [node for path in paths for node in ast.parse(path.read_text(encoding="utf-8")).body]
    commands = {node.name for node in nodes if isinstance(node, ast.FunctionDef)}
    assert stages()
    for name, stage in stages().items():
        text = inspect.getsource(type(stage))
        for each in fields(stage):  # type: ignore[arg-type]
            entry = rf"^        {each.name}: \w"
            comment = rf"(^    #.*\n    {each.name}: |^    {each.name}: .*\)  # \w)"
            assert re.search(rf"{entry}|{comment}", text, re.MULTILINE), f"{name}.{each.name}"
        assert stage.set_by in commands, name
