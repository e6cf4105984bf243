# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of targets beside their sources, in matching colours."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Bytes, Floats
from zoomout_core.assets.asset import Skin
from zoomout_core.colors import place_colors
from zoomout_core.drawing import draw_upright
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.surface import Surface

# Pixels of a picture of one shape, and its view's angle from the front, in degrees.
WIDTH, HEIGHT, YAW = 260, 320, 25.0
# Maximum number of vertices of a drawn surface.
MAX_VERTICES = 20_000


def draw_pair(
    result: MatchResult, width: int = WIDTH, height: int = HEIGHT, blender: bool = False
) -> tuple[Bytes, Bytes]:
    """Draw source and target of a match at the same size and position; equal colours correspond.

    Args:
        result: the match.
        width: width of each picture, in pixels.
        height: its height.
        blender: whether the source is oriented like a target from Blender, whose z axis is up and which faces -y.
            Otherwise the target is oriented like a source from glTF, whose y axis is up.

    Returns:
        (height, width, 3) pixels of the source and of the target, rows from top to bottom.
    """
    source, target = result.source, result.target
    images = result.surface_map.interpolate(source.vertices)
    weights = result.confidence + np.finfo(float).eps
    drawn, own = source.vertices, target.vertices
    if blender:
        drawn = procrustes(images, own, weights)(drawn[:, None])[:, 0]
        drawn, own = (places[:, [0, 2, 1]] * [1, 1, -1] for places in (drawn, own))
    else:
        own = procrustes(own, images, weights)(own[:, None])[:, 0]
    shapes = (source.with_vertices(drawn), source.vertices), (target.with_vertices(own), images)
    of_source, of_target = (
        draw_colored(surface, place_colors(places, source.vertices), width, height) for surface, places in shapes
    )
    return of_source, of_target


def draw_bound(result: MatchResult, skin: Skin) -> Bytes:
    """Draw the target of a match posed by its new skin, in the colours of `draw_pair`."""
    images = result.surface_map.interpolate(result.source.vertices)
    seen = transform_points(blend_matrices(skin.transforms[:, :3], skin.weights), skin.rest)
    return draw_colored(result.target.with_vertices(seen), place_colors(images, result.source.vertices))


def draw_colored(surface: Surface, colors: Floats, width: int = WIDTH, height: int = HEIGHT) -> Bytes:
    """Draw a surface whose y axis is up in colours (n, 3); (height, width, 3) pixels."""
    vertices, triangles = surface.vertices, surface.triangles
    if len(vertices) > MAX_VERTICES:
        vertices, triangles, _ = decimate(vertices, triangles, MAX_VERTICES)
        colors = colors[cKDTree(surface.vertices).query(vertices)[1]]
    return draw_upright(vertices, triangles, colors, YAW, width, height)
