# SPDX-License-Identifier: GPL-3.0-or-later
"""The source's face is registered to the target before its expression keys are transferred."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from face_masks import make_face
from transfer_meshes import nearest_map

import zoomout_core as zo
from zoomout_core.transfer.keys import face_registration
from zoomout_core.transfer.keys.face_piece import FACE_REGISTRATION, FacePiece, Guides
from zoomout_core.transfer.keys.face_registration import register_face
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.tuning import retune

FACE = make_face()
PLACES = FACE.surface.vertices
# The last key moves the whole face.
VALUES = np.array(FACE.keys.values)
VALUES[:, -1] = 0.1 * np.cos(PLACES)
EXPRESSIONS = [VALUES[:, i] for i in range(3)]


def map_to_wider_face() -> MappedTarget:
    """A slightly wider face, and a map that is off by smooth errors."""
    target = FACE.surface.with_vertices(PLACES * (1.05, 1.0, 1.0))
    off = 0.06 * np.column_stack([np.sin(5 * PLACES[:, 1]), np.sin(4 * PLACES[:, 0] + 1), 0 * PLACES[:, 0]])
    surface_map = nearest_map(PLACES + off, FACE.surface)
    return MappedTarget(FACE.surface, target, surface_map, np.ones(len(PLACES)))


def error(found: MappedTarget) -> float:
    """The mean distance of images from the true ones, in the middle of the face."""
    middle = np.linalg.norm(PLACES[:, :2], axis=1) < 0.7
    return float(np.linalg.norm(found.points - PLACES, axis=1)[middle].mean())


@cache
def registered_error() -> float:
    return error(register_face(VALUES, EXPRESSIONS, map_to_wider_face()))


def test_registration_reduces_map_errors_on_the_face() -> None:
    assert registered_error() < 0.7 * error(map_to_wider_face())


@pytest.mark.parametrize(
    ("number", "value"),
    [
        ("bending", (1e-12,) * 3),
        ("first_bending", 1e-12),
        ("normal_weight", 1.0),
        ("iterations", 1),
        ("moved", 0.9),
    ],
)
def test_tuned_numbers_reduce_map_errors(number: str, value: float | tuple[float, ...]) -> None:
    found = registered_error()
    with retune(FACE_REGISTRATION, **{number: value}):
        assert found < 0.9 * error(register_face(VALUES, EXPRESSIONS, map_to_wider_face()))


def test_rims_are_aligned_with_wider_eyes_and_mouths() -> None:
    x, y, _ = PLACES.T
    corners, blinks = FACE.corners[:2], VALUES[:, :2].sum(axis=1)
    wider = PLACES - 0.5 * blinks
    wider[:, 0] *= 1 + 0.2 * np.exp(-(((y - y[corners[0]]) / 0.3) ** 2) - (x / 0.6) ** 4)
    lids = np.linalg.norm(blinks, axis=1) > 0.05
    target = FACE.surface.with_vertices(wider)
    other = replace(map_to_wider_face(), target=target, surface_map=nearest_map(wider, FACE.surface))

    def rim_errors() -> np.ndarray:
        """The mean distances of lids from their true height, and of the corners of the mouth from their true width."""
        off = np.abs(register_face(VALUES, EXPRESSIONS, other).points - PLACES)
        return np.array([off[lids, 1].mean(), off[corners, 0].mean()])

    attracted = rim_errors()
    with retune(FACE_REGISTRATION, rim_weight=0.0):
        assert (attracted < np.array([0.4, 0.5]) * rim_errors()).all()


@pytest.mark.parametrize(("blinking", "share"), [(0.0, 0.7), (1.0, 0.1)])
def test_other_parts_that_keys_move_are_mapped_better(blinking: float, share: float) -> None:
    """Such as gums, which are registered, and lashes, which blinks move, and which follow the skin."""
    count, behind = len(PLACES), PLACES - (0, 0, 0.2)
    triangles = np.vstack([FACE.surface.triangles, FACE.surface.triangles + count])
    source = zo.Surface(np.vstack([PLACES, behind]), triangles)
    off = map_to_wider_face().points - PLACES
    surface_map = nearest_map(np.vstack([PLACES, behind + off]), source)
    mapped = MappedTarget(source, source, surface_map, np.ones(2 * count))
    expressions = [np.vstack([each, blinking * each]) for each in EXPRESSIONS[:2]]
    expressions.append(np.vstack([EXPRESSIONS[2], 0 * PLACES]))
    offsets = np.stack([*expressions, np.vstack([VALUES[:, -1]] * 2)], axis=1)
    middle = np.append(np.zeros(count, dtype=bool), np.linalg.norm(PLACES[:, :2], axis=1) < 0.7)
    before, after = (
        np.linalg.norm(each.points - source.vertices, axis=1)[middle].mean()
        for each in (mapped, register_face(offsets, expressions, mapped))
    )
    assert after < share * before


LINE = PLACES[FACE.corners[0], 1]
IS_UPPER = PLACES[:, 1] > LINE + 0.005
ON_LIPS = (FACE.opens[0] > 0.5) & (np.abs(PLACES[:, 1] - LINE) < 0.12)


def test_sides_of_the_mouth_are_those_of_the_lips() -> None:
    guides = _face().guides()
    for sides in (guides.here, guides.there):
        share = np.where(IS_UPPER, 1, -1) * sides[:, 0] / FACE_REGISTRATION.side_weight
        assert share[ON_LIPS].min() > 0.5
        assert share.max() <= 1


def test_lips_that_overlap_are_not_exchanged() -> None:
    overlap = 0.1 * FACE.opens[0] * np.exp(-(((PLACES[:, 1] - LINE) / 0.3) ** 2))
    lips = np.where(IS_UPPER, -1, 1)
    places = PLACES + np.outer(lips * overlap, (0, 1, 0)) - np.outer(IS_UPPER * overlap, (0, 0, 0.1))
    target = FACE.surface.with_vertices(places)
    mapped = MappedTarget(FACE.surface, target, nearest_map(places, FACE.surface), np.ones(len(PLACES)))
    piece = FacePiece.of(VALUES.any(axis=(1, 2)), 0, mapped)
    assert piece is not None
    none, sides = Guides.none(piece), 0.2 * lips[:, None]

    def exchanged(guides: Guides) -> float:
        """The share of the vertices of the lips whose images are on the other lip."""
        triangle, weights, _ = piece.locate(piece.mesh.vertices, guides)
        on_upper = np.einsum("tc,tc->t", weights, IS_UPPER[piece.mesh.triangles[triangle]]) > 0.5
        return float((on_upper != IS_UPPER)[ON_LIPS].mean())

    assert exchanged(none) > 0.5
    assert exchanged(replace(none, here=sides, there=sides)) == 0


@pytest.mark.filterwarnings("error")
def test_lips_far_from_their_middle_follow_the_map(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(face_registration, "find_lips", lambda *_: np.array([0.0, -0.5, 9.0]))
    assert _face()._find_mouth() is None


def test_mouths_of_very_different_width_do_not_correspond(monkeypatch: pytest.MonkeyPatch) -> None:
    face = _face()
    assert face._find_mouth() is not None
    monkeypatch.setattr(face_registration, "MAX_RATIO", 1.0)
    assert face._find_mouth() is None


def _face() -> face_registration._Face:
    piece = FacePiece.of(VALUES.any(axis=(1, 2)), 0, map_to_wider_face())
    assert piece is not None
    return face_registration._Face.of(piece, EXPRESSIONS)
