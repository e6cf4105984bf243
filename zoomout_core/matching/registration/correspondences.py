"""Which points of two surfaces belong together, as far as space tells: closest points with normals that agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.closest_points import EmbeddedSurface
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.analysis import Shape
from zoomout_core.matching.local_rigid_alignment import NORMAL_WEIGHT
from zoomout_core.mesh.triangles import unit_vectors

# Places that are farther than this from their partner, at unit area, pull less; some pull is left to all.
REACH, LEAST_PULL = 0.03, 1e-3
# So many places of each of the two shapes look for their partner, for each node that moves the target, and at most.
PLACES_PER_NODE, MOST_PLACES = 10, 1000
# A partner is none that is farther than this, along the surface and at unit area, from where the first map leads.
LEAP = 0.12
LEAP_SAMPLES = 40


@dataclass(frozen=True, eq=False)
class Places:
    """Samples of a shape that look for their partners on the other one.

    Attributes:
        vertex: (p,) their numbers.
        areas: (p,) what each stands for.
    """

    vertex: Integers
    areas: Floats

    @classmethod
    def on(cls, shape: Shape, nodes: int) -> Places:
        """As many as tell how so many nodes should move."""
        samples = shape.sampled.samples[: min(PLACES_PER_NODE * nodes, MOST_PLACES)]
        _, owner = cKDTree(shape.mesh.vertices[samples]).query(shape.mesh.vertices)
        return cls(samples, np.bincount(owner, shape.basis.areas, minlength=len(samples)))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The source, to look for closest points with normals that agree.

    Attributes:
        source: the shape.
        places: (n_s, 6) its vertices and normals, in one scale.
        tree: of these.
        surface: its triangles, prepared.
    """

    source: Shape
    places: Floats
    tree: cKDTree
    surface: EmbeddedSurface

    @classmethod
    def of(cls, source: Shape) -> Surroundings:
        places = _with_normals(source.mesh.vertices, source.mesh.vertex_normals)
        return cls(source, places, cKDTree(places), EmbeddedSurface(source.mesh.vertices, source.neighbourhoods))

    def closest(self, positions: Floats, normals: Floats) -> SurfaceMap:
        """The points closest to places (q, 3), next to vertices whose normals agree with those given (q, 3)."""
        near = np.asarray(self.tree.query(_with_normals(positions, normals))[1])
        return SurfaceMap(*self.surface.closest(positions, near), self.source.mesh.triangles)


class Leaps:
    """Partners that are too far from where the first map leads, by distances along the source."""

    def __init__(self, first: Integers, source: Shape) -> None:
        self._first = first
        self._marks = source.distances[:LEAP_SAMPLES].T.astype(np.float32)

    def are(self, vertex: Integers, partner: Integers) -> Booleans:
        """(q,) which of the pairs of a target's and a source's vertex are."""
        apart = np.abs(self._marks[partner] - self._marks[self._first[vertex]]).max(axis=1)
        return np.asarray(apart > LEAP)


def pulls(
    positions: Floats,
    normals: Floats,
    here: Places,
    there: Places,
    around: Surroundings,
    leaps: Leaps,
    sliding: float,
) -> tuple[Integers, Floats, Floats]:
    """What closest points ask for, both ways: from places of the target, and from places of the source.

    Args:
        positions: (n, 3) of the target's vertices.
        normals: (n, 3) of these.
        here: places of the target.
        there: places of the source.
        around: the source.
        leaps: which partners are none.
        sliding: see `Level`.

    Returns:
        The vertices, the misses and the pulls that `Bending.step` takes.
    """
    mesh = around.source.mesh
    found = around.closest(positions[here.vertex], normals[here.vertex])
    back = cKDTree(_with_normals(positions, normals)).query(around.places[there.vertex])[1]
    vertex = np.concatenate([here.vertex, back])
    partner = np.concatenate([found.interpolate(mesh.vertices), mesh.vertices[there.vertex]])
    partner_normal = np.concatenate([found.interpolate(mesh.vertex_normals), mesh.vertex_normals[there.vertex]])
    partner_normal = unit_vectors(partner_normal)
    leap = leaps.are(vertex, np.concatenate([found.vertex, there.vertex]))
    misses = partner - positions[vertex]
    agreement = np.einsum("qx,qx->q", normals[vertex], partner_normal)
    trust = np.clip(agreement, 0, 1) / (1 + (np.linalg.norm(misses, axis=1) / REACH) ** 2) ** 2
    trust = np.where(leap, LEAST_PULL, np.maximum(trust, LEAST_PULL))
    across = partner_normal[:, :, None] * partner_normal[:, None]
    pull = np.sqrt(sliding) * np.eye(3) + (np.sqrt(1 + sliding) - np.sqrt(sliding)) * across
    return vertex, misses, np.sqrt(np.concatenate([here.areas, there.areas]) * trust)[:, None, None] * pull


def _with_normals(positions: Floats, normals: Floats) -> Floats:
    return np.hstack([positions, NORMAL_WEIGHT * normals])
