# SPDX-License-Identifier: GPL-3.0-or-later
"""Take a posed surface to the rest pose: by the inverse of skinning where it is trusted, and elsewhere smoothly.

The inverse tears the surface where skinning has folded it. There, and where weights or the map are doubtful, the
surface keeps its own differential coordinates, rotated with its surroundings: Lipman et al., Differential coordinates
for interactive mesh editing (2004), and as rigid as possible, Sorkine and Alexa (2007).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array, diags_array

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.gradients import turn_gradients, without_sums
from zoomout_core.geometry.procrustes import nearest_rotations
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.spectral.laplacian import mesh_laplacian
from zoomout_core.transfer.frames import FRAMES, FULL_CONFIDENCE, MIN_TRUST, on_working_mesh
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class UnposeTuning(Tuning, set_by="binding"):
    """Where the inverse of skinning is trusted.

    Attributes:
        min_extent: a blend of bones has collapsed if the smallest singular value of a vertex's skinning matrix,
            relative to the scale, is below this.
        max_strain: maximum stretch or shrinking of an edge by the inverse; beyond it, weights are wrong. At 3, which
            the inner side of an elbow reaches, a fifth more vertices are smoothed, for 3 % more error.
    """

    min_extent: float = tuned(0.3, "1", 0, 1)
    max_strain: float = tuned(6.0, "1", 1, 1000)


UNPOSE = UnposeTuning()


@dataclass(frozen=True, eq=False)
class Rest:
    """A surface in the rest pose."""

    positions: Floats  # (n, 3) positions of its vertices
    linear: Floats  # (n, 3, 3) matrices that take differences of positions around each vertex from the pose to rest
    smoothed: int  # how many vertices keep their own shape, because the inverse of skinning is not trusted there


def unpose(posed: Surface, matrices: Floats, scale: float, confidence: Floats) -> Rest:
    """Take a posed surface to the rest pose.

    Args:
        posed: the surface.
        matrices: (n, 3, 4) affine maps that take its vertices from rest to the pose, see `skinning_matrices`.
        scale: the common scale of the bones.
        confidence: (n,) confidence, in [0, 1], of the map that gave weights and pose.
    """
    rest, inverse, sound = inverse_skinning(posed.vertices, matrices, scale)
    trust = np.where(sound, np.clip(confidence / FULL_CONFIDENCE, 0, 1), 0)
    trust[_strained_vertices(posed, rest, scale)] = 0
    if not (trust < 1).any():
        return Rest(rest, inverse, 0)
    turns = nearest_rotations(inverse) / scale
    return _smooth(posed, rest, inverse, turns, np.maximum(trust, MIN_TRUST))


def inverse_skinning(positions: Floats, matrices: Floats, scale: float) -> tuple[Floats, Floats, Booleans]:
    """Positions (n, 3) in a pose, taken to rest by the inverse of affine maps (n, 3, 4) with a common scale.

    Returns:
        (n, 3) positions at rest, (n, 3, 3) the linear parts of the inverse, and (n,) where the blend of bones has not
        collapsed. Elsewhere the inverse does not stretch.
    """
    left, extent, right = np.linalg.svd(matrices[:, :, :3])
    sound = extent[:, 2] > UNPOSE.min_extent * scale
    safe = np.where(sound[:, None], extent, scale)
    inverse = np.einsum("nkx,nk,nyk->nxy", right, 1 / safe, left)
    return np.einsum("nxy,ny->nx", inverse, positions - matrices[:, :, 3]), inverse, sound


def _strained_vertices(posed: Surface, rest: Floats, scale: float) -> Booleans:
    """(n,) whether an edge at a vertex is stretched or shrunk too much between the pose and rest."""
    edges, _ = unique_edges(posed.triangles)
    now, then = (np.linalg.norm(np.diff(points[edges], axis=1)[:, 0], axis=1) for points in (posed.vertices, rest))
    torn = (then * scale > UNPOSE.max_strain * now) | (now > UNPOSE.max_strain * scale * then)
    return np.isin(np.arange(len(rest)), edges[torn])


def _smooth(posed: Surface, rest: Floats, inverse: Floats, turns: Floats, trust: Floats) -> Rest:
    working = posed.working
    stiffness, areas = mesh_laplacian(working.vertices, working.triangles)
    own, here, weight = (on_working_mesh(working, each) for each in (posed.vertices, rest, trust))
    trusted = without_sums(csc_array(diags_array(weight) @ stiffness @ diags_array(weight)))
    smoothing = ScreenedSmoothing.of(weight * areas, stiffness, FRAMES.smoothing_length)
    linear = on_working_mesh(working, turns)
    size = np.linalg.norm(linear[:, 0], axis=1).mean()
    spread = smoothing.smooth(linear.reshape(-1, 9)).reshape(-1, 3, 3)
    linear = np.where((weight < 1)[:, None, None], size * nearest_rotations(spread), linear)
    gradients = trusted @ here
    gradients += (turn_gradients(csc_array(stiffness - trusted), linear) @ own.ravel()).reshape(own.shape)
    placed = smoothing.fit(here, gradients)
    number = posed.working.vertex_of
    used = (number >= 0)[:, None]
    doubt = (1 - trust)[:, None, None] * used[:, :, None]
    return Rest(
        np.where(used, placed[number], rest), (1 - doubt) * inverse + doubt * linear[number], int((trust < 1).sum())
    )
