# SPDX-License-Identifier: GPL-3.0-or-later
"""A target that is only a part of a character, such as a bust, finds its whole, at any scale and rotation."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from transfer_meshes import sphere

import zoomout_core as zo
from zoomout_core.library import asset_match as asset_match_module
from zoomout_core.library import search as search_module
from zoomout_core.library import wholes as wholes_module
from zoomout_core.library.bodies import MAIN_PART, Body, LibraryAsset, analyse_body, bodies_of
from zoomout_core.library.search import search
from zoomout_core.library.surroundings import FEATURES, SURROUNDINGS, PartSurroundings, surroundings_of
from zoomout_core.library.wholes import WHOLES, FoundWhole, find_wholes
from zoomout_core.matching.partial.incomplete_shape import at_scale
from zoomout_core.matching.partial.part_candidates import PART_CANDIDATES
from zoomout_core.matching.partial.unknown_scale import RoughPlace
from zoomout_core.matching.ranking.certainty import PART_CERTAINTY
from zoomout_core.samples import creature, directions
from zoomout_core.tuning import retune

pytestmark = pytest.mark.usefixtures("quick_search", "coarse_hulls")


def upper_half() -> zo.Surface:
    """The head, arms and chest of a bent creature, cut open below, rotated and in another unit."""
    made = creature(1600, seed=1, bend=0.5, asymmetry=0.3)
    kept = made.directions[made.surface.triangles][:, :, 2].min(axis=1) > -0.2
    used, corner = np.unique(made.surface.triangles[kept], return_inverse=True)
    turn = Rotation.from_euler("xyz", [40, 100, 200], degrees=True)
    return zo.Surface(turn.apply(made.surface.vertices[used]) * 170 + 30, corner.reshape(-1, 3))


@pytest.fixture(scope="module")
def part() -> Body:
    return bodies_of(upper_half())[MAIN_PART]


@pytest.fixture(scope="module")
def assets() -> list[LibraryAsset]:
    """A creature without arms, and the whole creature of the part."""
    whole = creature(1300, seed=0, asymmetry=0.3).surface
    armless = whole.with_vertices(whole.vertices * [0.4, 1, 1])
    return [LibraryAsset(Path(f"{name}.glb"), bodies_of(each)) for name, each in (("narrow", armless), ("own", whole))]


def test_surroundings_are_those_of_the_whole_at_the_scale_of_the_part(part: Body, assets: list[LibraryAsset]) -> None:
    narrow, own = (asset.bodies[MAIN_PART] for asset in assets)
    shape = analyse_body(part.surface)
    compared = PartSurroundings.of(shape)
    differences = [compared.compare(each.surroundings) for each in (narrow, own)]
    assert differences[1].mean < 0.95 * differences[0].mean
    areas = creature(1300, seed=0, asymmetry=0.3).surface.area, upper_half().area / 170**2
    assert differences[1].scale == pytest.approx(np.sqrt(areas[1] / areas[0]), rel=SURROUNDINGS.growth - 1)


def test_surroundings_shift_with_the_scale(part: Body) -> None:
    shape = analyse_body(part.surface)
    ours, larger = surroundings_of(shape), surroundings_of(at_scale(shape, SURROUNDINGS.growth))
    assert ours.shape[1:] == (SURROUNDINGS.radii, FEATURES)
    np.testing.assert_allclose(larger[:, 4:], ours[:, 3:-1], atol=1e-4)


def test_radii_beyond_a_cut_do_not_count(part: Body) -> None:
    surroundings = PartSurroundings.of(analyse_body(part.surface))
    beyond = np.where(surroundings.known[..., None] > 0, surroundings.features, 7.0).astype(np.float32)
    changed = PartSurroundings(beyond, surroundings.known, surroundings.areas)
    assert changed.compare(part.surroundings).mean == pytest.approx(surroundings.compare(part.surroundings).mean)
    assert surroundings.compare(part.surroundings).scale == 1.0


def test_radii_beyond_a_region_do_not_count(part: Body) -> None:
    shape = analyse_body(part.surface)
    inside = shape.mesh.vertices[:, 1] > np.median(shape.mesh.vertices[:, 1])
    region = PartSurroundings.of_region(shape, inside)
    places = shape.search.samples[: len(shape.distances)]
    assert len(region.features) == inside[places].sum()
    reached = (region.known * SURROUNDINGS.smallest * SURROUNDINGS.growth ** np.arange(SURROUNDINGS.radii)).max(axis=1)
    assert (reached < shape.distances[inside[places]][:, ~inside].min(axis=1)).all()
    assert region.known.any()
    assert region.difference(surroundings_of(shape)) == 0


def test_the_whole_of_a_part_is_found(part: Body, assets: list[LibraryAsset]) -> None:
    with (
        retune(PART_CANDIDATES, landmarks=7, regions=1),
        retune(PART_CERTAINTY, misfit=-50.0, another_map=2.0),
        retune(WHOLES, placed=1),
    ):
        wholes = find_wholes(part, assets)
    assert wholes is not None
    (found,) = wholes
    assert found.path == Path("own.glb")
    assert found.match is not None
    assert found.certainty == found.match.certainty
    assert found.match.source.vertices is not found.match.target.vertices


@pytest.mark.parametrize("scale", [0.5, 0.95])
def test_assets_are_ordered_by_certainty_unless_the_part_is_nearly_whole(
    scale: float, part: Body, assets: list[LibraryAsset], monkeypatch: pytest.MonkeyPatch
) -> None:
    places = [RoughPlace(certainty, scale, np.zeros(1, int), -5.0) for certainty in (0.3, 0.8)]
    monkeypatch.setattr(wholes_module, "rough_places", lambda *_: [places.pop(0)])
    match = SimpleNamespace(certainty=0.7, chosen=0, candidates=[SimpleNamespace(scores={"fit": -6.0})])
    monkeypatch.setattr(wholes_module, "_match", lambda *_: match)
    found = find_wholes(part, assets)
    if scale > 0.9:
        assert found is None
    else:
        assert found is not None
        assert [each.path.name for each in found] == ["narrow.glb", "own.glb"]
        assert [each.certainty for each in found] == [0.7, 0.3]
        assert found[0].misfit < found[1].misfit < 0.1


def bowl() -> zo.Surface:
    """A half sphere, open above."""
    ball = sphere(directions(1500, 0))
    kept = ball.vertices[ball.triangles][:, :, 2].max(axis=1) < 0.1
    used, corner = np.unique(ball.triangles[kept], return_inverse=True)
    return zo.Surface(ball.vertices[used], corner.reshape(-1, 3))


def test_parts_without_features_are_placed_nowhere(part: Body, assets: list[LibraryAsset]) -> None:
    body = bodies_of(bowl())[MAIN_PART]
    plain, rich = (PartSurroundings.of(analyse_body(each.surface)).variation for each in (body, part))
    assert plain < WHOLES.min_variation < rich
    assert find_wholes(body, assets) == []


@pytest.mark.parametrize(("certainty", "tried"), [(0.8, 1), (0.3, 2)])
def test_no_other_asset_is_tried_if_the_first_is_hardly_larger(
    certainty: float, tried: int, part: Body, assets: list[LibraryAsset], monkeypatch: pytest.MonkeyPatch
) -> None:
    scales = []

    def place(_part: object, _whole: object, given: list[float]) -> list[RoughPlace]:
        scales.extend(given)
        return [RoughPlace(certainty, 0.95, np.zeros(1, int), -5.0)]

    monkeypatch.setattr(wholes_module, "rough_places", place)
    assert find_wholes(part, assets) is None
    assert len(scales) == tried


@pytest.mark.parametrize(("wholes", "matched"), [([], 1), (None, 2)])
def test_a_part_without_a_place_is_matched_with_few_assets(
    wholes: list[FoundWhole] | None,
    matched: int,
    part: Body,
    assets: list[LibraryAsset],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    result = SimpleNamespace(certainty=0.3, chosen=0, candidates=[SimpleNamespace(scores={"total": -11.0})])
    monkeypatch.setattr(asset_match_module, "match", lambda *_: result)
    monkeypatch.setattr(search_module, "find_wholes", lambda *_: wholes)
    monkeypatch.setattr(search_module, "bodies_of", lambda surface: {MAIN_PART: part})
    with retune(search_module.SEARCH, matched_after=1, max_difference=1000.0, beyond=100.0):
        assert len(search(part.surface, assets).ranked) == matched


@pytest.mark.parametrize("certainty", [0.9, 0.3])
def test_a_search_says_that_the_target_is_a_part(
    certainty: float, part: Body, assets: list[LibraryAsset], monkeypatch: pytest.MonkeyPatch
) -> None:
    own: Any = FoundWhole(Path("own.glb"), 0.1, certainty, 0.04, None)
    monkeypatch.setattr(search_module, "find_wholes", lambda *_: [own])
    monkeypatch.setattr(search_module, "bodies_of", lambda surface: {MAIN_PART: part})
    with retune(search_module.SEARCH, max_difference=0.0):
        found = search(part.surface, assets)
    if certainty > 0.5:
        assert found.best is not None
        assert found.best.is_part
        assert found.note == "The target is only a part of 'own', such as a bust."
    else:
        assert found.best is None
        assert "its place on no character of the library is certain" in found.refusal
