# SPDX-License-Identifier: GPL-3.0-or-later
"""Results can be saved completely, print in a few lines, and contain the input of a transfer."""

from __future__ import annotations

from dataclasses import replace
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
from creatures import creature

import zoomout_core as zo
from zoomout_core.matching.components.lift import LiftedMap
from zoomout_core.matching.refinement.confidence import Partners
from zoomout_core.matching.refinement.repair import Repair
from zoomout_core.matching.report.verdict import AMBER, GREEN, VERDICT, Faults, judge
from zoomout_core.runtime.array_files import read_arrays

pytestmark = pytest.mark.usefixtures("few_candidates")

OPTIONS = {"k_final": 30, "samples": 120}


@pytest.fixture(scope="module")
def result() -> zo.MatchResult:
    return zo.match(creature(400).surface, creature(350, seed=1, bend=0.9).surface, **OPTIONS)


def with_loose_part(surface: zo.Surface) -> zo.Surface:
    """A surface and a small ball above it."""
    ball = creature(80, seed=5).surface
    vertices = np.vstack([surface.vertices, 0.2 * ball.vertices + [0, 0, 1.5 * surface.vertices[:, 2].max()]])
    return zo.Surface(vertices, np.vstack([surface.triangles, ball.triangles + len(surface.vertices)]))


def assert_equal(found: zo.MatchResult, expected: zo.MatchResult) -> None:
    for name in ("triangle", "barycentric"):
        np.testing.assert_array_equal(getattr(found.surface_map, name), getattr(expected.surface_map, name))
    for name in ("confidence", "has_partner", "source_has_partner", "functional_map"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert (found.certainty, found.notes, found.chosen) == (expected.certainty, expected.notes, expected.chosen)


def test_saved_result_keeps_its_map_and_candidates(result: zo.MatchResult, tmp_path: Path) -> None:
    result.save(tmp_path / "result.npz")
    loaded = zo.load_result(tmp_path / "result.npz")
    assert_equal(loaded, result)
    assert_equal(loaded.use(1), result.use(1))


def test_doubtful_share_is_measured_by_area(result: zo.MatchResult) -> None:
    areas = result.target.vertex_areas
    small = areas < np.quantile(areas, 0.8)
    uncertain = replace(result, confidence=np.where(small, 0.2, 0.9))
    assert uncertain.faults.doubtful == pytest.approx(areas[small].sum() / areas.sum())
    assert uncertain.faults.doubtful < small.mean() - 0.05


def test_match_with_mostly_doubtful_vertices_on_a_small_area_is_not_green(result: zo.MatchResult) -> None:
    order = np.argsort(result.target.vertex_areas)
    small = np.zeros(len(order), dtype=bool)
    small[order[: int(0.55 * len(order))]] = True
    uncertain = replace(result, confidence=np.where(small, 0.2, 0.9))
    assert uncertain.faults.doubtful < VERDICT.doubtful
    assert uncertain.faults.doubtful_vertices == pytest.approx(small.mean())
    no_other = Faults(doubtful=uncertain.faults.doubtful)
    assert judge(0.99, no_other).level == GREEN
    assert judge(0.99, no_other._replace(doubtful_vertices=uncertain.faults.doubtful_vertices)).level == AMBER


def test_part_cut_off_by_tears_is_reported_as_torn(result: zo.MatchResult, monkeypatch: pytest.MonkeyPatch) -> None:
    upper = result.target.vertices[:, 2] > np.quantile(result.target.vertices[:, 2], 0.8)
    share, connected = result.target.share_of_area(upper), np.where(upper, 0.1, 0.9)
    untorn = np.zeros(len(upper), dtype=bool)
    cut_off = Repair(result.surface_map, untorn, untorn, connected)
    monkeypatch.setattr("zoomout_core.matching.result.repair", lambda *_: cut_off)
    found = result.use(0)
    np.testing.assert_allclose(found.confidence, connected * result.confidence)
    np.testing.assert_array_equal(found.torn, upper)
    assert found.faults.torn == pytest.approx(share)
    certainty = min(result.candidates[0].certainty, VERDICT.torn_certainty)
    assert found.certainty == pytest.approx(certainty * result.placed * (1 - share))


@pytest.mark.parametrize(("share", "doubted"), [(0.08, True), (0.03, False)])
def test_a_map_of_which_tears_cut_off_a_limb_is_never_certain(
    result: zo.MatchResult, monkeypatch: pytest.MonkeyPatch, share: float, doubted: bool
) -> None:
    sure = replace(result, candidates=(replace(result.candidates[0], certainty=0.99), *result.candidates[1:]))
    areas = result.target.vertex_areas
    limb = np.cumsum(areas) <= share * areas.sum()
    cut_off = Repair(result.surface_map, np.zeros_like(limb), np.zeros_like(limb), np.where(limb, 0.1, 1.0))
    monkeypatch.setattr("zoomout_core.matching.result.repair", lambda *_: cut_off)
    monkeypatch.setattr("zoomout_core.matching.result.is_closed", lambda _: False)
    found = sure.use(0)
    off = result.target.share_of_area(limb)
    assert found.candidates[0].certainty == pytest.approx(VERDICT.torn_certainty if doubted else 0.99)
    assert found.certainty == pytest.approx(found.candidates[0].certainty * (1 - off))
    assert found.verdict.level == AMBER
    assert "tears apart" in found.verdict.sentence


@pytest.mark.parametrize(
    ("closed", "share", "doubted"), [(True, 0.03, True), (True, 0.01, False), (False, 0.03, False)]
)
def test_a_torn_map_of_closed_shapes_is_never_certain(
    result: zo.MatchResult, monkeypatch: pytest.MonkeyPatch, closed: bool, share: float, doubted: bool
) -> None:
    sure = replace(result, candidates=(replace(result.candidates[0], certainty=0.99), *result.candidates[1:]))
    areas = result.target.vertex_areas
    torn = np.cumsum(areas) <= share * areas.sum()
    repaired = Repair(result.surface_map, np.zeros_like(torn), torn, np.ones(len(torn)))
    monkeypatch.setattr("zoomout_core.matching.result.repair", lambda *_: repaired)
    monkeypatch.setattr("zoomout_core.matching.result.is_closed", lambda _: closed)
    found = sure.use(0)
    assert found.faults.torn == pytest.approx(share, abs=0.005)
    assert found.certainty == pytest.approx(VERDICT.torn_certainty if doubted else 0.99)
    assert found.candidates[1:] == sure.candidates[1:]


@pytest.mark.parametrize(("confidence", "is_lost"), [(0.07, True), (0.13, True), (0.17, False)])
def test_certainty_decreases_with_loose_parts_of_unknown_place(
    monkeypatch: pytest.MonkeyPatch, confidence: float, is_lost: bool
) -> None:
    source, target = (with_loose_part(creature(400 - 50 * pose, pose, bend=0.9 * pose).surface) for pose in (0, 1))
    found = zo.match(source, target, **OPTIONS)
    loose = target.components == 1
    share, certainty = target.share_of_area(loose), found.certainty / found.placed
    assert 0.02 < share < 0.2
    doubted = LiftedMap(
        found.surface_map,
        np.where(loose, confidence, 0.9),
        Partners(found.has_partner, found.source_has_partner),
        1.0,
        (),
    )
    monkeypatch.setattr("zoomout_core.matching.result.lift", lambda *_: doubted)
    assert found.use(0).certainty == pytest.approx(certainty * (1 - share * is_lost))


def test_loaded_self_match_has_one_surface(tmp_path: Path) -> None:
    surface = creature(300).surface
    zo.match(surface, surface, **OPTIONS).save(tmp_path / "result.npz")
    loaded = zo.load_result(tmp_path / "result.npz")
    assert loaded.source is loaded.target


@pytest.mark.slow
def test_part_match_survives_saving(tmp_path: Path) -> None:
    whole = creature(700).surface
    inside = whole.vertices[:, 2] > np.quantile(whole.vertices[:, 2], 0.3)
    faces = whole.triangles[inside[whole.triangles].all(axis=1)]
    used, numbers = np.unique(faces, return_inverse=True)
    part = zo.Surface(whole.vertices[used], numbers.reshape(-1, 3))
    found = zo.match(whole, part, **OPTIONS)
    assert found.candidates[0].part_match is not None
    found.save(tmp_path / "part.npz")
    loaded = zo.load_result(tmp_path / "part.npz")
    assert_equal(loaded.use(0), found.use(0))


def test_files_that_are_no_saved_result_are_refused(result: zo.MatchResult, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        zo.load_result(tmp_path / "none.npz")
    np.savez(tmp_path / "other.npz", triangle=np.zeros(3))
    result.surface_map.save(tmp_path / "map.npz")
    with pytest.raises(zo.MeshError, match=r"map.npz is a map, not a result: use zo.SurfaceMap.load"):
        zo.load_result(tmp_path / "map.npz")
    result.save(tmp_path / "result.npz")
    arrays = read_arrays(tmp_path / "result.npz")
    del arrays["array 3"]
    np.savez(tmp_path / "broken.npz", **arrays)
    tree = arrays["tree"].tobytes().replace(b'"MatchResult"', b'"os.system"')
    np.savez(tmp_path / "hostile.npz", **arrays | {"tree": np.frombuffer(tree, np.uint8)})
    for name in ("other", "broken", "hostile"):
        with pytest.raises(zo.MeshError, match=f"{name}.npz is not a saved result.*save one with"):
            zo.load_result(tmp_path / f"{name}.npz")


def test_large_objects_are_shown_in_a_few_lines(result: zo.MatchResult) -> None:
    (symmetry, *_) = zo.detect_symmetry(result.source, k_final=30, samples=120)
    bases = zo.eigenbasis(result.source, 10), zo.eigenbasis(result.target, 10)
    for value, said in (
        (result, "certainty"),
        (result.source, "400"),
        (zo.eigenbasis(result.source, 10), "10 on 400 vertices"),
        (symmetry, "order"),
        (result.surface_map, "350 vertices"),
        (result.candidates[0], "origin"),
        (zo.Asset(result.source), "400 vertices, 796 faces"),
        (zo.zoomout(*bases, np.eye(5), k_final=10), "10 x 10"),
    ):
        text = repr(value)
        assert said in text
        assert len(text.splitlines()) < 10
        assert type(value).__name__ in value._repr_html_()


def test_a_transfer_takes_the_surfaces_from_the_match(result: zo.MatchResult) -> None:
    heights = zo.Attribute("height", zo.Domain.POINT, zo.Kind.SCALAR, result.source.vertices[:, 2])
    without, with_them = zo.transfer(heights, result), zo.transfer(heights, result, result.source, result.target)
    np.testing.assert_array_equal(without.values, with_them.values)
    np.testing.assert_array_equal(zo.conform(result), zo.conform(result, result.source, result.target))
    with pytest.raises(TypeError, match="A SurfaceMap does not contain its surfaces: give source and target"):
        zo.transfer(heights, result.surface_map)


def test_the_signature_of_match_names_every_option() -> None:
    assert set(signature(zo.MatchOptions).parameters) < set(signature(zo.match).parameters)
    with pytest.raises(TypeError, match="k_fnal"):
        zo.match(creature(100).surface, creature(100).surface, k_fnal=20)  # type: ignore[call-overload]
