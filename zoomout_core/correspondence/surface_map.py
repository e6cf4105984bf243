"""A map between surfaces: for every vertex of the target a point on the source."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from zoomout_core.projection import closest_points
from zoomout_core.surface import Floats, Integers, MeshError, Surface


@dataclass(frozen=True, eq=False)
class SurfaceMap:
    """Where on the source surface each vertex of the target lies.

    Attributes:
        triangle: (n_t,) the source triangle that holds the image.
        barycentric: (n_t, 3) the image in that triangle, non-negative, summing to one.
        source_triangles: (m_s, 3) vertex numbers of the source's triangles.
    """

    triangle: Integers
    barycentric: Floats
    source_triangles: Integers

    @classmethod
    def from_vertices(cls, vertex: Integers, source: Surface) -> SurfaceMap:
        """The map that sends each target vertex to a source vertex (n_t,).

        Raises:
            MeshError: a number is out of range, or names a vertex that no face of the source uses.
        """
        triangles = source.triangles
        vertex = np.asarray(vertex, dtype=np.int64)
        corner_at = np.full(len(source.vertices), -1)
        corner_at[triangles.ravel()] = np.arange(triangles.size)
        if len(vertex) and (vertex.min() < 0 or vertex.max() >= len(corner_at) or corner_at[vertex].min() < 0):
            raise MeshError("The vertex map names source vertices that do not exist or belong to no face: correct it.")
        corner = corner_at[vertex]
        barycentric = np.zeros((len(vertex), 3))
        barycentric[np.arange(len(vertex)), corner % 3] = 1
        return cls(corner // 3, barycentric, triangles)

    @property
    def vertex(self) -> Integers:
        """(n_t,) the source vertex nearest to each image."""
        corner = np.argmax(self.barycentric, axis=1)
        return self.source_triangles[self.triangle, corner]

    def interpolate(self, values: Floats) -> Floats:
        """Values (n_s,) or (n_s, d) at the source's vertices, read at the images: (n_t,) or (n_t, d)."""
        corners = np.asarray(values)[self.source_triangles[self.triangle]]
        return np.einsum("nc,nc...->n...", self.barycentric, corners)

    def at(self, source: Surface, target: Surface, triangle: Integers, barycentric: Floats) -> SurfaceMap:
        """The map at any points of the target, such as corners or samples inside its faces.

        The images of the corners are mixed in space, and the mixture brought back to the source.

        Args:
            source: the surface that the images lie on.
            target: the surface that the points lie on.
            triangle: (q,) target triangles.
            barycentric: (q, 3) the points in them.
        """
        images = self.interpolate(source.vertices)[target.triangles[triangle]]
        points = np.einsum("qc,qcx->qx", barycentric, images)
        return SurfaceMap(*closest_points(points, source.vertices, self.source_triangles), self.source_triangles)

    def invert(self, source: Surface, target: Surface) -> SurfaceMap:
        """The map the other way: for every vertex of the source a point on the target.

        The target is laid onto the source by this map, and each source vertex takes the closest point of it.
        """
        laid = self.interpolate(source.vertices)
        return SurfaceMap(*closest_points(source.vertices, laid, target.triangles), target.triangles)

    def save(self, path: str | PathLike[str], **extra: Any) -> None:
        """Write `triangle`, `barycentric`, `vertex` and any further arrays to an .npz file."""
        np.savez_compressed(path, triangle=self.triangle, barycentric=self.barycentric, vertex=self.vertex, **extra)

    @classmethod
    def load(cls, path: str | PathLike[str], source: Surface) -> SurfaceMap:
        """Read a map that `save` wrote.

        Raises:
            MeshError: the file holds no map, or one onto another source.
        """
        with np.load(path, allow_pickle=False) as file:
            missing = {"triangle", "barycentric"} - set(file.files)
            if missing:
                raise MeshError(f"{path} holds no surface map ({' and '.join(sorted(missing))} are missing).")
            triangle, barycentric = file["triangle"], file["barycentric"]
        if len(triangle) and triangle.max() >= len(source.triangles):
            raise MeshError(
                f"{path} maps onto another source: it names triangle {triangle.max()} of {len(source.triangles)}."
            )
        return cls(triangle, barycentric, source.triangles)
