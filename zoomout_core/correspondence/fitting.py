"""The target bent onto the source, limb by limb, until the two surfaces lie in one another.

Eigenfunctions say where things are to a few hundredths of a shape's size. Space is far more exact where both are the
same body in two poses: its parts move nearly rigidly, so that a part which is laid where it belongs lies within the
other surface. Nodes that are spread over the target carry rotations and shifts, which neighbours share (Sumner, Schmid
and Pauly, Embedded deformation for shape manipulation, 2007), and are found by Gauss and Newton's method from closest
points with normals that agree; only what moves across the surface counts, so that parts may slide into place (Li,
Adams, Guibas and Pauly, Robust single-view geometry and motion reconstruction, 2009).
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zoomout_core.correspondence.confidence import spectral_distance
from zoomout_core.correspondence.laying import IMAGE_FUNCTIONS, NORMAL_WEIGHT, lay
from zoomout_core.correspondence.proxy import Proxy, carried
from zoomout_core.correspondence.shape import Shape
from zoomout_core.correspondence.surface_map import SurfaceMap
from zoomout_core.projection import closest_points, project_to_embedding
from zoomout_core.rotations import nearest_rotations
from zoomout_core.surface import Booleans, Floats, Integers, triangle_normals

# A vertex moves with so many nodes.
NEAREST_NODES = 5
# Images that the target is laid by at first are smoothed over such a diffusion length, at unit area.
LAYING_WIDTH = 0.06


class Round(NamedTuple):
    """A round of the fit.

    Attributes:
        nodes: how many of them move the target.
        sliding: what a move along the surface counts against one across it; 1 to hold on to the places given.
        stiffness: what the difference of neighbouring nodes counts.
    """

    nodes: int
    sliding: float
    stiffness: float


# First with few nodes, so that a limb moves as a whole and takes its turn about its axis from the body.
ROUNDS = (
    Round(100, 1.0, 0.3),
    *[Round(100, 0.05, 0.3)] * 6,
    Round(200, 1.0, 0.3),
    *[Round(200, 0.05, 0.3)] * 3,
    *[Round(200, 0.02, 0.1)] * 4,
)
# Coarser meshes than this say too little of where they lie.
FEWEST_VERTICES = 2 * max(each.nodes for each in ROUNDS)
# What neighbouring nodes' difference in rotation counts against that of where they put each other.
TURNING = 0.003
# Neighbours that put each other farther apart than this, at unit area, pull less: joints bend.
JOINT = 0.01
# Places that are farther than this from their partner, at unit area, pull less; some pull is left to all.
REACH, LEAST_PULL = 0.03, 1e-3
# So many places of each of the two shapes look for their partner.
PLACES = 1000
# A partner is none that is farther than this, along the surface and at unit area, from where the first map leads.
LEAP = 0.12
LEAP_SAMPLES = 40
# Where the eigenfunctions at both ends of the fit disagree by more than this many times their disagreement by the first
# map, and an allowance at unit area, the fit went astray; disagreement is pooled over such a diffusion length.
WORSE, ALLOWANCE, POOLING = 2.0, 0.02, 0.03
# A rigid motion is sought in so many rounds; it lays a part into the source where that is nearer than this, at unit
# area, for at least this part of the surroundings.
RIGID_ROUNDS, SLIDING, COINCIDING, MOSTLY = 10, 0.02, 0.006, 0.8
# On the full meshes so many rounds make it exact, if it takes at least this part of the vertices where they are to go.
SETTLING_ROUNDS, FEWEST_SETTLED = 4, 0.2
# Two meshes of one surface are no farther apart than this, at unit area.
FLUSH = 5e-4
# A vertex of a fine mesh is not brought to what is farther than this, at unit area, from the stand-in's image.
ELSEWHERE = 0.03


@dataclass(frozen=True, eq=False)
class Fit:
    """A target bent onto its source.

    Attributes:
        surface_map: from the target's mesh to the source's; the first map where the fit went astray.
        positions: (n_t, 3) the target's vertices in the source's frame, at unit area.
        rotations: (n_t, 3, 3) how the surroundings of each vertex turn, mirrored where the map mirrors.
        fits: (n_t,) where this is to be relied on.
    """

    surface_map: SurfaceMap
    positions: Floats
    rotations: Floats
    fits: Booleans

    @classmethod
    def unfitted(cls, surface_map: SurfaceMap) -> Fit:
        """A map alone."""
        n = len(surface_map.triangle)
        return cls(surface_map, np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros(n, dtype=bool))


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Nodes spread over the target, and what each vertex has to do with them.

    Attributes:
        vertex: (d,) where they are.
        near: (n, c) the nodes that move each vertex.
        weight: (n, c) in what shares.
        first: (e,) a node and
        second: (e,) another that moves some of the same vertices; each pair both ways.
        bond: (e,) how much of what the first moves the second moves, too.
    """

    vertex: Integers
    near: Integers
    weight: Floats
    first: Integers
    second: Integers
    bond: Floats

    @classmethod
    def on(cls, target: Shape, count: int) -> _Nodes:
        distances = target.distances[:count]
        c = min(NEAREST_NODES, len(distances) - 1)
        near = np.argpartition(distances, c, axis=0)[: c + 1]
        order = np.argsort(np.take_along_axis(distances, near, axis=0), axis=0)
        near = np.take_along_axis(near, order, axis=0)
        distance = np.take_along_axis(distances, near, axis=0)
        weight = np.maximum(1 - distance[:c] / np.maximum(distance[c], 1e-300), 1e-6) ** 2
        near, weight = near[:c].T, (weight / weight.sum(axis=0)).T
        shared = np.zeros((len(distances), len(distances)))
        for i in range(c):
            for j in range(c):
                np.add.at(shared, (near[:, i], near[:, j]), target.basis.areas * weight[:, i] * weight[:, j])
        np.fill_diagonal(shared, 0)
        first, second = np.nonzero(shared > 1e-3 * np.median(shared[shared > 0]))
        bond = shared[first, second]
        bond = bond / np.bincount(first, bond)[first]
        return cls(target.sampled.samples[: len(distances)], near, weight, first, second, bond)


@dataclass(eq=False)
class _Bending:
    """Nodes in motion.

    Attributes:
        nodes: the nodes.
        rest: (n, 3) the target's vertices, mirrored where the map mirrors.
        normals: (n, 3) its normals, likewise.
        rotations: (d, 3, 3) of the nodes.
        images: (d, 3) where the nodes go.
    """

    nodes: _Nodes
    rest: Floats
    normals: Floats
    rotations: Floats
    images: Floats

    @classmethod
    def from_images(cls, nodes: _Nodes, rest: Floats, normals: Floats, images: Floats, areas: Floats) -> _Bending:
        """The motion that takes the surroundings of each node to the images (n, 3) of the vertices (Kabsch 1976)."""
        count, c = len(nodes.vertex), nodes.near.shape[1]
        weight = (areas[:, None] * nodes.weight).ravel()
        owner = nodes.near.ravel()
        values = np.hstack([rest, images, (images[:, :, None] * rest[:, None]).reshape(-1, 9), np.ones((len(rest), 1))])
        sums = np.stack([np.bincount(owner, weight * np.repeat(v, c), minlength=count) for v in values.T], axis=1)
        # Neighbours have a say, since a few places do not tell a turn.
        pooled = np.array(sums)
        np.add.at(pooled, nodes.first, nodes.bond[:, None] * sums[nodes.second])
        pooled = pooled / pooled[:, 15:]
        moments = pooled[:, 6:15].reshape(-1, 3, 3) - pooled[:, 3:6, None] * pooled[:, None, :3]
        rotations = nearest_rotations(moments)
        own = sums / sums[:, 15:]
        shift = np.einsum("dij,dj->di", rotations, rest[nodes.vertex] - own[:, :3])
        return cls(nodes, rest, normals, rotations, own[:, 3:6] + shift)

    def offsets(self, vertex: Integers) -> Floats:
        """(q, c, 3) some vertices, seen from the nodes that move them, as these turn them."""
        near = self.nodes.near[vertex]
        away = self.rest[vertex, None] - self.rest[self.nodes.vertex][near]
        return np.einsum("qcij,qcj->qci", self.rotations[near], away)

    def moved(self) -> tuple[Floats, Floats, Floats]:
        """(n, 3) all vertices, (n, 3) their normals, and (n, 3, 3) their rotations."""
        near, weight = self.nodes.near, self.nodes.weight
        positions = np.zeros_like(self.rest)
        blends = np.zeros((len(self.rest), 3, 3))
        for node, share in zip(near.T, weight.T, strict=True):
            away = self.rest - self.rest[self.nodes.vertex[node]]
            turned = np.einsum("nij,nj->ni", self.rotations[node], away)
            positions += share[:, None] * (turned + self.images[node])
            blends += share[:, None, None] * self.rotations[node]
        return positions, np.einsum("nij,nj->ni", blends, self.normals), blends

    def step(self, vertex: Integers, misses: Floats, pull: Floats, stiffness: float) -> None:
        """One step of Gauss and Newton's method.

        Args:
            vertex: (q,) vertices that should move.
            misses: (q, 3) by how much.
            pull: (q, 3, 3) square roots of what a miss counts in each direction.
            stiffness: see `Round`.
        """
        count = len(self.nodes.vertex)
        near, weight = self.nodes.near[vertex], self.nodes.weight[vertex]
        c = near.shape[1]
        turning = np.einsum("qij,qcjk->qcik", pull, _crossing(self.offsets(vertex)) * weight[..., None, None])
        shifting = pull[:, None] * weight[..., None, None]
        jacobian = np.concatenate([turning, shifting], axis=-1).transpose(0, 2, 1, 3).reshape(len(vertex), 3, 6 * c)
        column = (6 * near[:, :, None] + np.arange(6)).reshape(len(vertex), 6 * c)
        products = jacobian.transpose(0, 2, 1) @ jacobian
        matrix = _scattered(column, products, 6 * count)
        rhs = np.bincount(
            column.ravel(),
            np.einsum("qic,qi->qc", jacobian, np.einsum("qij,qj->qi", pull, misses)).ravel(),
            minlength=6 * count,
        )
        self._add_stiffness(matrix, rhs, stiffness)
        matrix[np.diag_indices_from(matrix)] += 1e-9 * np.trace(matrix) / len(matrix)
        change = cho_solve(cho_factor(matrix, lower=True, overwrite_a=True, check_finite=False), rhs).reshape(-1, 6)
        self.rotations = Rotation.from_rotvec(change[:, :3]).as_matrix() @ self.rotations
        self.images = self.images + change[:, 3:]

    def _add_stiffness(self, matrix: Floats, rhs: Floats, stiffness: float) -> None:
        """Add what neighbouring nodes that disagree count to the normal equations, in place."""
        first, second = self.nodes.first, self.nodes.second
        places = self.rest[self.nodes.vertex]
        away = np.einsum("eij,ej->ei", self.rotations[first], places[second] - places[first])
        apart = away + self.images[first] - self.images[second]
        count = stiffness * self.nodes.bond / len(places) / (1 + (np.linalg.norm(apart, axis=1) / JOINT) ** 2)
        identity = np.broadcast_to(np.eye(3), (len(first), 3, 3))
        zero = np.zeros_like(identity)
        placing = np.concatenate([_crossing(away), identity, zero, -identity], axis=2)
        turning = np.sqrt(TURNING) * np.concatenate([identity, zero, -identity, zero], axis=2)
        jacobian = np.concatenate([placing, turning], axis=1)
        relative = np.einsum("eij,ekj->eik", self.rotations[second], self.rotations[first])
        turn = np.stack([relative[:, i, j] - relative[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1) / 2
        residual = np.concatenate([apart, -np.sqrt(TURNING) * turn], axis=1)
        column = np.concatenate([6 * first[:, None] + np.arange(6), 6 * second[:, None] + np.arange(6)], axis=1)
        weighted = jacobian * count[:, None, None]
        matrix += _scattered(column, weighted.transpose(0, 2, 1) @ jacobian, len(matrix))
        rhs -= np.bincount(column.ravel(), np.einsum("eic,ei->ec", weighted, residual).ravel(), minlength=len(rhs))


@dataclass(frozen=True, eq=False)
class _Surroundings:
    """The source, to look for closest points with normals that agree.

    Attributes:
        source: the shape.
        places: (n_s, 6) its vertices and normals, in one scale.
        tree: of these.
        samples: (p,) vertices that look for a partner on the target.
        areas: (p,) what each stands for.
    """

    source: Shape
    places: Floats
    tree: cKDTree
    samples: Integers
    areas: Floats

    @classmethod
    def of(cls, source: Shape) -> _Surroundings:
        places = _with_normals(source.mesh.vertices, source.mesh.vertex_normals)
        return cls(source, places, cKDTree(places), *_places(source))

    def closest(self, positions: Floats, normals: Floats) -> SurfaceMap:
        """The points closest to places (q, 3), next to vertices whose normals agree with those given (q, 3)."""
        near = np.asarray(self.tree.query(_with_normals(positions, normals))[1])
        mesh = self.source.mesh
        return SurfaceMap(
            *project_to_embedding(positions, mesh.vertices, self.source.neighbourhoods, near), mesh.triangles
        )


def fit_steps(first: SurfaceMap, source: Shape, target: Shape, mirrored: bool) -> Generator[float, None, Fit]:
    """Bend a target onto its source, beginning with a map between them.

    Args:
        first: from the target's mesh to the source's.
        source: the shape that the map lands on.
        target: the shape that the map starts from.
        mirrored: the map reverses the orientation.

    Yields:
        The fraction done.
    """
    if min(len(source.mesh.vertices), len(target.mesh.vertices)) < FEWEST_VERTICES:
        return Fit.unfitted(first)
    sense = np.array([-1.0, 1, 1]) if mirrored else np.ones(3)
    rest, normals = target.mesh.vertices * sense, target.mesh.vertex_normals * sense
    images, image_normals = (first.interpolate(v) for v in (source.mesh.vertices, source.mesh.vertex_normals))
    coefficients = target.basis.coefficients(images)[:IMAGE_FUNCTIONS]
    yield 0.0
    laid = lay(coefficients, target, LAYING_WIDTH, mirrored)
    if laid.facing(image_normals, source, target) is not laid:
        normals = -normals
    around, leaps = _Surroundings.of(source), _Leaps(first.vertex, source)
    at, areas = _places(target)
    still, placed = _unmoved(first, rest, normals, at, areas, around, leaps, target)
    positions, bending = np.where(still[:, None], placed, laid.positions), None
    for i, (count, sliding, stiffness) in enumerate(ROUNDS):
        yield (i + 1) / (len(ROUNDS) + 2)
        count = min(count, len(target.distances))
        if bending is None or len(bending.nodes.vertex) != count:
            nodes = _Nodes.on(target, count)
            bending = _Bending.from_images(nodes, rest, normals, positions, target.basis.areas)
            goal = positions
        positions, turned, _ = bending.moved()
        if sliding == 1:
            pull = np.sqrt(areas)[:, None, None] * np.eye(3)
            bending.step(at, goal[at] - positions[at], pull, stiffness)
        else:
            bending.step(*_pulls(positions, turned, at, areas, around, leaps, sliding), stiffness)
    yield (len(ROUNDS) + 1) / (len(ROUNDS) + 2)
    assert bending is not None
    positions, turned, blends = bending.moved()
    found = around.closest(positions, turned)
    facing = np.einsum("nx,nx->n", turned, found.interpolate(source.mesh.vertex_normals)) > 0
    fits = facing & ~leaps.are(np.arange(len(rest)), found.vertex) & ~_astray(found, first, source, target)
    surface_map = SurfaceMap(
        np.where(fits, found.triangle, first.triangle),
        np.where(fits[:, None], found.barycentric, first.barycentric),
        first.source_triangles,
    )
    return Fit(surface_map, positions, nearest_rotations(blends) * sense, fits)


def lifted_fit(fit: Fit, source: Proxy, target: Proxy) -> SurfaceMap:
    """A fit of stand-ins as a map between the parts that they stand for.

    Each vertex of the target's part moves along with its place on the stand-in, and takes the closest point of the
    source's part, unless that is far from where the map between the stand-ins leads: on something that touches.
    """
    if source.mesh is source.full and target.mesh is target.full and not fit.fits.any():
        return fit.surface_map
    place, images = target.place, carried(fit.surface_map, source, target)
    fits = fit.fits[target.mesh.triangles[place.triangle]].all(axis=1)
    on = SurfaceMap(place.triangle[fits], place.barycentric[fits], place.source_triangles)
    (centre, size), (image_centre, image_size) = target.frame, source.frame
    off = (target.full.vertices[fits] - centre) / size - on.interpolate(target.mesh.vertices)
    bent = on.interpolate(fit.positions) + np.einsum("nij,nj->ni", on.interpolate(fit.rotations), off)
    goal = images.copy()
    goal[fits] = image_centre + image_size * bent
    settled = goal.copy()
    settled[fits] = _settled(goal[fits], target.full.vertices[fits], source)
    found = source.closest(settled)
    loose = (settled != goal).any(axis=1)
    loose &= np.linalg.norm(found.interpolate(source.full.vertices) - settled, axis=1) > FLUSH
    found = _replaced(found, loose, source.closest(goal[loose]))
    elsewhere = np.linalg.norm(found.interpolate(source.full.vertices) - images, axis=1) > ELSEWHERE
    return _replaced(found, elsewhere, source.closest(images[elsewhere]))


def _replaced(surface_map: SurfaceMap, at: Booleans, by: SurfaceMap) -> SurfaceMap:
    """A map with other images for some vertices (n,)."""
    triangle, barycentric = surface_map.triangle.copy(), surface_map.barycentric.copy()
    triangle[at], barycentric[at] = by.triangle, by.barycentric
    return SurfaceMap(triangle, barycentric, surface_map.source_triangles)


def _settled(goal: Floats, points: Floats, source: Proxy) -> Floats:
    """Where points are to go (n, 3), made exact for those that a single similarity takes there.

    A stand-in lies off its mesh by more than two meshes of one surface differ, so where most of a body has not moved
    against the rest, only the full meshes tell exactly how it lies.

    Args:
        goal: (n, 3) in the frame of the source's part.
        points: (n, 3) in that of the target's.
        source: the mesh to lie on.
    """
    if len(points) < FEWEST_VERTICES:
        return goal
    at = np.linspace(0, len(points) - 1, min(len(points), 2 * PLACES)).astype(int)
    motion, shift = np.eye(3), np.zeros(3)
    trust = np.ones(len(at))
    for _ in range(RIGID_ROUNDS):
        share = trust / trust.sum()
        centre, goal_centre = share @ points[at], share @ goal[at]
        offsets, goals = points[at] - centre, goal[at] - goal_centre
        turn = nearest_rotations(goals.T @ (share[:, None] * offsets))
        size = (share @ np.einsum("nx,nx->n", goals, offsets @ turn.T)) / (share @ (offsets**2).sum(axis=1))
        motion, shift = size * turn, goal_centre - size * turn @ centre
        trust = 1 / (1 + (np.linalg.norm(points[at] @ motion.T + shift - goal[at], axis=1) / COINCIDING) ** 2) ** 2
    mesh = source.full
    for _ in range(SETTLING_ROUNDS):
        placed = points[at] @ motion.T + shift
        near = np.flatnonzero(np.linalg.norm(placed - goal[at], axis=1) < COINCIDING)
        if len(near) < FEWEST_SETTLED * len(at):
            return goal
        found = SurfaceMap(*closest_points(placed[near], mesh.vertices, mesh.triangles), mesh.triangles)
        normals = triangle_normals(mesh.vertices, mesh.triangles[found.triangle])
        misses = np.einsum("nx,nx->n", normals, found.interpolate(mesh.vertices) - placed[near])
        away = placed[near] - placed[near].mean(axis=0)
        columns = [np.cross(away, normals), np.einsum("nx,nx->n", normals, away)[:, None], normals]
        change = np.linalg.lstsq(np.hstack(columns), misses, rcond=None)[0]
        grown = (1 + change[3]) * Rotation.from_rotvec(change[:3]).as_matrix()
        middle = placed[near].mean(axis=0)
        motion, shift = grown @ motion, grown @ (shift - middle) + middle + change[4:]
    if np.median(np.abs(misses)) > FLUSH:
        return goal
    placed = points @ motion.T + shift
    return np.where((np.linalg.norm(placed - goal, axis=1) < COINCIDING)[:, None], placed, goal)


def _unmoved(
    first: SurfaceMap,
    rest: Floats,
    normals: Floats,
    at: Integers,
    areas: Floats,
    around: _Surroundings,
    leaps: _Leaps,
    target: Shape,
) -> tuple[Booleans, Floats]:
    """Where a single rigid motion already lays the target into the source, as where only its mesh is another.

    Returns:
        (n,) where that is so, and (n, 3) where the motion takes the target's vertices.
    """
    mesh = around.source.mesh
    images = first.interpolate(mesh.vertices)[at]
    share = areas / areas.sum()
    centre, image_centre = share @ rest[at], share @ images
    turn = nearest_rotations((images - image_centre).T @ (share[:, None] * (rest[at] - centre)))
    for _ in range(RIGID_ROUNDS):
        placed, turned = image_centre + (rest - centre) @ turn.T, normals @ turn.T
        vertex, misses, pull = _pulls(placed, turned, at, areas, around, leaps, SLIDING)
        jacobian = np.concatenate([pull @ _crossing(placed[vertex] - image_centre), pull], axis=2).reshape(-1, 6)
        change = np.linalg.lstsq(jacobian, np.einsum("qij,qj->qi", pull, misses).ravel(), rcond=None)[0]
        turn = Rotation.from_rotvec(change[:3]).as_matrix() @ turn
        image_centre = image_centre + change[3:]
    placed, turned = image_centre + (rest - centre) @ turn.T, normals @ turn.T
    found = around.closest(placed, turned)
    apart = np.linalg.norm(found.interpolate(mesh.vertices) - placed, axis=1)
    close = (apart < COINCIDING) & ~leaps.are(np.arange(len(rest)), found.vertex)
    pooled = target.basis.smoothed(close[:, None].astype(float), POOLING**2)[:, 0]
    return pooled > MOSTLY, placed


def _pulls(
    positions: Floats,
    normals: Floats,
    at: Integers,
    areas: Floats,
    around: _Surroundings,
    leaps: _Leaps,
    sliding: float,
) -> tuple[Integers, Floats, Floats]:
    """What closest points ask for, both ways: from places of the target, and from places of the source.

    Args:
        positions: (n, 3) of the target's vertices.
        normals: (n, 3) of these.
        at: (p,) vertices of the target that look for a partner.
        areas: (p,) what each stands for.
        around: the source.
        leaps: which partners are none.
        sliding: see `Round`.

    Returns:
        The vertices, the misses and the pulls that `_Bending.step` takes.
    """
    mesh = around.source.mesh
    found = around.closest(positions[at], normals[at])
    back = cKDTree(_with_normals(positions, normals)).query(around.places[around.samples])[1]
    vertex = np.concatenate([at, back])
    partner = np.concatenate([found.interpolate(mesh.vertices), mesh.vertices[around.samples]])
    partner_normal = np.concatenate([found.interpolate(mesh.vertex_normals), mesh.vertex_normals[around.samples]])
    partner_normal /= np.maximum(np.linalg.norm(partner_normal, axis=1, keepdims=True), 1e-300)
    leap = leaps.are(vertex, np.concatenate([found.vertex, around.samples]))
    misses = partner - positions[vertex]
    agreement = np.einsum("qx,qx->q", normals[vertex], partner_normal)
    trust = np.clip(agreement, 0, 1) / (1 + (np.linalg.norm(misses, axis=1) / REACH) ** 2) ** 2
    trust = np.where(leap, LEAST_PULL, np.maximum(trust, LEAST_PULL))
    across = partner_normal[:, :, None] * partner_normal[:, None]
    pull = np.sqrt(sliding) * np.eye(3) + (np.sqrt(1 + sliding) - np.sqrt(sliding)) * across
    return vertex, misses, np.sqrt(np.concatenate([areas, around.areas]) * trust)[:, None, None] * pull


class _Leaps:
    """Partners that are too far from where the first map leads, by distances along the source."""

    def __init__(self, first: Integers, source: Shape) -> None:
        self._first = first
        self._marks = source.distances[:LEAP_SAMPLES].T.astype(np.float32)

    def are(self, vertex: Integers, partner: Integers) -> Booleans:
        """(q,) which of the pairs of a target's and a source's vertex are."""
        apart = np.abs(self._marks[partner] - self._marks[self._first[vertex]]).max(axis=1)
        return np.asarray(apart > LEAP)


def _astray(found: SurfaceMap, first: SurfaceMap, source: Shape, target: Shape) -> Booleans:
    """(n_t,) where eigenfunctions speak against a map, and for the one that it came from."""
    k = min(IMAGE_FUNCTIONS, len(source.basis.eigenvalues), len(target.basis.eigenvalues))
    values, eigenvalues = target.basis.eigenvectors[:, :k], target.basis.eigenvalues[:k]
    pulled = [surface_map.interpolate(source.basis.eigenvectors[:, :k]) for surface_map in (found, first)]
    off = [spectral_distance(values, rows @ target.basis.coefficients(rows)[:k].T, eigenvalues) for rows in pulled]
    pooled = np.maximum(target.basis.smoothed(np.column_stack(off), POOLING**2), 0)
    return np.asarray(pooled[:, 0] > WORSE * pooled[:, 1] + ALLOWANCE)


def _places(shape: Shape) -> tuple[Integers, Floats]:
    """(p,) samples of a shape, and (p,) the area that each stands for."""
    samples = shape.sampled.samples[:PLACES]
    _, owner = cKDTree(shape.mesh.vertices[samples]).query(shape.mesh.vertices)
    return samples, np.bincount(owner, shape.basis.areas, minlength=len(samples))


def _with_normals(positions: Floats, normals: Floats) -> Floats:
    return np.hstack([positions, NORMAL_WEIGHT * normals])


def _crossing(vectors: Floats) -> Floats:
    """(..., 3, 3) what a small turn, as a rotation vector, does to each vector (..., 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=-1).reshape(*vectors.shape, 3)


def _scattered(column: Integers, blocks: Floats, size: int) -> Floats:
    """(size, size) the sum of square blocks (b, c, c), each at its own rows and columns (b, c)."""
    position = column[:, :, None] * size + column[:, None]
    return np.bincount(position.ravel(), blocks.ravel(), minlength=size * size).reshape(size, size)
