# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests want to know of the creatures of `zoomout_core.samples`."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.samples import LIMBS, Creature, creature, directions, true_vertex
from zoomout_core.samples.creatures import limb_heights

__all__ = ["LIMBS", "Creature", "creature", "directions", "mirrored_vertex", "on_limb", "true_vertex"]


def on_limb(made: Creature, limb: int) -> np.ndarray:
    """(n,) whether a vertex's place stands out by the limb of that number, where the creature has it."""
    return limb_heights(made.directions)[:, limb] > 0.3


def mirrored_vertex(source: Creature, target: Creature) -> np.ndarray:
    """The same with left and right exchanged."""
    return np.asarray(cKDTree(source.directions).query(target.directions * [-1, 1, 1])[1])
