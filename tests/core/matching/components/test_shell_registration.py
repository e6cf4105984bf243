# SPDX-License-Identifier: GPL-3.0-or-later
"""Many shells are registered to shells by similarities at once."""

from __future__ import annotations

from itertools import repeat

import numpy as np
import pytest
from creatures import directions
from loose_parts import egg
from scipy.spatial.transform import Rotation

from zoomout_core.geometry.procrustes import Similarities
from zoomout_core.matching.components.shell_registration import Shells, register_shells

RADII = np.array([[1.0, 0.6, 0.3], [0.5, 0.45, 0.9], [0.2, 0.8, 0.7]])


@pytest.mark.parametrize("handed", [1, -1])
def test_shells_are_registered_from_a_rough_start(handed: int) -> None:
    sense = np.array([handed, 1, 1])
    target = Shells.of([egg(radii, number, 300) for number, radii in enumerate(RADII)])
    turns = Rotation.random(3, random_state=4).as_matrix() * sense
    truth = Similarities(np.array([1.1, 0.9, 1.0]), turns, np.array([[1.0, 0, 0], [0, 2, 0], [0, 0, 3]]))
    source = Shells.of(
        [
            (truth[i : i + 1](points[None])[0], corners)
            for i, (points, corners) in enumerate(map(egg, RADII, (7, 8, 9), repeat(300)))
        ]
    )
    off = Rotation.from_rotvec(0.4 * directions(3, 1)).as_matrix()
    prior = Similarities(np.ones(3), off @ turns, truth.translation + 0.1)
    number = np.arange(3)
    found, left = register_shells(target, source, number, number, prior, handed)
    places = target.sparse
    assert np.linalg.norm(found(places) - truth(places), axis=2).mean() < 0.15
    assert (left < 0.12).all()
    _, stranger = register_shells(target, source, number, (number + 1) % 3, prior, handed)
    assert (stranger > left).all()


def test_axes_are_orthogonal_and_sorted_by_length() -> None:
    shells = Shells.of([egg(radii, number, 300) for number, radii in enumerate(RADII)])
    np.testing.assert_allclose(shells.axes @ shells.axes.transpose(0, 2, 1), np.tile(np.eye(3), (3, 1, 1)), atol=1e-9)
    along = np.einsum("pdx,pax->pda", shells.dense - shells.centre[:, None], shells.axes).std(axis=1)
    assert (np.diff(along) < 0).all()
