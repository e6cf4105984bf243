# SPDX-License-Identifier: GPL-3.0-or-later
"""Expressions grow with a copy of a head, and not with the head of another person."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from face_masks import ARKIT, make_face
from transfer_meshes import identity

from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer import frames, transfer
from zoomout_core.transfer.keys.face_landmarks import find_expressions

FACE = make_face()
# A wider face of about the same size.
OTHER = np.array([1.2, 1.0, 1.1])


def growth_of_key(scale: float | np.ndarray, names: tuple[str, ...] = ARKIT) -> float:
    """How much longer the key that opens the jaw is on a face with scaled vertices."""
    keys = replace(FACE.keys, labels=names)
    target = FACE.surface.with_vertices(FACE.surface.vertices * scale)
    found = np.asarray(transfer(keys, identity(FACE.surface), FACE.surface, target).values)
    before, now = (np.linalg.norm(values[:, 2], axis=1).sum() for values in (keys.values, found))
    return float(now / before)


def test_expressions_keep_their_length_on_another_person() -> None:
    assert growth_of_key(OTHER) == pytest.approx(1, abs=0.04)


def test_expressions_grow_with_a_copy() -> None:
    assert growth_of_key(1.1) == pytest.approx(1.1, abs=0.01)


def test_expressions_grow_with_a_head_in_another_unit() -> None:
    assert growth_of_key(2.54 * OTHER) == pytest.approx(2.54 * growth_of_key(OTHER, ("a", "b", "c", "d")), rel=0.02)


def test_other_keys_grow_with_any_shape() -> None:
    assert growth_of_key(OTHER, ("a", "b", "c", "d")) > 1.07


@pytest.mark.parametrize(("number", "value"), [("same_size", 1.01), ("same_shape", 0.5)])
def test_tuned_numbers_keep_expressions_from_growing(
    number: str, value: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frames, "FRAMES", replace(frames.FRAMES, **{number: value}))
    assert growth_of_key(OTHER) > 1.07


def test_rigid_parts_of_another_person_move_as_far_and_stay_rigid() -> None:
    tooth = ball(0.2, (0, -0.5, -1.0), count=200)
    source = Surface.joined([FACE.surface, tooth])
    inside = np.arange(len(source.vertices)) >= len(FACE.surface.vertices)
    jaw = np.tile([0, -0.16, 0], (len(tooth.vertices), 1))
    values = np.concatenate([FACE.keys.values, np.zeros((len(jaw), len(ARKIT), 3))])
    values[inside, 2] = jaw
    keys = replace(FACE.keys, values=values)
    found = transfer(keys, identity(source), source, source.with_vertices(source.vertices * OTHER)).values
    moved = np.asarray(found)[inside, 2]
    assert np.linalg.norm(moved, axis=1) == pytest.approx(0.16, rel=0.01)
    assert np.ptp(moved, axis=0).max() < 1e-9


def test_heads_are_recognised_by_their_expressions() -> None:
    assert find_expressions(FACE.keys) is not None
    assert find_expressions(replace(FACE.keys, labels=("a", "b", "c", "d"))) is None
