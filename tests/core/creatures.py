# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground truth on the creatures of `zoomout_core.samples`."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.samples import LIMBS, Creature, creature, directions, true_vertex
from zoomout_core.samples.creatures import limb_heights

__all__ = ["LIMBS", "Creature", "creature", "directions", "mirrored_vertex", "on_limb", "true_vertex"]


def on_limb(made: Creature, limb: int) -> np.ndarray:
    """(n,) whether each vertex is on limb number `limb`, if the creature has that limb."""
    return limb_heights(made.directions)[:, limb] > 0.3


def mirrored_vertex(source: Creature, target: Creature) -> np.ndarray:
    """(n_t,) the source vertex at the mirrored place of each target vertex."""
    return np.asarray(cKDTree(source.directions).query(target.directions * [-1, 1, 1])[1])
