# SPDX-License-Identifier: GPL-3.0-or-later
"""Find shape keys that hide skin below clothes: they move it inwards, so that it does not come through."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.dressing.barriers import SidedSurface
from zoomout_core.transfer.dressing.form import Lines

# A key moves vertices visibly if it displaces them by more than this, at unit area: a millimetre on an adult.
MOVED = 7e-4
# Skin is covered if something worn is within this distance, at unit area: 4 cm on an adult. Wide sleeves are looser.
NEAR = 0.03
# Minimum share of a key's moved vertices that move inwards and are covered. It is below one, as rims of hidden skin are
# visible.
SHARE = 0.8


def keys_that_hide_skin(body: Surface, offsets: Floats, worn: Sequence[Surface | Lines]) -> Booleans:
    """(k,) which shape keys move skin below worn objects inwards.

    Args:
        body: the body without these keys.
        offsets: (n, k, 3) their offsets.
        worn: the objects on the body.
    """
    unit = float(np.sqrt(body.area))
    skin, places = SidedSurface.of(body, unit), body.vertices / unit
    cloth = cKDTree(np.concatenate([each.vertices for each in worn]) / unit)
    found = np.zeros(offsets.shape[1], dtype=bool)
    for number, moves in enumerate(offsets.transpose(1, 0, 2) / unit):
        moved = np.flatnonzero(np.linalg.norm(moves, axis=1) > MOVED)
        if len(moved):
            drawn_in = skin.sides((places + moves)[moved])[0] < 0
            covered = np.isfinite(cloth.query(places[moved], distance_upper_bound=NEAR)[0])
            found[number] = min(drawn_in.mean(), covered.mean()) >= SHARE
    return found
