# SPDX-License-Identifier: GPL-3.0-or-later
"""Every public name has an example that runs."""

from __future__ import annotations

import doctest
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from creatures import creature, true_vertex

import zoomout_core as zo

pytestmark = pytest.mark.usefixtures("remember_matches")


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    """The names that examples may use."""
    here, there = creature(500), creature(450, seed=1, bend=0.9)
    source, target = here.surface, there.surface
    return {
        "zo": zo,
        "np": np,
        "source": source,
        "target": target,
        "truth": true_vertex(here, there),
        "bases": (zo.eigenbasis(source, 60), zo.eigenbasis(target, 60)),
        "result": zo.match(source, target, k_final=40),
    }


@pytest.mark.parametrize("name", zo.__all__)
def test_the_example_runs(name: str, names: dict[str, Any], tmp_path: Path) -> None:
    text = getattr(zo, name).__doc__
    example = doctest.DocTestParser().get_doctest(text, {**names, "folder": tmp_path}, name, None, None)
    assert example.examples, f"zo.{name} has no example"
    said: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS, verbose=False).run(example, out=said.append)
    assert not said, "".join(said)
