"""Loose parts (eyes, teeth, buttons, clothes): paired and mapped by way of the body that they belong to.

A part has too little shape of its own for its spectrum to tell a left eye from a right one. The body's map
does: the body around a part moves rigidly, up to scale, to its image on the source, and takes the part along.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from zoomout_core.correspondence.surface_map import SurfaceMap
from zoomout_core.projection import closest_points
from zoomout_core.surface import Floats, Integers, Surface

# More parts than these are not paired one by one: what has so many is debris, or hair.
MOST_PARTS = 300
# So many vertices of the body around a part say how it moves.
BODY_NEIGHBOURS = 200
# How far off the body's map may carry a part, over the square root of the area.
MAP_ERROR = 0.03
# A partner's size and place may be off by this part of its own size.
TOLERANCE = 0.75
# Trust in a partner that fits exactly, and the misfit, as a part of its size, at which half of it is left.
FULL_TRUST, HALF_MISFIT = 0.9, 0.25


@dataclass(frozen=True, eq=False)
class Part:
    """A component of a surface.

    Attributes:
        vertices: (n,) of the surface.
        triangles: (m,) of the surface.
        centre: (3,) centroid of its vertices.
        size: root mean square distance from the centre.
    """

    vertices: Integers
    triangles: Integers
    centre: Floats
    size: float


def parts_of(surface: Surface) -> list[Part]:
    """The components beside the largest, the largest first; at most `MOST_PARTS`."""
    component = surface.components
    of_triangle = component[surface.triangles[:, 0]]
    parts = []
    for number in range(1, min(int(component.max()), MOST_PARTS) + 1):
        vertices = np.flatnonzero(component == number)
        points = surface.vertices[vertices]
        centre = points.mean(axis=0)
        size = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))
        parts.append(Part(vertices, np.flatnonzero(of_triangle == number), centre, size))
    return parts


def map_parts(
    source: Surface, target: Surface, body: SurfaceMap, on_body: Integers
) -> tuple[list[tuple[Part, SurfaceMap, float]], list[Part], list[Part]]:
    """Pair the loose parts of two surfaces, and map them.

    Args:
        source: the surface that the map lands on.
        target: the surface that the map starts from.
        body: the map of all target vertices, of which those `on_body` are known.
        on_body: (b,) target vertices of the largest part.

    Returns:
        The target's parts that have a partner, each with the map of its vertices and the trust in it; the
        target's parts without a partner; and the source's.
    """
    of_target, of_source = parts_of(target), parts_of(source)
    if not of_target or not of_source:
        return [], of_target, of_source
    images = body.interpolate(source.vertices)[on_body]
    tree = cKDTree(target.vertices[on_body])
    carried = []
    for part in of_target:
        near = np.unique(tree.query(part.centre, k=min(BODY_NEIGHBOURS, len(on_body)))[1])
        carried.append(_carried(target.vertices[part.vertices], target.vertices[on_body[near]], images[near]))
    slack = MAP_ERROR * np.sqrt(source.area)
    misfit = np.array([[_misfit(points, candidate, slack) for candidate in of_source] for points in carried])
    rows, columns = linear_sum_assignment(np.minimum(misfit, 10 * TOLERANCE))
    mapped = []
    for row, column in zip(rows, columns, strict=True):
        if misfit[row, column] > TOLERANCE:
            continue
        partner = of_source[column]
        # What is left is the body map's error: the part is moved onto its partner's centre and size.
        points = carried[row] - carried[row].mean(axis=0)
        points *= partner.size / max(float(np.sqrt((points**2).sum(axis=1).mean())), 1e-300)
        triangles = source.triangles[partner.triangles]
        triangle, barycentric = closest_points(points + partner.centre, source.vertices, triangles)
        trust = FULL_TRUST / (1 + (misfit[row, column] / HALF_MISFIT) ** 2)
        onto = SurfaceMap(partner.triangles[triangle], barycentric, source.triangles)
        mapped.append((of_target[row], onto, float(trust)))
    paired = misfit[rows, columns] <= TOLERANCE
    alone_target = [part for i, part in enumerate(of_target) if i not in rows[paired]]
    alone_source = [part for i, part in enumerate(of_source) if i not in columns[paired]]
    return mapped, alone_target, alone_source


def _carried(points: Floats, neighbours: Floats, images: Floats) -> Floats:
    """Points (n, 3) moved as their neighbours (k, 3) move to their images (k, 3): turned, scaled and shifted.

    The best similarity in the least-squares sense (Umeyama 1991).
    """
    centre, image_centre = neighbours.mean(axis=0), images.mean(axis=0)
    X, Y = neighbours - centre, images - image_centre
    U, singular, Vt = np.linalg.svd(Y.T @ X)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    rotation = (U * sign) @ Vt
    scale = (singular * sign).sum() / max((X**2).sum(), 1e-300)
    return scale * (points - centre) @ rotation.T + image_centre


def _misfit(points: Floats, partner: Part, slack: float) -> float:
    """How far points (n, 3) are off a part in place and size, as a part of its size and the slack."""
    centre = points.mean(axis=0)
    size = max(float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean())), 1e-300)
    if partner.size <= 0:
        return np.inf
    place = float(np.linalg.norm(centre - partner.centre)) / (max(size, partner.size) + slack)
    return place + abs(float(np.log(size / partner.size)))
