"""Which points of two surfaces belong together, as far as space tells: closest points with normals that agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.correspondence.laying import NORMAL_WEIGHT
from zoomout_core.correspondence.shape import Shape
from zoomout_core.correspondence.surface_map import SurfaceMap
from zoomout_core.projection import project_to_embedding
from zoomout_core.triangles import unit_vectors

# Places that are farther than this from their partner, at unit area, pull less; some pull is left to all.
REACH, LEAST_PULL = 0.03, 1e-3
# So many places of each of the two shapes look for their partner.
PLACES = 1000
# A partner is none that is farther than this, along the surface and at unit area, from where the first map leads.
LEAP = 0.12
LEAP_SAMPLES = 40


@dataclass(frozen=True, eq=False)
class Surroundings:
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
    def of(cls, source: Shape) -> Surroundings:
        places = _with_normals(source.mesh.vertices, source.mesh.vertex_normals)
        return cls(source, places, cKDTree(places), *spread_places(source))

    def closest(self, positions: Floats, normals: Floats) -> SurfaceMap:
        """The points closest to places (q, 3), next to vertices whose normals agree with those given (q, 3)."""
        near = np.asarray(self.tree.query(_with_normals(positions, normals))[1])
        mesh = self.source.mesh
        return SurfaceMap(
            *project_to_embedding(positions, mesh.vertices, self.source.neighbourhoods, near), mesh.triangles
        )


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
    at: Integers,
    areas: Floats,
    around: Surroundings,
    leaps: Leaps,
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
        The vertices, the misses and the pulls that `Bending.step` takes.
    """
    mesh = around.source.mesh
    found = around.closest(positions[at], normals[at])
    back = cKDTree(_with_normals(positions, normals)).query(around.places[around.samples])[1]
    vertex = np.concatenate([at, back])
    partner = np.concatenate([found.interpolate(mesh.vertices), mesh.vertices[around.samples]])
    partner_normal = np.concatenate([found.interpolate(mesh.vertex_normals), mesh.vertex_normals[around.samples]])
    partner_normal = unit_vectors(partner_normal)
    leap = leaps.are(vertex, np.concatenate([found.vertex, around.samples]))
    misses = partner - positions[vertex]
    agreement = np.einsum("qx,qx->q", normals[vertex], partner_normal)
    trust = np.clip(agreement, 0, 1) / (1 + (np.linalg.norm(misses, axis=1) / REACH) ** 2) ** 2
    trust = np.where(leap, LEAST_PULL, np.maximum(trust, LEAST_PULL))
    across = partner_normal[:, :, None] * partner_normal[:, None]
    pull = np.sqrt(sliding) * np.eye(3) + (np.sqrt(1 + sliding) - np.sqrt(sliding)) * across
    return vertex, misses, np.sqrt(np.concatenate([areas, around.areas]) * trust)[:, None, None] * pull


def spread_places(shape: Shape) -> tuple[Integers, Floats]:
    """(p,) samples of a shape, and (p,) the area that each stands for."""
    samples = shape.sampled.samples[:PLACES]
    _, owner = cKDTree(shape.mesh.vertices[samples]).query(shape.mesh.vertices)
    return samples, np.bincount(owner, shape.basis.areas, minlength=len(samples))


def _with_normals(positions: Floats, normals: Floats) -> Floats:
    return np.hstack([positions, NORMAL_WEIGHT * normals])
