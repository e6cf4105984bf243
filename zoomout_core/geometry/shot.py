# SPDX-License-Identifier: GPL-3.0-or-later
"""SHOT: the distribution of normals around a vertex, in a local frame.

Tombari, Salti and Di Stefano, Unique Signatures of Histograms for Local Surface Description (2010). Here vertices are
weighted by area, so that the density of a mesh does not matter, and frames point outwards.
"""

from __future__ import annotations

from itertools import product
from numbers import Real

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers, segment_sum
from zoomout_core.geometry.closest_points import consecutive
from zoomout_core.mesh.shapes import ShapeLike, as_shape, as_surface, from_working
from zoomout_core.mesh.triangles import cross, vertex_areas
from zoomout_core.runtime.threads import threads

# Bins of the azimuth, the elevation, the radius, and the cosine between normal and frame.
AZIMUTHS, ELEVATIONS, RADII, COSINES = 8, 2, 2, 11
BINS = AZIMUTHS * ELEVATIONS * RADII * COSINES
# Fewer neighbours do not determine the axes of a frame.
MIN_NEIGHBOURS = 5
# Pairs of a vertex and a neighbour processed together; bounds the memory.
BLOCK = 1 << 17


def shot(shape: ShapeLike, radius: float = 0.1) -> Floats:
    """(n, 352) SHOT descriptors of the vertices or points: 8 azimuths x 2 elevations x 2 radii x 11 cosines.

    They are invariant to translation, rotation and scale of the shape, but not to reflection. Time grows with the
    number of neighbours within the radius.

    Args:
        shape: a surface with outward normals, or a point cloud.
        radius: radius of the ball around each vertex, relative to the square root of the surface's area.

    Returns:
        Descriptors of unit norm; zero at a vertex without a face, or with fewer than five others within the radius.

    Raises:
        ValueError: the radius is not a positive number.
        MeshError: no surface passes through the points.
        TypeError: the shape is of another type, see `ShapeLike`.

    Example:
        >>> zo.shot(source).shape == (len(source.vertices), 352)
        True
    """
    shape = as_shape(shape)
    mesh = as_surface(shape).working
    if not (isinstance(radius, Real) and 0 < radius < np.inf):
        raise ValueError(f"The radius is {radius!r}: give a positive number, relative to the root of the area.")
    areas = vertex_areas(mesh.vertices, mesh.triangles)
    tree = cKDTree(mesh.vertices)
    pairs = np.asarray(tree.query_ball_point(mesh.vertices, radius, workers=threads(), return_length=True))
    descriptors = np.empty((len(areas), BINS))
    for block in consecutive(pairs, BLOCK):
        centre, neighbour, distance = _neighbours(mesh.vertices[block], tree, radius)
        offset = mesh.vertices[neighbour] - mesh.vertices[block[centre]]
        area, normals = areas[neighbour], mesh.vertex_normals
        frames = _frames(offset, area * (radius - distance), area, centre, normals[block])
        local = np.einsum("paj,pj->pa", frames[centre], offset)
        cosine = np.einsum("pj,pj->p", frames[centre, 2], normals[neighbour])
        descriptors[block] = _histograms(local, cosine, distance / radius, area, centre, len(block))
    descriptors[pairs <= MIN_NEIGHBOURS] = 0  # the pairs include the vertex itself
    norms = np.linalg.norm(descriptors, axis=1, keepdims=True)
    return from_working(shape, descriptors / np.where(norms > 0, norms, 1))


def _neighbours(points: Floats, tree: cKDTree, radius: float) -> tuple[Integers, Integers, Floats]:
    """Pairs of a point and a point of the tree within the radius, and their distances (p,)."""
    pairs = cKDTree(points).sparse_distance_matrix(tree, radius, output_type="ndarray")
    pairs = pairs[pairs["v"] > 0]
    return pairs["i"], pairs["j"], pairs["v"]


def _frames(offset: Floats, weight: Floats, area: Floats, centre: Integers, normals: Floats) -> Floats:
    """(b, 3, 3) axes x, y, z as rows: principal axes of the neighbours by weights (p,), the largest first.

    Offsets (p, 3) lead from each centre, of number (p,), to a neighbour of area (p,). The axis x points to the side
    with more area, z to that of the centres' normals (b, 3).
    """
    count = len(normals)
    moments = segment_sum(weight[:, None] * (offset[:, :, None] * offset[:, None]).reshape(-1, 9), centre, count)
    axes = np.linalg.eigh(moments.reshape(-1, 3, 3))[1]
    x, z = axes[:, :, 2], axes[:, :, 0]
    ahead = segment_sum(area * np.sign(np.einsum("pj,pj->p", offset, x[centre])), centre, count)
    x = np.where(ahead[:, None] < 0, -x, x)
    z = np.where(np.einsum("bj,bj->b", z, normals)[:, None] < 0, -z, z)
    return np.stack([x, cross(z, x), z], axis=1)


def _histograms(local: Floats, cosine: Floats, distance: Floats, area: Floats, centre: Integers, count: int) -> Floats:
    """(count, 352) areas (p,) of the neighbours, each distributed to the adjacent bins in all four coordinates.

    Args:
        local: (p, 3) offsets in the frames of their centres.
        cosine: (p,) cosine of the angle between the neighbour's normal and z.
        distance: (p,) distances relative to the radius.
        area: (p,) areas of the neighbours.
        centre: (p,) number of the centre.
        count: number of centres.
    """
    # Contiguous: of strided arrays, numpy rounds arctan2 differently if the result is allocated right behind them.
    x, y, z = np.ascontiguousarray(local.T)
    azimuth = np.arctan2(y, x) / (2 * np.pi)
    elevation = np.arctan2(z, np.hypot(x, y)) / np.pi + 0.5
    sides = (
        _bins_beside(azimuth * AZIMUTHS, AZIMUTHS, is_round=True),
        _bins_beside(elevation * ELEVATIONS, ELEVATIONS),
        _bins_beside(distance * RADII, RADII),
        _bins_beside((cosine + 1) / 2 * COSINES, COSINES),
    )
    histograms = np.zeros(count * BINS)
    for corner in product(*sides):
        (a, of_a), (e, of_e), (r, of_r), (c, of_c) = corner
        number = (((centre * AZIMUTHS + a) * ELEVATIONS + e) * RADII + r) * COSINES + c
        histograms += np.bincount(number, area * of_a * of_e * of_r * of_c, minlength=len(histograms))
    return histograms.reshape(count, BINS)


def _bins_beside(place: Floats, bins: int, is_round: bool = False) -> list[tuple[Integers, Floats]]:
    """The two bins with the middles next to each place (p,), in bin widths, and the share (p,) of each.

    Before the first middle and after the last, one bin gets everything, unless the coordinate is cyclic.
    """
    low = np.floor(place - 0.5).astype(np.int64)
    upper = place - 0.5 - low
    both = [(low, 1 - upper), (low + 1, upper)]
    return [(number % bins if is_round else np.clip(number, 0, bins - 1), share) for number, share in both]
