# SPDX-License-Identifier: GPL-3.0-or-later
"""Which shape keys hide skin below clothes."""

from __future__ import annotations

import numpy as np
import pytest

from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer.dressing.hidden_skin import keys_that_hide_skin

BODY = ball(1.0, count=900, seed=1)
WHOLE = ball(1.05, count=900, seed=2)
USED, CORNERS = np.unique(
    WHOLE.triangles[WHOLE.vertices[WHOLE.triangles][:, :, 2].min(axis=1) > 0], return_inverse=True
)
SHIRT = Surface(WHOLE.vertices[USED], CORNERS.reshape(-1, 3))


def drawn(depth: float, above: float) -> np.ndarray:
    """(n, 1, 3) offsets that draw in the skin above a height."""
    return -depth * BODY.vertices[:, None] * (BODY.vertices[:, 2, None, None] > above)


@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_keys_that_draw_in_covered_skin_are_found(unit: float) -> None:
    body, shirt = (each.with_vertices(unit * each.vertices) for each in (BODY, SHIRT))
    collapsed = (np.array([0.0, 0, 0.5]) - BODY.vertices[:, None]) * (BODY.vertices[:, 2, None, None] > 0.1)
    keys = {
        "shrunk": drawn(0.05, 0.1),
        "collapsed": collapsed,
        "grown": -drawn(0.05, 0.1),
        "uncovered too": drawn(0.05, -0.9),
        "still": drawn(0, 0),
    }
    found = keys_that_hide_skin(body, unit * np.concatenate(list(keys.values()), axis=1), [shirt])
    assert dict(zip(keys, found.tolist(), strict=True)) == {name: name in ("shrunk", "collapsed") for name in keys}
