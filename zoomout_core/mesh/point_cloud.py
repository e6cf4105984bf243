# SPDX-License-Identifier: GPL-3.0-or-later
"""Point clouds, validated once on creation, and the surfaces reconstructed from them."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.input_checks import check_points, measurable
from zoomout_core.mesh.reconstruction import triangulate_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unit_vectors


class PointCloud:
    """Points sampled from a surface, with normals if they are known.

    Args:
        points: (n, 3) positions.
        normals: (n, 3) outward normals, or None.

    Raises:
        MeshError: fewer than 12 points, coordinates that are not finite, or not one normal per point.

    Example:
        >>> zo.match(source, zo.PointCloud(target.vertices), k_final=30).surface_map.triangle.shape == truth.shape
        True
    """

    def __init__(self, points: ArrayLike, normals: ArrayLike | None = None) -> None:
        self.points = check_points(points)
        self.normals = None if normals is None else check_points(normals)
        if not measurable(self.points).all():
            raise MeshError("Some points have coordinates that are not finite or far too large: remove them.")
        if self.normals is not None and not (len(self.normals) == len(self.points) and np.isfinite(self.normals).all()):
            raise MeshError(
                f"Each of the {len(self.points)} points needs a finite normal: correct the normals, or omit them."
            )
        if len(self.points) < 12:
            raise MeshError(f"A point cloud of {len(self.points)} points is too small: at least 12 are needed.")

    @cached_property
    def surface(self) -> Surface:
        """The surface reconstructed from the points; these are its vertices, in the same order.

        Raises:
            MeshError: no surface passes through the points.
        """
        triangles = triangulate_points(self.points, None if self.normals is None else unit_vectors(self.normals))
        if not len(triangles):
            raise MeshError(
                "No surface passes through the points: check that they are not all on a line or at one point."
            )
        return Surface(self.points, triangles)
