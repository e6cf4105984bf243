# SPDX-License-Identifier: GPL-3.0-or-later
"""Expression keys locate the corners of mouth and lids, and the head's directions locate the other landmarks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from face_masks import ARKIT, BOTTOM, CHIN, GAP, MOUTH, NOSE, STEP, make_face
from scipy.spatial import cKDTree

import zoomout_core as zo
from zoomout_core.transfer.keys import face_landmarks
from zoomout_core.transfer.keys.face_landmarks import FACE_LANDMARKS

FACE = make_face()
FOUND = zo.propose_face_landmarks(FACE.surface, FACE.keys)


def test_corners_of_mouth_and_eyes_are_the_ends_of_slits() -> None:
    names = [name for name in FACE_LANDMARKS if "Corner" in name]
    assert [FOUND[name] for name in names] == FACE.corners
    assert list(FOUND) == list(FACE_LANDMARKS)


def test_nose_chin_lips_and_sides_are_extreme_points() -> None:
    vertices = FACE.surface.vertices
    np.testing.assert_allclose(vertices[FOUND["Nose"], :2], NOSE, atol=STEP)
    np.testing.assert_allclose(vertices[FOUND["Chin"], :2], CHIN, atol=2 * STEP)
    row = BOTTOM + STEP * MOUTH[2]
    for name, lowest, highest in (("Upper Lip", row + GAP, row + 0.2), ("Lower Lip", row - 0.2, row)):
        x, y, _ = vertices[FOUND[name]]
        assert abs(x) < STEP
        assert lowest <= y <= highest
    assert vertices[FOUND["Left Ear"], 0] == vertices[:, 0].max()
    assert vertices[FOUND["Right Ear"], 0] == vertices[:, 0].min()


def test_visibility_is_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    searches = []

    class Counted(cKDTree):
        def query_ball_point(self, *arguments, **options):  # type: ignore[no-untyped-def]
            searches.append(arguments)
            return super().query_ball_point(*arguments, **options)

    monkeypatch.setattr(face_landmarks, "cKDTree", Counted)
    assert zo.propose_face_landmarks(FACE.surface, FACE.keys) == FOUND
    assert len(searches) == 1


def test_landmarks_do_not_depend_on_unit_pose_or_spelling() -> None:
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn)) * 0.01
    keys = zo.Attribute(
        "keys",
        zo.Domain.POINT,
        zo.Kind.OFFSET,
        np.asarray(FACE.keys.values) @ turn.T,
        ("eye-left-closure", "eye-right-closure", "mouth-open", "eyebrows-left-down"),
    )
    assert zo.propose_face_landmarks(FACE.surface.with_vertices(FACE.surface.vertices @ turn.T + 5), keys) == FOUND


def test_moving_loose_parts_are_not_taken_for_the_skin() -> None:
    """Teeth behind the mouth, which open as well."""
    teeth = zo.Surface([[-0.2, -0.6, -0.3], [0.2, -0.6, -0.3], [0.2, -0.5, -0.3], [-0.2, -0.5, -0.3]], [[0, 1, 2, 3]])
    both = zo.Surface.joined([FACE.surface, teeth])
    offsets = np.zeros((len(both.vertices), 4, 3))
    offsets[:-4] = FACE.keys.values
    offsets[-4:, 2] = [0, -0.1, 0]
    keys = zo.Attribute("keys", zo.Domain.POINT, zo.Kind.OFFSET, offsets, ARKIT)
    assert zo.propose_face_landmarks(both, keys) == FOUND


def test_missing_and_ineffective_keys_are_reported() -> None:
    named = make_face(("eyeBlinkLeft", "eyeBlinkRight", "cheekPuff", "browDownLeft")).keys
    with pytest.raises(zo.MeshError, match="no shape key jawOpen"):
        zo.propose_face_landmarks(FACE.surface, named)
    values = np.array(FACE.keys.values)
    values[:, 2] = values[:, 2].mean(axis=0) + 1e-3 * FACE.surface.vertices
    fused = zo.Attribute("keys", zo.Domain.POINT, zo.Kind.OFFSET, values, ARKIT)
    with pytest.raises(zo.MeshError, match="does not part any lips"):
        zo.propose_face_landmarks(FACE.surface, fused)


def test_landmarks_agree_between_persons_within_millimetres(benchmark_data: Path) -> None:
    """All persons share one topology and one set of keys; corners and lips have true landmarks."""
    data = dict(np.load(benchmark_data / "faces" / "ict.npz"))
    ends = np.cumsum(data["face_sizes"].astype(int))[:-1]
    faces = [face.tolist() for face in np.split(data["face_vertices"].astype(int), ends)]
    labels = tuple(str(name) for name in data["key_names"])
    offsets = np.zeros((len(data["neutral"]), len(labels), 3))
    for key, (first, end) in enumerate(zip(data["key_offset"][:-1], data["key_offset"][1:], strict=True)):
        offsets[data["key_vertex"][first:end], key] = data["key_delta"][first:end]
    keys = zo.Attribute("keys", zo.Domain.POINT, zo.Kind.OFFSET, offsets, labels)
    person = data["identities"][3].astype(float)
    found = zo.propose_face_landmarks(zo.Surface(person, faces), keys)
    # Numbers of the true landmarks among the usual 68; lengths are centimetres.
    true = dict(zip(FACE_LANDMARKS, (54, 48, 51, 57, 45, 42, 36, 39, 30), strict=False))
    for name, mark in true.items():
        off = np.linalg.norm(person[found[name]] - person[data["landmarks68"][mark]])
        assert off < 0.35, name
    average = data["neutral"].astype(float)
    others = zo.propose_face_landmarks(zo.Surface(average, faces), keys)
    for name in FACE_LANDMARKS:
        assert np.linalg.norm(average[found[name]] - average[others[name]]) < 0.6, name
