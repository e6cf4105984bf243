# SPDX-License-Identifier: GPL-3.0-or-later
"""Every public name has an example that runs."""

from __future__ import annotations

import doctest
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from creatures import creature, true_vertex

import zoomout_core as zo
from zoomout_core.evaluation import coverage, distance_distortion, edge_distortion, flipped_share
from zoomout_core.spectral.sampling import farthest_points

pytestmark = pytest.mark.usefixtures("remember_matches", "coarse_hulls")


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    """The names that examples may use."""
    here, there = creature(500, asymmetry=0.3), creature(450, seed=1, bend=0.9, asymmetry=0.3)
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


# Further functions and methods with examples, below `zo`.
INNER = (
    *(f"plotting.plot_{what}" for what in ("map", "confidence", "values", "functional_map", "error_curves")),
    *(f"SurfaceMap.{name}" for name in ("interpolate", "invert", "save", "load")),
    *(f"MatchResult.{name}" for name in ("use", "save")),
    "SpectralBasis.coefficients",
    "Symmetry.sides",
)
MEASURES = coverage, edge_distortion, distance_distortion, flipped_share, farthest_points
# Examples that match several shapes.
SLOW = {"CollectionResult", "Library", "PointCloud", "find_source", "match_collection"}


def _param(name: str) -> Any:
    return pytest.param(name, marks=pytest.mark.slow if name in SLOW else ())


@pytest.mark.parametrize("name", [_param(name) for name in (*zo.__all__, *INNER)])
def test_the_example_runs(name: str, names: dict[str, Any], tmp_path: Path) -> None:
    if name.startswith("plotting"):
        pytest.importorskip("matplotlib")
    run_example(attrgetter(name)(zo).__doc__, name, names, tmp_path)


@pytest.mark.parametrize("measure", MEASURES, ids=lambda measure: measure.__name__)
def test_the_example_of_a_measure_runs(measure: Any, names: dict[str, Any], tmp_path: Path) -> None:
    run_example(measure.__doc__, measure.__name__, names, tmp_path)


def run_example(text: str, name: str, names: dict[str, Any], tmp_path: Path) -> None:
    """Run the example of a docstring."""
    example = doctest.DocTestParser().get_doctest(text, {**names, "folder": tmp_path}, name, None, None)
    assert example.examples, f"zo.{name} has no example"
    said: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS, verbose=False).run(example, out=said.append)
    assert not said, "".join(said)
