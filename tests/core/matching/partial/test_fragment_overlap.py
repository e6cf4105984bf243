# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps of two fragments are ordered by how much alike the fragments are where they overlap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from creatures import creature
from pieces import PartAndWhole, analyse_piece, piece_of

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.partial import part_match
from zoomout_core.matching.partial.fragment_overlap import FRAGMENT_OVERLAP, OVERLAP_COST, overlap_cost
from zoomout_core.matching.partial.incomplete_shape import INCOMPLETE, IncompleteShape, at_scale
from zoomout_core.matching.partial.part_candidates import PART_CANDIDATES, _by_cost, register_places
from zoomout_core.matching.partial.part_match import PART_MATCH, fit_part
from zoomout_core.matching.partial.part_registration import RegisteredPart
from zoomout_core.matching.partial.region import Region
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.tuning import retune


@pytest.fixture(scope="module")
def same() -> PartAndWhole:
    """A piece of a creature and the same piece again, so that every vertex corresponds to itself."""
    made = creature(1000, seed=0, asymmetry=0.3)
    piece = piece_of(made, made.directions @ [0.87, -0.08, -0.49] > -0.24)
    shapes = [at_scale(analyse_piece(piece), 1.0) for _ in range(2)]
    return PartAndWhole(piece, piece, IncompleteShape(shapes[0]), IncompleteShape(shapes[1]))


@pytest.fixture(scope="module")
def fitted(same: PartAndWhole) -> RegisteredPart:
    return register_places(np.arange(len(same.part.between)), same.everywhere).registered


def test_fragments_have_a_cost_that_orders_them_and_parts_of_wholes_their_fit(same: PartAndWhole) -> None:
    places = np.arange(len(same.part.between))
    fragments = register_places(places, same.everywhere)
    assert fragments.cost == fragments.scores[OVERLAP_COST] != fragments.scores["fit"]
    worse = replace(fragments, scores=fragments.scores | {"fit": -9.0, OVERLAP_COST: fragments.cost + 1})
    assert _by_cost([worse, fragments]) == [fragments, worse]
    with retune(INCOMPLETE, fragment=100.0):
        shapes = (IncompleteShape(each.shape) for each in (same.part, same.whole))
        part = register_places(places, Region.everywhere(*shapes))
    assert OVERLAP_COST not in part.scores
    assert part.cost == part.scores["fit"]


@pytest.mark.parametrize(
    ("part", "whole", "everywhere"), [(True, True, True), (True, True, False), (True, False, True), (False, True, True)]
)
def test_only_maps_between_two_fragments_are_compared_by_their_overlap(
    part: bool, whole: bool, everywhere: bool
) -> None:
    nothing: Any = None
    shapes: list[Any] = [SimpleNamespace(is_fragment=each) for each in (part, whole)]
    region = Region(*shapes, nothing, nothing, None if everywhere else np.zeros(1, dtype=int))
    assert region.is_between_fragments == (part and whole and everywhere)


def test_shared_area_counts_less_than_in_the_fit_of_a_part(same: PartAndWhole, fitted: RegisteredPart) -> None:
    """Half of a fragment beyond a cut raises the cost by the weight of the logarithm of the other half."""
    areas = same.part.shape.basis.areas
    half = np.cumsum(areas) > 0.5 * areas.sum()
    nowhere = replace(fitted, agreement=np.zeros(len(areas)))  # the overlap is empty either way
    whole, beyond = (
        overlap_cost(replace(nowhere, on_cut=each), same.everywhere) for each in (np.zeros_like(half), half)
    )
    assert beyond - whole == pytest.approx(FRAGMENT_OVERLAP.within * np.log(2), abs=0.02)
    assert FRAGMENT_OVERLAP.within < PART_CANDIDATES.beyond


def flatten_curvature(region: Region) -> None:
    curvature = np.zeros_like(region.part.shape.vertex_curvature)
    region.whole.shape.__dict__["vertex_curvature"] = curvature


def forget_likeness(region: Region) -> None:
    region.__dict__["unlike"] = np.ones_like(region.unlike)


@pytest.mark.parametrize("change", [flatten_curvature, forget_likeness])
def test_likeness_of_the_shared_area_lowers_the_cost(
    same: PartAndWhole, fitted: RegisteredPart, change: Callable[[Region], None]
) -> None:
    whole = replace(same.whole.shape)
    region = Region.everywhere(same.part, IncompleteShape(whole))
    before = overlap_cost(fitted, region)
    change(region)
    assert overlap_cost(fitted, region) > before + 1


@pytest.mark.parametrize(
    "apart",
    [
        {"residual": FRAGMENT_OVERLAP.residual + 0.01},
        {"agreement": FRAGMENT_OVERLAP.agreement - 0.1},
        {"is_near": False},
        {"on_cut": True},
    ],
)
def test_only_the_area_that_overlaps_is_compared(
    same: PartAndWhole, fitted: RegisteredPart, apart: dict[str, float | bool]
) -> None:
    """Elsewhere images are wrong; a fragment without an overlap is as unlike as any."""
    count = len(fitted.residual)
    elsewhere = np.arange(count) % 2 == 0
    turned = np.roll(np.arange(count), count // 2)
    closest = replace(
        fitted.closest,
        triangle=np.where(elsewhere, fitted.closest.triangle[turned], fitted.closest.triangle),
        barycentric=np.where(elsewhere[:, None], fitted.closest.barycentric[turned], fitted.closest.barycentric),
    )
    wrong = replace(fitted, closest=closest)
    ((name, value),) = apart.items()
    ignored = replace(wrong, **{name: np.where(elsewhere, value, getattr(fitted, name))})
    nothing = replace(wrong, **{name: np.full(count, value)})
    of_ignored, of_wrong, of_nothing = (overlap_cost(each, same.everywhere) for each in (ignored, wrong, nothing))
    assert of_ignored < of_wrong - 1
    assert of_nothing > of_wrong


def test_shared_area_of_fragments_is_smooth_and_ends_at_cuts(same: PartAndWhole) -> None:
    """A single vertex that is too far away follows its surroundings, and others may be farther than on a whole."""
    found = register_places(np.arange(len(same.part.between)), same.everywhere)
    deep = same.part.cut_distance_of_vertices
    speck, on_cut = np.arange(len(deep)) == np.argmax(deep), deep < 0.2
    farther = np.arange(len(deep)) % 2 == 0
    residual = np.where(farther, (PART_MATCH.residual + PART_MATCH.residual_of_fragments) / 2, 0.0)
    finished = replace(found.registered, residual=np.where(speck, 1.0, residual), on_cut=on_cut)
    nothing: Any = None
    one = Candidate("", False, False, nothing, nothing, nothing, None, None, 0.0, {}, replace(found, finished=finished))
    shapes = same.whole.shape, same.part.shape
    pair = Pair(same.made_whole.surface, same.made_part.surface, *shapes, 60, 20)
    with retune(PART_MATCH, smooth_overlap=0.15):  # the mesh is coarse
        shared = fit_part(pair, one).partners.target
    assert shared[speck].all()
    assert shared[deep > 0.3].all()
    assert not shared[deep < 0.1].any()
    with retune(INCOMPLETE, fragment=100.0):
        shapes_as_parts = (IncompleteShape(each.shape) for each in (same.part, same.whole))
        part_of_whole = replace(one.part_match, region=Region.everywhere(*shapes_as_parts), finished=finished)
        shared = fit_part(pair, replace(one, part_match=part_of_whole)).partners.target
    near = ~farther & ~speck & found.registered.is_near & (found.registered.agreement > 0)
    assert (shared == near).all()
    assert shared[on_cut].any()


def test_vertices_with_images_on_cuts_of_the_bent_fragment_are_not_shared(
    same: PartAndWhole, fitted: RegisteredPart, monkeypatch: pytest.MonkeyPatch
) -> None:
    deep, nothing = same.part.cut_distance_of_vertices, cast(Any, None)
    itself = SurfaceMap.from_vertices(np.arange(len(deep)), same.part.shape.proxy.full)
    monkeypatch.setattr(part_match, "_on_part", lambda *_: (itself, np.ones(len(deep), dtype=bool)))
    monkeypatch.setattr(part_match, "_majority", lambda chosen, _: chosen)
    found = replace(register_places(np.arange(len(same.part.between)), same.everywhere), finished=fitted)
    one = Candidate("", False, False, nothing, nothing, nothing, None, None, 0.0, {}, found)
    pair = Pair(same.made_whole.surface, same.made_part.surface, same.whole.shape, same.part.shape, 60, 20)
    assert (fit_part(pair, one).partners.source == (deep > 0)).all()
