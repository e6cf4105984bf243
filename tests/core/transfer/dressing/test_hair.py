# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair moves as one piece where it is far from the skin, and with the skin where it is near."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from zoomout_core.samples.spheres import ball
from zoomout_core.transfer.dressing.following import Motion
from zoomout_core.transfer.dressing.form import Form, Lines
from zoomout_core.transfer.dressing.hair import hang

TURN, SIZE = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), 1.4
LOCAL, GROWTH = Rotation.from_rotvec([-0.6, 0, 0]).as_matrix(), 0.7


def test_pieces_far_from_the_skin_move_rotate_and_grow_with_those_near_it() -> None:
    roots = ball(0.5, count=200)
    strand = Lines(np.linspace([0, 0, 1], [0, 0, 3], 9), [(number, number + 1) for number in range(8)])
    forms = [Form.of(each, 1.0) for each in (roots, strand)]
    near = Motion(
        SIZE * forms[0].rest @ TURN.T,
        np.tile(SIZE * TURN, (len(forms[0].rest), 1, 1)),
        np.zeros(len(forms[0].rest)),
    )
    far = Motion(forms[1].rest + np.array([5.0, 0, 0]), np.tile(GROWTH * LOCAL, (9, 1, 1)), np.full(9, 1e3))
    found = hang(forms, [near, far])
    np.testing.assert_allclose(found[1].images, SIZE * forms[1].rest @ TURN.T, atol=1e-3)
    np.testing.assert_allclose(found[1].turns, np.tile(SIZE * TURN, (9, 1, 1)), atol=1e-3)
    local = Motion(near.images, np.tile(GROWTH * LOCAL, (len(near.images), 1, 1)), near.distance)
    np.testing.assert_allclose(hang(forms, [local, far])[0].turns, local.turns, atol=1e-9)


def test_a_single_point_moves_with_the_skin() -> None:
    point = Form.of(Lines([[0, 0, 1]], np.zeros((0, 2))), 1.0)
    (found,) = hang([point], [Motion(np.array([[3.0, 2, 1]]), np.eye(3)[None], np.array([2.0]))])
    np.testing.assert_allclose(found.images, [[3, 2, 1]])
    assert np.isfinite(found.turns).all()
