# SPDX-License-Identifier: GPL-3.0-or-later
"""Prepare one side of a match: its analysis, and the features that hypotheses need."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Literal

from zoomout_core.matching.hypotheses.extremities import extremities
from zoomout_core.matching.preparation.analysis import ANALYSIS, ShapeAnalysis
from zoomout_core.matching.preparation.memory_cache import cached_analysis
from zoomout_core.matching.preparation.proxy import proxy_size
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.progress import advance, portion

# Features that hypotheses need of each shape alone; they are computed for both shapes in parallel, and cached.
AHEAD: tuple[Callable[[ShapeAnalysis], object], ...] = (
    extremities,
    attrgetter("descriptors"),
    attrgetter("pseudo_scalars"),
    attrgetter("curvature"),
    attrgetter("surroundings"),
)


def prepare_shape(
    part: WorkingMesh,
    k_final: int,  # size of the final functional map, see `MatchOptions`, as for the following
    samples: int,  # number of farthest-point samples for ZoomOut
    seed: int,  # of the eigensolver
    proxy_vertices: int | Literal["auto"] | None,  # size of the proxy of a larger mesh
    ahead: tuple[Callable[[ShapeAnalysis], object], ...] = AHEAD,  # further computations on the shape
) -> ShapeAnalysis:
    """Analyse a connected part of unit area, or read its analysis from the cache."""
    with portion(0.0, 0.97):
        functions = max(k_final, ANALYSIS.min_functions)
        size = proxy_size(len(part.vertices), proxy_vertices)
        shape = cached_analysis(part, functions, samples, seed, size)
    for prepare in ahead:
        advance(0.97)
        prepare(shape)
    return shape
