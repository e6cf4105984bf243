# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror displacements, such as shape keys and sculpted details, across a symmetry, and measure the shape's asymmetry.

On a posed body a displacement cannot be mirrored in space: a raised and a lowered arm are not mirror images. Here each
displacement is rotated and reflected with its neighbourhood on the way to the other side (Umeyama 1991, like loose
parts that follow a body).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.geometry.procrustes import Moments, nearest_rotations, products
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.input_checks import measurable
from zoomout_core.symmetry.mirror import Direction, own_share_of
from zoomout_core.symmetry.self_map import SelfMap
from zoomout_core.symmetry.sides import BLEND
from zoomout_core.transfer import Domain

# Diffusion lengths of the neighbourhoods for fitting rigid motions, at unit area: to rotate displacements, and to
# measure the asymmetry of the shape.
TURNING_WIDTH = 0.03
COMPARISON_WIDTH = 0.1


def mirror_offsets(offsets: Floats, symmetry: SelfMap) -> Floats:
    """(n, 3) displacements (n, 3) of the vertices with both sides exchanged, in the frame of each place."""
    mirrored = np.einsum("nij,nj->ni", frames(symmetry), _check(offsets, symmetry))
    return symmetry.surface_map.interpolate(mirrored)


def symmetrise_offsets(offsets: Floats, symmetry: SelfMap, direction: Direction = "left_to_right") -> Floats:
    """(n, 3) displacements (n, 3) made the same on both sides, or with both sides exchanged; see `symmetrise`.

    Raises:
        MeshError: the direction needs two sides, but the symmetry has none.
    """
    share = own_share_of(Domain.POINT, symmetry, direction)[:, None]
    return share * offsets + (1 - share) * mirror_offsets(offsets, symmetry)


def split_offsets(offsets: Floats, symmetry: SelfMap, blend: float = BLEND) -> tuple[Floats, Floats]:
    """Split displacements (n, 3) into a left and a right part (n, 3), whose sum is the whole.

    They blend within the distance `blend` from the line, relative to the square root of the area.

    Raises:
        MeshError: the symmetry has no two sides.
    """
    if not symmetry.has_sides:
        raise MeshError("This symmetry has no left and right side: choose a reflection.")
    offsets = _check(offsets, symmetry)
    left = left_share(symmetry, blend)[:, None] * offsets
    return left, offsets - left


def left_share(symmetry: SelfMap, blend: float = BLEND) -> Floats:
    """(n,) from 0 on the right to 1 on the left, smooth across the line; a vertex and its image sum to one."""
    width = max(blend, 1e-9) * np.sqrt(symmetry.surface.area)
    along = np.clip((symmetry.distance / width + 1) / 2, 0, 1)
    return np.asarray(along**2 * (3 - 2 * along))


def frames(symmetry: SelfMap) -> Floats:
    """(n, 3, 3) orthogonal matrices that take directions at a vertex to those at its image.

    Reflections if the symmetry reverses the orientation, else rotations: the best fit of a vertex's neighbourhood.
    """
    handedness = -1.0 if symmetry.reverses_orientation else 1.0
    proxy = symmetry.shape.proxy
    places, images = _places_and_images(symmetry)
    moments = Moments.of_products(symmetry.shape.basis.smoothed(products(places, images), TURNING_WIDTH**2))
    blended = proxy.place.interpolate(moments.rotations(handedness).reshape(-1, 9)).reshape(-1, 3, 3)
    return _on_surface(nearest_rotations(blended, handedness), symmetry)


def shape_asymmetry(symmetry: SelfMap) -> Floats:
    """(n,) distance of the shape from its other side in the surface's unit, independent of the pose.

    A vertex's neighbourhood is aligned with that of its image by the best rigid motion. The remaining distance of the
    two surfaces along their normal is the asymmetry.
    """
    shape = symmetry.shape
    places, images = _places_and_images(symmetry)
    moments = Moments.of_products(shape.basis.smoothed(products(places, images), COMPARISON_WIDTH**2))
    turns = moments.rotations(-1.0 if symmetry.reverses_orientation else 1.0)
    aligned = np.einsum("nij,nj->ni", turns, places - moments.place) + moments.image
    normals = np.einsum("nij,nj->ni", turns, shape.mesh.vertex_normals)
    apart = np.abs(np.einsum("ni,ni->n", images - aligned, normals)) * shape.proxy.full.scale
    return _on_surface(shape.proxy.place.interpolate(apart), symmetry)


def _places_and_images(symmetry: SelfMap) -> tuple[Floats, Floats]:
    """(n, 3) places of the shape's mesh on the surface, and their images, at unit area of the part."""
    surface, proxy = symmetry.surface, symmetry.shape.proxy
    images = symmetry.surface_map.interpolate(surface.vertices)
    if proxy.full.is_hull:
        points = proxy.full.to_surface(proxy.vertices)
        on = SurfaceMap(*closest_points(points, surface.vertices, surface.triangles), surface.triangles)
        return on.interpolate(surface.vertices) / proxy.full.scale, on.interpolate(images) / proxy.full.scale
    nodes = proxy.full.surface_vertex[proxy.full_vertex]
    return surface.vertices[nodes] / proxy.full.scale, images[nodes] / proxy.full.scale


def _on_surface(values: Floats, symmetry: SelfMap) -> Floats:
    """Values (n_part, ...) of the main part's or hull's vertices, at the surface's vertices by the nearest ones."""
    surface, vertex_of = symmetry.surface, symmetry.shape.proxy.full.vertex_of.copy()
    body = np.flatnonzero(vertex_of >= 0)
    rest = np.flatnonzero((vertex_of < 0) & measurable(surface.vertices))
    if len(rest):
        vertex_of[rest] = vertex_of[body[cKDTree(surface.vertices[body]).query(surface.vertices[rest])[1]]]
    return np.asarray(values[vertex_of])


def _check(offsets: Floats, symmetry: SelfMap) -> Floats:
    array, n = np.asarray(offsets, dtype=np.float64), len(symmetry.surface.vertices)
    if array.shape != (n, 3):
        raise MeshError(f"The displacements have the shape {array.shape}: give three numbers for each of {n} vertices.")
    return array
