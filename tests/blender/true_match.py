# SPDX-License-Identifier: GPL-3.0-or-later
"""A true match, for tests of operators that use one."""

import bpy
import numpy as np

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.scene.pair import read_pair
from blender_addon.storage import stored_match
from zoomout_core.geometry.closest_points import closest_points


def keep_true_match(target, still=None, doubtful=0, notes=(), verdict=None):
    """Store the map to closest points of "Source" on a target.

    Args:
        target: the object.
        still: (n, 3) earlier positions of its vertices in world space, if it has moved since.
        doubtful: number of first vertices with confidence 0.1; all others have 1.
        notes: notes of the match.
        verdict: the verdict on it.
    """
    pair = jobs.run(read_pair(bpy.context, "Source", target.name))
    points = pair.target.vertices if still is None else still
    found = closest_points(points, pair.source.vertices, pair.source.triangles)
    confidence = np.where(np.arange(len(points)) < doubtful, 0.1, 1.0)
    match = stored_match.StoredMatch(
        zo.SurfaceMap(*found, pair.source.triangles), confidence, tuple(notes), verdict=verdict
    )
    stored_match.write(target.data, match, pair, {})
