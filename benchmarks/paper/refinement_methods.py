# SPDX-License-Identifier: GPL-3.0-or-later
"""The methods of the tables of refinement: ZoomOut and those of its paper, each in both directions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import NamedTuple

import zoomout_core as zo
from benchmarks.baselines.bcicp import Side, bcicp
from benchmarks.baselines.deblur import deblur
from benchmarks.baselines.kernel_matching import kernel_matching
from benchmarks.baselines.rhm import rhm
from benchmarks.baselines.sampled_zoomout import sampled_zoomout
from benchmarks.baselines.spectral_icp import spectral_icp
from benchmarks.datasets import PairOfMeshes
from benchmarks.paper.starts import K_INITIAL
from zoomout_core.arrays import Integers

# Sizes of functional maps in the paper: the final one, and the fixed one.
K_FINAL, STEP, K_FIXED = 120, 5, 50
SAMPLES = 500
CORE, MATCH = "zo.zoomout, samples", "zo.match, nothing given"


class Maps(NamedTuple):
    """The maps that a method computes for a pair.

    Attributes:
        there: (n_t,) source vertex of each target vertex, -1 for none.
        back: (n_s,) target vertex of each source vertex; None if there is no such map.
        seconds: time of the map there, or of both if they are computed together; None for maps from a file.
    """

    there: Integers
    back: Integers | None
    seconds: float | None


@dataclass(frozen=True, eq=False)
class Start:
    """The input of every method.

    Attributes:
        source: the shape with the images, with K_FINAL eigenfunctions.
        target: the shape to be mapped.
        initial: (n_t,) source vertex of each target vertex.
        initial_back: (n_s,) target vertex of each source vertex.
    """

    source: Side
    target: Side
    initial: Integers
    initial_back: Integers

    @classmethod
    def of(cls, pair: PairOfMeshes, initial: Integers, initial_back: Integers) -> Start:
        """Compute the bases of a pair with initial maps there and back."""
        source, target = (Side(surface, zo.eigenbasis(surface, K_FINAL)) for surface in (pair.source, pair.target))
        return cls(source, target, initial, initial_back)

    def swap(self) -> Start:
        """The input of the map in the other direction."""
        return Start(self.target, self.source, self.initial_back, self.initial)


def _each_way(method: Callable[[Start], Integers]) -> Callable[[Start], Maps]:
    """Run a method that computes one map at a time in both directions."""

    def maps(start: Start) -> Maps:
        begin = perf_counter()
        there = method(start)
        seconds = perf_counter() - begin
        return Maps(there, method(start.swap()), seconds)

    return maps


def _together(method: Callable[[Start], tuple[Integers, Integers]]) -> Callable[[Start], Maps]:
    """Run a method that computes the maps in both directions together."""

    def maps(start: Start) -> Maps:
        begin = perf_counter()
        there, back = method(start)
        return Maps(there, back, perf_counter() - begin)

    return maps


def _icp(start: Start) -> Integers:
    return spectral_icp(start.source.basis, start.target.basis, start.initial, K_FIXED).vertex


def _deblur(start: Start) -> Integers:
    return deblur(start.source.basis, start.target.basis, start.initial, K_INITIAL, K_FINAL, STEP).vertex


def _pmf(start: Start) -> tuple[Integers, Integers]:
    return kernel_matching(start.source.basis, start.target.basis, start.initial)


def _rhm(start: Start) -> tuple[Integers, Integers]:
    return rhm(start.source.surface, start.target.surface, start.initial, start.initial_back)


def _bcicp(start: Start) -> tuple[Integers, Integers]:
    there, back = bcicp(start.source, start.target, start.initial, start.initial_back, K_FIXED)
    return there.vertex, back.vertex


def _zoomout(start: Start) -> Integers:
    return zo.zoomout(start.source.basis, start.target.basis, start.initial, K_FINAL, STEP, samples=None).vertex


def _sampled_zoomout(start: Start) -> Integers:
    return sampled_zoomout(start.source.basis, start.target.basis, start.initial, K_FINAL, STEP, SAMPLES).vertex


def _core_zoomout(start: Start) -> Integers:
    """ZoomOut on samples, with the core's last rounds on all vertices."""
    return zo.zoomout(start.source.basis, start.target.basis, start.initial, K_FINAL, STEP, SAMPLES).vertex


def _match(start: Start) -> Maps:
    """Match without the initial map; the match back uses the shapes' cached analysis."""
    zo.forget_shapes()
    source, target = start.source.surface, start.target.surface
    begin = perf_counter()
    there = zo.match(source, target).surface_map.vertex
    seconds = perf_counter() - begin
    return Maps(there, zo.match(target, source).surface_map.vertex, seconds)


METHODS: dict[str, Callable[[Start], Maps]] = {
    "initial": lambda start: Maps(start.initial, start.initial_back, None),
    "ICP": _each_way(_icp),
    "Deblur": _each_way(_deblur),
    "PMF": _together(_pmf),
    "RHM": _together(_rhm),
    "BCICP": _together(_bcicp),
    "ZoomOut": _each_way(_zoomout),
    "ZoomOut*": _each_way(_sampled_zoomout),
    CORE: _each_way(_core_zoomout),
    MATCH: _match,
}
