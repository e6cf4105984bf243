"""How far a map can be trusted, vertex by vertex."""

from __future__ import annotations

import numpy as np

from zoomout_core.correspondence.surface_map import SurfaceMap
from zoomout_core.surface import Floats

# Distance, at unit area, by which going there and back may miss the start before confidence halves.
HALF_CONFIDENCE = 0.05


def cycle_error(there: SurfaceMap, back: SurfaceMap, target_vertices: Floats) -> Floats:
    """(n_t,) distance between each target vertex and where going there and back leads, in the vertices' unit.

    Args:
        there: from the target's vertices to the source.
        back: from the source's vertices to the target, found on its own.
        target_vertices: (n_t, 3) positions.
    """
    returned = there.interpolate(back.interpolate(target_vertices))
    return np.asarray(np.linalg.norm(returned - target_vertices, axis=1))


def confidence_of(error: Floats) -> Floats:
    """(n,) confidence in [0, 1] from the cycle error at unit area: 1 for none, 1/2 at `HALF_CONFIDENCE`."""
    return np.asarray(1 / (1 + (error / HALF_CONFIDENCE) ** 2))
