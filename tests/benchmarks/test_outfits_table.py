# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of outfits: figures of things inside and outside the skin, keys and bones, and a row for each method."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from creatures import creature

from benchmarks.binding import pictures
from benchmarks.outfits import measure, table
from benchmarks.outfits.cases import LOOSE, REMESHED, SAME, STRICT, Case, cases
from benchmarks.outfits.clothes import Wardrobe
from benchmarks.outfits.layers import Layers
from benchmarks.outfits.methods import BY_TRUE_MAP, TRUE, WAYS
from benchmarks.tables import NOT_SHOWN
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball

pytestmark = pytest.mark.slow

HALF_TURN = np.diag([-1.0, 1, -1])


def skin(radius: float = 1.0) -> measure.Skin:
    return measure.Skin(ball(radius, count=900, seed=2))


def figures(thing: Surface, found: np.ndarray, truth: np.ndarray | None, radius: float = 1.0) -> dict[str, float]:
    return measure.Expected(thing, (skin(), skin(radius)), 0.1, truth).figures(found)


def test_unchanged_garment_has_no_faults() -> None:
    shirt = ball(1.1, count=300)
    found = figures(shirt, shirt.vertices, shirt.vertices)
    assert found == dict.fromkeys(found, 0)


def test_cloth_in_the_layer_below_is_counted() -> None:
    shirt, jacket = ball(1.1, count=900), ball(1.2, count=900, seed=3)
    triangles = np.concatenate([shirt.triangles, jacket.triangles[:, ::-1] + 900])  # either may face inwards
    both = Surface(np.concatenate([shirt.vertices, jacket.vertices]), triangles)
    layers = Layers(both, ball(1.0, count=900), 0.1)
    assert layers.figures(both.vertices) == {"in layer": 0, "layer change": 0}
    sunk = both.vertices.copy()
    sunk[900::4] *= 1.05 / 1.2
    assert layers.figures(sunk)["in layer"] == pytest.approx(25, abs=3)
    closer = np.concatenate([shirt.vertices, 1.15 / 1.2 * jacket.vertices])
    assert layers.figures(closer)["layer change"] == pytest.approx(0.5, abs=0.05)
    assert Layers(shirt, ball(1.0, count=900), 0.1).figures(shirt.vertices) == {}


def test_faults_are_counted() -> None:
    shirt = ball(1.1, count=300)
    sunk = np.where(np.arange(300)[:, None] % 4 == 0, 0.7, 1.0) * shirt.vertices
    found = figures(shirt, sunk, shirt.vertices)
    assert 20 < found["in skin"] < 60
    assert found["was in"] == 0
    assert found["error"] == pytest.approx(0.25 * 0.33 / 0.1, rel=0.02)
    assert found["spread"] > 0.1
    assert 0.5 * found["error"] < found["off surface"] <= found["error"]
    slid = figures(shirt, shirt.vertices @ HALF_TURN, shirt.vertices)
    assert slid["off surface"] < 0.02 * slid["error"]
    meant = figures(shirt, sunk, sunk)
    assert meant["in skin"] == 0
    assert meant["was in"] == found["in skin"]
    larger = figures(shirt, 2 * shirt.vertices, None, 2)
    assert larger["thickness"] < 0.02  # of one size of the body
    assert larger["in skin"] == larger["stretched"] == 0
    assert np.isnan(larger["error"])
    turned = shirt.vertices.copy()
    ends = shirt.triangles[0, :2]
    turned[ends] = turned[ends[::-1]]
    assert figures(shirt, turned, None)["folds"] >= 2
    pulled = shirt.vertices.copy()
    pulled[ends[0]] *= 3
    around = (shirt.triangles == ends[0]).any(axis=1).sum()
    found = figures(shirt, pulled, None)
    assert found["torn"] == around
    assert found["stretched"] > 0


def test_keys_are_compared_with_those_of_the_authors() -> None:
    true = {"wide": np.tile([1.0, 0, 0], (4, 1)), "deep": np.tile([0, 0, 2.0], (4, 1)), "still": np.zeros((4, 3))}
    found = table.key_figures({**true, "wide": 0.5 * true["wide"], "deep": -true["deep"]}, true, frozenset({"wide"}))
    assert found == pytest.approx({"cosine": 1, "key error": 0.5, "other key error": 2})


def test_each_method_has_a_row(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    source, target = creature(700, 1).surface, creature(600, 2, bend=0.4).surface
    normals = source.working.vertex_normals[source.working.vertex_of]
    shirt = Surface(source.vertices + 0.03 * normals, source.triangles[:900])
    case = Case(SAME, "one", source, target, {"shirt": shirt}, 0.01, {"shirt": shirt.vertices})
    monkeypatch.setattr(table, "cases", lambda data, most: iter([case]))
    monkeypatch.setattr(pictures, "SQUARE", 32)
    monkeypatch.setattr(pictures, "SAMPLES", 1)
    tables = table.run(tmp_path, None, tmp_path / "pictures")
    by = {row["way"]: row for row in tables["rows"]}
    assert list(by) == [*WAYS, TRUE]
    assert len(tables[NOT_SHOWN]) == len(by)
    assert (tmp_path / "pictures" / "one.png").is_file()


def test_the_set_of_clothes_is_read_with_keys_bones_and_poses(wardrobe: Path) -> None:
    found = list(cases(wardrobe, None))
    assert [(case.kind, case.name) for case in found] == [
        (STRICT, "woman to thin"),
        (LOOSE, "woman to tall"),
        (REMESHED, "woman to thin, again"),
    ]
    case, garment = found[0], found[0].garments["shirt"]
    np.testing.assert_allclose(case.truth["shirt"], 1.1 * case.target.vertices)
    np.testing.assert_allclose(garment.true_joints, case.truth["shirt"][:5].mean(axis=0, keepdims=True))
    upper = case.target.vertices[:, 1] > 0
    posed = case.body.in_pose(0, case.target.vertices, case.body.weights)
    np.testing.assert_allclose(posed[upper], case.target.vertices[upper] @ HALF_TURN.T, atol=1e-9)
    np.testing.assert_allclose(posed[~upper], case.target.vertices[~upper])
    assert (garment.weights[:5].argmax(axis=1) == 1).all()  # they follow the parent of their own bone
    assert Wardrobe(wardrobe / "clothes").key_is_strict == {"wide": True, "odd": False}


def test_garments_are_measured_in_poses_with_keys_and_bones(wardrobe: Path) -> None:
    rows = {row["way"]: row for row in table.run(wardrobe, 1)["rows"] if row["kind"] == STRICT}
    assert set(rows) == {*WAYS, BY_TRUE_MAP, TRUE}
    truth = rows[TRUE]
    for name in ("error", "in skin", "posed in skin", "posed stretched", "posed torn", "key error", "bones"):
        assert truth[name] == 0
    assert truth["keyed in skin"] == rows["dress"]["keyed in skin"] == 0
    assert rows["dress"]["cosine"] > 0.99
    assert rows["dress"]["bones"] < 1
    naive = rows[BY_TRUE_MAP]
    assert naive["error"] < 1
    assert 0 < naive["key error"] < 0.2
    assert naive["bones"] < 1


def test_done_cases_of_the_same_code_are_not_computed_again(wardrobe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = wardrobe / "records.jsonl"
    first = table.run(wardrobe, None, kinds=[STRICT], ways=["dress"], records=done)
    assert {(row["kind"], row["way"]) for row in first[NOT_SHOWN]} == {(STRICT, "dress")}
    monkeypatch.setattr(table.zo, "match", lambda *_: pytest.fail("a case was computed again"))
    assert table.run(wardrobe, None, kinds=[STRICT], ways=["dress"], records=done) == first


def arms_of(wardrobe: Path) -> None:
    """Give the set the bones of two arms only."""
    place = wardrobe / "clothes" / "bodies.npz"
    with np.load(place) as file:
        arrays = dict(file)
    names = np.array(["upperarm01.L", "wrist.L", "upperarm01.R", "wrist.R"])
    heads = np.array([[0.0, 0, 0], [1, -1, 0], [0, 0, 0], [-1, -1, 0]])
    arrays |= {"bone_names": names, "bone_parents": np.array(["", names[0], "", names[2]])}
    arrays |= {"heads": np.tile(heads, (4, 1, 1)), "poses": np.tile(np.eye(3), (1, 4, 1, 1))}
    np.savez(place, **arrays)


def test_limbs_reach_extremes(wardrobe: Path) -> None:
    assert Wardrobe(wardrobe / "clothes").body("thin").extremes == []
    arms_of(wardrobe)
    body = Wardrobe(wardrobe / "clothes").body("thin")
    (forward,) = body.extremes  # the other ones turn bones that it lacks
    wrists = np.einsum("bxy,by->bx", forward[..., :3], body.bones.heads)[[1, 3]]
    angle = np.radians(80)
    np.testing.assert_allclose(
        wrists, [[np.cos(angle), -1, np.sin(angle)], [-np.cos(angle), -1, np.sin(angle)]], atol=1e-9
    )


def test_arms_are_raised_to_the_sides(wardrobe: Path) -> None:
    arms_of(wardrobe)
    found = Wardrobe(wardrobe / "clothes")
    body, heads = found.body("thin"), found.body("thin").bones.heads
    transforms = found.t_pose(body)
    assert transforms is not None
    raised = np.einsum("bxy,by->bx", transforms[..., :3], heads) + transforms[..., 3]
    np.testing.assert_allclose(raised[[1, 3]], [[2**0.5, 0, 0], [-(2**0.5), 0, 0]], atol=1e-9)
