# SPDX-License-Identifier: GPL-3.0-or-later
"""A search proposes another source for a part of the target that it fits much better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from skinned_tubes import LENGTH, write_tube
from skinned_tubes import tube as tube_arrays

import zoomout_core as zo
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.library import second_source as second_source_module
from zoomout_core.library.bodies import HULL, TIGHT_HULL, Body, LibraryAsset, _body
from zoomout_core.library.parts import COVERED, PARTS, JointParts, _errors, _pieces
from zoomout_core.library.second_source import HULLS, SECOND_SOURCE, find_second_source
from zoomout_core.mesh.surface import Surface
from zoomout_core.tuning import retune


def swollen(surface: Surface, amount: float) -> Surface:
    """The tube with a ring around the middle of its upper half."""
    points = surface.vertices.copy()
    bump = np.exp(-(((points[:, 1] / LENGTH - 0.75) / 0.1) ** 2))
    points[:, [0, 2]] *= 1 + amount * bump[:, None]
    return surface.with_vertices(points)


def found(path: Path, source: Surface, target: Surface, misfit: float) -> zo.FoundSource:
    """A source whose body is matched to another vertex by vertex, but every fifth one slides along it."""
    vertex = np.arange(len(source.vertices))
    vertex[1::5] -= 1
    slid = zo.SurfaceMap.from_vertices(vertex, source)
    match: Any = SimpleNamespace(source=source, target=target, surface_map=slid)
    return zo.FoundSource(path, 0.4, 0.97, misfit, match)


def find_part(ranked: Sequence[zo.FoundSource]) -> zo.FoundPart | None:
    """The part of the target of found sources, the best first, that another one fits better."""
    best, *others = ranked
    matches: Any = [best.match]
    return JointParts.of(best.path, read_asset(best.path), matches).find(others)


@pytest.fixture
def tube(tmp_path: Path) -> Surface:
    """A library file with the joints Lower and Upper."""
    write_tube(tmp_path / "body.glb")
    return read_asset(tmp_path / "body.glb").surface


def test_a_source_that_fits_a_part_much_better_is_proposed_for_it(tmp_path: Path, tube: Surface) -> None:
    body, head = tmp_path / "body.glb", tmp_path / "head.glb"
    # The target is elsewhere, in another unit; sources differ in the upper half.
    target = swollen(tube, 0.6)
    target = target.with_vertices(7 * target.vertices[:, [2, 0, 1]] + 3)
    best, other = found(body, tube, target, 0.05), found(head, swollen(tube, 0.55), target, 0.06)
    with retune(PARTS, max_share=0.7):
        part = find_part([best, other])
        assert part is not None
        assert (part.path, part.best, part.joint, part.joints) == (head, body, "Upper", ("Upper",))
        assert part.fit_of_best < 0.96 < 0.98 < part.fit
        assert str(part.sentence).startswith(f"{head} fits the joint Upper and all below it better than {body}")
        # None is proposed that is hardly better, that does not fit as a whole, or where the best one fits well.
        assert find_part([best, found(head, swollen(tube, 0.2), target, 0.06)]) is None
        assert find_part([best, found(head, swollen(tube, 0.55), target, 0.5)]) is None
        assert find_part([found(body, swollen(tube, 0.56), target, 0.05), other]) is None
        with retune(PARTS, poor=1.0):
            assert find_part([best, other]) is None
        with retune(PARTS, min_share=0.65):
            assert find_part([best, other]) is None
    assert find_part([best, other]) is None


def test_parts_are_those_of_joints(tmp_path: Path, tube: Surface) -> None:
    bare = tmp_path / "bare.glb"
    write_asset(zo.Asset(tube), bare)
    for path in (bare, tmp_path / "missing.ply"):
        assert find_second_source({}, [], [found(path, tube, swollen(tube, 0.6), 0.05)]) is None


def test_joints_that_move_few_vertices_belong_to_the_piece_above() -> None:
    joint = np.repeat([0, 1, 2, 3], [30, 25, 5, 4])
    pieces = _pieces(joint, np.array([-1, 0, 1, 2]))
    assert pieces.tolist() == [0] * 30 + [1] * 34


class Search:
    """A search for a second source among tubes whose matches are known. The best source, a plain tube, is the first."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        positions, _, triangles = tube_arrays(25, 16)
        self.plain = Surface(positions, triangles)
        self.matched = list[str]()
        self._folder = folder
        write_tube(folder / "body.glb")
        monkeypatch.setattr(second_source_module, "match_asset", self._match)

    def body(self, amount: float) -> Body:
        return _body(swollen(self.plain, amount).working.part(0)[0])

    def asset(self, name: str, amount: float) -> LibraryAsset:
        return LibraryAsset(self._folder / name, dict.fromkeys(HULLS, self.body(amount)))

    def find(self, target: Body, assets: dict[str, float], best: zo.FoundSource | None = None) -> zo.FoundPart | None:
        library = [self.asset(name, amount) for name, amount in ({"body.glb": 0.0} | assets).items()]
        best = best or self._match(library[0].path, library[0].bodies[HULL], target)
        self.matched.clear()
        with retune(PARTS, max_share=0.7):
            return find_second_source({HULL: target, TIGHT_HULL: target}, library, [best])

    def _match(self, path: Path, source: Body, target: Body) -> zo.FoundSource:
        self.matched.append(path.name)
        return found(path, source.surface, target.surface, 0.05)


@pytest.fixture
def tubes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Search:
    return Search(tmp_path, monkeypatch)


def test_the_asset_with_the_most_similar_surroundings_is_matched(tubes: Search) -> None:
    with retune(SECOND_SOURCE, nominated=1):
        part = tubes.find(tubes.body(0.6), {"slim.glb": 0.2, "head.glb": 0.57, "thick.glb": 0.9})
    assert part is not None
    assert (part.path.name, part.best.name, part.joint) == ("head.glb", "body.glb", "Upper")
    assert tubes.matched == ["head.glb"]


def test_no_asset_is_matched_that_is_less_similar_than_the_best(tubes: Search) -> None:
    assert tubes.find(tubes.body(0.6), {"narrow.glb": -0.5}) is None
    assert tubes.matched == []


def test_no_asset_is_matched_if_the_best_fits_everywhere(tubes: Search) -> None:
    assert tubes.find(tubes.body(0.02), {"head.glb": 0.02}) is None
    assert tubes.matched == []


def test_no_other_asset_is_matched_after_one_that_fits_the_part(tubes: Search) -> None:
    assets = {"head.glb": 0.6, "another.glb": 0.57}
    assert tubes.find(tubes.body(0.6), assets) is not None
    assert tubes.matched == ["head.glb"]
    # One that hardly fits it better is not enough.
    assert tubes.find(tubes.body(0.6), {"slim.glb": 0.3, "slimmer.glb": 0.2}) is None
    assert tubes.matched == ["slim.glb", "slimmer.glb"]


def test_hulls_are_matched_if_the_main_part_lacks_a_part(tubes: Search) -> None:
    target, best = tubes.body(0.6), tubes.body(0.0)
    kept = target.triangles[(target.vertices[target.triangles][:, :, 1] < LENGTH / 2).all(axis=1)]
    used, corner = np.unique(kept, return_inverse=True)
    lower = [Surface(body.vertices[used], corner.reshape(-1, 3)) for body in (best, target)]
    main = found(tubes.asset("body.glb", 0.0).path, lower[0], lower[1], 0.05)
    # Half the tube, enlarged, would fit all of it.
    match: Any = main.match
    errors = _errors(match, target.surface, np.zeros(len(target.vertices), dtype=int))
    assert (errors[target.vertices[:, 1] > 0.75 * LENGTH] >= COVERED**2).all()
    part = tubes.find(target, {"head.glb": 0.6}, main)
    assert part is not None
    assert (part.path.name, part.joint) == ("head.glb", "Upper")
    assert tubes.matched == ["body.glb", "head.glb"]


def test_the_poorest_part_is_neither_all_around_it_nor_a_small_piece() -> None:
    names, share = ("Chest", "Head", "Hand"), np.array([0.36, 0.1, 0.03, 0.51])
    # Root mean squared errors as those of a woman with another head.
    errors = np.square([0.005, 0.0137, 0.016, 0.001])
    skin: Any = SimpleNamespace(names=(*names, "Hips"), parents=np.array([3, 0, 0, -1]))
    body: Any = SimpleNamespace(vertex_areas=share, area=1.0)
    parts = JointParts(Path("a.glb"), skin, body, np.arange(4), np.arange(4), errors)
    region = parts.poorest()
    assert region is not None
    assert region.tolist() == [False, True, False, False]
    assert replace(parts, errors=errors / 100).poorest() is None
    # A hand is poor, but the error is mostly elsewhere.
    assert replace(parts, errors=np.square([0.0045, 0.0045, 0.0055, 0.0045])).poorest() is None


def test_a_part_is_proposed_only_if_it_causes_much_of_the_error(monkeypatch: pytest.MonkeyPatch) -> None:
    skin: Any = SimpleNamespace(names=("Hips", "Arm"), parents=np.array([-1, 0]))
    body: Any = SimpleNamespace(vertex_areas=np.array([0.95, 0.05]), area=1.0)
    other = zo.FoundSource(Path("b.glb"), 0.4, 0.97, 0.05, SimpleNamespace())  # type: ignore[arg-type]
    monkeypatch.setattr(JointParts, "_errors_of", lambda *_: np.array([1.0, 1e-6]))
    for error_of_hips, is_proposed in ((0.001, True), (0.006, False)):
        errors = np.square([error_of_hips, 0.006])
        parts = JointParts(Path("a.glb"), skin, body, np.arange(2), np.arange(2), errors)
        assert (parts.find([other]) is not None) == is_proposed
