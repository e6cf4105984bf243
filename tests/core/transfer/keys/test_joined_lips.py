# SPDX-License-Identifier: GPL-3.0-or-later
"""A transfer reports a target whose mouth cannot open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from face_masks import ARKIT, make_face

import zoomout_core as zo
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.transfer.keys import face_landmarks
from zoomout_core.transfer.keys.shape_keys import JOINED_LIPS

FACE = make_face()


def notes(target: zo.Surface, keys: zo.Attribute = FACE.keys) -> tuple[str, ...]:
    """Notes of a transfer along the closest points."""
    source = FACE.surface
    nearest = zo.SurfaceMap(*closest_points(target.vertices, source.vertices, source.triangles), source.triangles)
    return tuple(map(str, zo.transfer(keys, nearest, source, target).notes))


def test_joined_lips_are_reported_with_advice() -> None:
    assert notes(make_face(joined=True).surface) == (JOINED_LIPS,)


def test_lips_that_part_are_not_reported_despite_map_errors() -> None:
    assert notes(FACE.surface) == ()
    off = FACE.surface.vertices + np.random.default_rng(0).normal(0, 0.005, FACE.surface.vertices.shape)
    assert notes(FACE.surface.with_vertices(off)) == ()


@pytest.mark.parametrize("names", [("a", "b", "c", "d"), ("browDownLeft", "browDownRight", "jawOpen", "mouthLeft")])
def test_keys_of_unknown_names_are_not_checked(names: tuple[str, ...]) -> None:
    keys = zo.Attribute("keys", zo.Domain.POINT, zo.Kind.OFFSET, FACE.keys.values, names)
    assert notes(make_face(joined=True).surface, keys) == ()


def test_joined_lips_are_reported_although_no_lids_meet_in_the_blinks() -> None:
    values = FACE.keys.values * np.where(np.isin(ARKIT, ["eyeBlinkLeft", "eyeBlinkRight"]), 0.1, 1)[:, None]
    keys = replace(FACE.keys, values=values)
    with pytest.raises(zo.MeshError):  # such as landmarks of eyes, which need lids that meet
        face_landmarks.propose_face_landmarks(FACE.surface, keys)
    assert notes(make_face(joined=True).surface, keys) == (JOINED_LIPS,)
    assert notes(FACE.surface, keys) == ()


def test_slits_of_a_face_are_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    found, skin_of = [], face_landmarks._skin_of
    monkeypatch.setattr(face_landmarks, "_skin_of", lambda *arguments: found.append(skin_of(*arguments)) or found[-1])
    assert notes(make_face(joined=True).surface) == (JOINED_LIPS,)
    assert len(found) == 1
