# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of the target's vertices on the source's shells: outer parts on outer parts, and shells on their partners.

Lengths are at unit area of the hull.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import closest_on_triangles, closest_points
from zoomout_core.geometry.oriented_closest_points import OrientedSurface, surface_samples
from zoomout_core.geometry.procrustes import Similarities
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.components.part_borders import straighten_borders
from zoomout_core.matching.components.part_motions import MovedTarget, fit_motions
from zoomout_core.matching.components.parts import Part, Side
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.tuning import Tuning, tuned

# Samples of all parts, the nearest ones to a vertex among which another part may cover it, as a shirt covers a body,
# and the cosine of the angle to its normal below which a sample is beside it, not above.
COVERING_POINTS, COVERING_NEIGHBOURS, STRAIGHT_ABOVE = 40_000, 32, 0.7
# Share of a surface's area that clothes make up at least: the plates of robots, which slide over each other, are less.
COVERING_AREA = 0.1


@dataclass(frozen=True)
class ShellImageTuning(Tuning, set_by="characters"):
    """Which parts a vertex may map to."""

    normal_weight: float = tuned(0.02, "at unit area", 0, 1)  # distance that a unit difference of normals counts as
    outside: float = tuned(0.02, "at unit area", 0, 1)  # a vertex nearer to the hull than this is on the outside
    # A part covered by another one, as a body by clothes, must be nearer by this. Covered joints show in other poses.
    cover: float = tuned(0.015, "at unit area", 0, 1)
    inner_reach: float = tuned(0.05, "at unit area", 0, 1)  # distance up to which inner vertices map to inner parts
    # Vertices that are nearer than this to a triangle are on it, whichever side of it is outside.
    lies_on: float = tuned(0.004, "at unit area", 0, 1)
    flush: float = tuned(0.015, "at unit area", 0, 1)  # a shell coincides with its partner if half of it is nearer


SHELL_IMAGES = ShellImageTuning()


@dataclass(frozen=True, eq=False)
class Image:
    """Images of some vertices of the target on the source's working mesh."""

    triangle: Integers  # (n,) triangle numbers
    barycentric: Floats  # (n, 3) coordinates in them
    distance: Floats  # (n,) distance from the moved vertices, at unit area of the hull


def near_hull(side: Side, shape: ShapeAnalysis) -> Booleans:
    """(n,) which vertices of a surface's working mesh are near the hull."""
    return np.asarray(cKDTree(shape.proxy.full.vertices).query(side.points)[0] < SHELL_IMAGES.outside)


def find_caps(hull: Floats, side: Side) -> Booleans:
    """(h,) which vertices (h, 3) of a hull are off its surface, where it closes an opening: the waist of a bust."""
    on = SurfaceMap(*closest_points(hull, side.points, side.mesh.triangles), side.mesh.triangles)
    return np.asarray(np.linalg.norm(on.interpolate(side.points) - hull, axis=1) > SHELL_IMAGES.outside)


def find_covered(side: Side, outside: Booleans) -> Booleans:
    """(n,) which of the vertices near the hull (n,) are below another part, such as a body below a shirt."""
    component, triangles = side.mesh.component, side.mesh.triangles
    covered = np.zeros(len(outside), dtype=bool)
    if component.max() == 0:
        return covered
    area = np.bincount(component, side.areas)
    large = np.flatnonzero((area >= COVERING_AREA * area.sum())[component[triangles[:, 0]]])
    if not len(large):
        return covered
    samples, on = surface_samples(side.points, triangles[large], COVERING_POINTS)
    own = np.flatnonzero(outside)
    near = np.asarray(cKDTree(samples).query(side.points[own], COVERING_NEIGHBOURS)[1])
    row, column = np.nonzero(component[triangles[large[on[near]], 0]] != component[own, None])
    a, b, c = (side.points[triangles[large[on[near[row, column]]], i]] for i in range(3))
    _, below = closest_on_triangles(side.points[own[row]], a, b, c)
    depth = -np.einsum("qx,qx->q", below, side.mesh.vertex_normals[own[row]])
    distance = np.linalg.norm(below, axis=1)
    covered[own[row[(distance < SHELL_IMAGES.outside) & (depth > STRAIGHT_ABOVE * distance)]]] = True
    return covered


def find_beneath(
    points: Floats, normals: Floats, source: Side, of_source: Booleans, of_target: Booleans, in_place: bool
) -> Image:
    """Closest points of the source to points (n, 3) with normals (n, 3) of the target, moved there.

    Outer vertices, by `of_source` (n_s,) and `of_target` (n,), map to outer triangles, inner vertices to inner ones.
    Where surfaces coincide, nearest points are exact. Vertices map to any triangle there, because the hull also covers
    creases, such as those of a braid.
    """
    triangles = source.mesh.triangles
    outer = of_source[triangles].any(axis=1)
    number, weights = np.zeros(len(points), dtype=np.int64), np.zeros((len(points), 3))
    distance = np.zeros(len(points))

    def look(vertices: Integers, among: Integers, reach: float) -> Integers:
        """Map vertices to some triangles; returns the vertices that are beyond the reach."""
        if not len(vertices) or not len(among):
            return vertices
        surface = OrientedSurface(
            source.points, triangles[among], source.mesh.flipped[among], SHELL_IMAGES.normal_weight
        )
        found, barycentric, apart = surface.closest(points[vertices], normals[vertices])
        near = apart <= reach
        chosen = vertices[near]
        number[chosen], weights[chosen], distance[chosen] = among[found[near]], barycentric[near], apart[near]
        return vertices[~near]

    inner, rest, every = np.flatnonzero(~of_target), np.flatnonzero(of_target), np.arange(len(triangles))
    if in_place:
        rest = look(rest, every, SHELL_IMAGES.lies_on)
    rest = np.concatenate([rest, look(inner, np.flatnonzero(~outer), SHELL_IMAGES.inner_reach)])
    rest = look(rest, np.flatnonzero(outer), np.inf)
    look(rest, every, np.inf)
    return Image(number, weights, distance)


def uncover(image: Image, points: Floats, normals: Floats, source: Side, visible: Booleans, may_lift: Booleans) -> None:
    """Move images of vertices (n,) that may be lifted from covered parts to the visible ones above, in place.

    Errors of the map are larger than the gap between a body and its clothes. The vertices are at `points` (n, 3) with
    `normals` (n, 3); `visible` (n_s,) are the source's vertices that no part covers.
    """
    triangles = source.mesh.triangles
    seen = visible[triangles].any(axis=1)
    vertices, among = np.flatnonzero(may_lift & ~seen[image.triangle]), np.flatnonzero(seen)
    if not len(vertices) or not len(among):
        return
    surface = OrientedSurface(source.points, triangles[among], source.mesh.flipped[among], SHELL_IMAGES.normal_weight)
    found, barycentric, apart = surface.closest(points[vertices], normals[vertices])
    near = apart < image.distance[vertices] + SHELL_IMAGES.cover
    lifted = vertices[near]
    image.triangle[lifted], image.barycentric[lifted] = among[found[near]], barycentric[near]
    image.distance[lifted] = apart[near]


def move_to_parts(
    image: Image, moved: MovedTarget, movable: Booleans, among: Integers, source: Side, target: Side
) -> None:
    """Move images of vertices (n,) that are movable to the parts that are nearest, with clean borders, in place.

    The vertices map to the triangles `among` (m,). Rigid parts move by themselves, unless the surfaces are in place.
    """
    component, triangles = source.mesh.component[source.mesh.triangles[:, 0]], source.mesh.triangles[among]
    if component.max() == 0 or not len(among):
        return
    surface = OrientedSurface(
        source.points, triangles, source.mesh.flipped[among], SHELL_IMAGES.normal_weight, component[among]
    )
    part = component[image.triangle]
    usable = movable & surface.has_group(part) & (not moved.in_place)
    motions = fit_motions(part, moved, usable, surface, source, target)
    vertices, on, barycentric, distance = straighten_borders(
        image.triangle, image.distance, movable, motions, surface, source
    )
    image.triangle[vertices], image.barycentric[vertices] = among[on], barycentric
    image.distance[vertices] = distance


def map_onto_partner(
    part: Part,  # of the target, its points where the body's map moves them
    partner: int,  # number of its partner
    similarity: Similarities,  # that registers the one with the other
    moved: MovedTarget,  # all of the target
    shells: OrientedSurface,  # of the source
    source: Side,  # that they are shells of
    target: Side,  # that the part is of
) -> tuple[Image, float]:
    """A shell's image on its partner by the better of two motions, and the relative change of edge lengths.

    Rigid shells are placed by the similarity, others by the body's map. If the body stays in place, a shell that
    coincides with its partner there stays, too. Lengths should change by the scale of the body's motion.
    """
    rest = target.points[part.vertices]
    turned = target.mesh.vertex_normals[part.vertices] @ similarity.rotation[0].T
    edges, _ = unique_edges(part.corners)
    lengths = moved.motion.scale * np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    tried = []
    for places, facing in ((part.points, moved.normals[part.vertices]), (similarity(rest[None])[0], turned)):
        image = Image(*shells.closest(places, facing, np.full(len(rest), partner)))
        corners = source.points[source.mesh.triangles[image.triangle]]
        on = np.einsum("nc,ncx->nx", image.barycentric, corners)
        change = np.abs(np.linalg.norm(on[edges[:, 0]] - on[edges[:, 1]], axis=1) - lengths)
        tried.append((image, float(change.sum() / max(lengths.sum(), 1e-300))))
        if moved.in_place and np.median(image.distance) < SHELL_IMAGES.flush:
            break
    return min(tried, key=itemgetter(1))


def find_beyond(image: Image, onto: Image, part: Part, partner: int, component: Integers, margin: float) -> Booleans:
    """(n,) which vertices of a target's shell are beyond its partner, such as the head of a shell of head and torso.

    They are nearer by more than a margin to their `image` on another shell than to that `onto` the partner.

    Args:
        image: images of all vertices of the target by the body's map.
        onto: images (n,) of the shell's vertices on its partner.
        part: the shell.
        partner: number of its partner.
        component: (m,) the number of the shell of each triangle of the source.
        margin: at unit area of the hull.
    """
    on_other = component[image.triangle[part.vertices]] != partner
    return on_other & (onto.distance > image.distance[part.vertices] + margin)
