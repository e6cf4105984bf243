# SPDX-License-Identifier: GPL-3.0-or-later
"""One closed hull around a character that consists of many shells."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers, segment_sum
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import area_normals, triangle_areas
from zoomout_core.mesh.voxel_remesh import voxel_remesh
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.tuning import Tuning, tuned

# A component whose mean normal is shorter than this encloses nearly all of its volume, which determines its outside.
# Strands of hair with open ends have 0.01 to 0.07, and either of their sides may face the hull.
NEARLY_CLOSED = 0.1
# Number of samples of a surface and of its hull that find its outer parts: glasses get some dozens.
OUTSIDE_POINTS = 40_000


@dataclass(frozen=True)
class HullTuning(Tuning, set_by="characters"):
    """Resolution of hulls, and when a main part covers them."""

    resolution: int = tuned(128, "voxels", 4, 1024)  # of a hull, along the longest extent
    tight_resolution: int = tuned(192, "voxels", 4, 1024)  # of a tight hull
    tight_inset: float = tuned(0.7, "voxels", 0, 4)  # of a tight hull, below the outer sides of its voxels
    below: float = tuned(0.05, "at unit area", 0, 1)  # distance at which a main part covers a place of the hull
    hull_points: int = tuned(2000, "points", 1, 1_000_000)  # number of samples of the hull
    main_points: int = tuned(20_000, "points", 1, 10_000_000)  # number of samples of the main part


HULLS = HullTuning()


def hull_of(surface: Surface, tight: bool = False) -> WorkingMesh:
    """One closed hull around a surface; `vertex_of` is the hull's vertex nearest to each of the surface's.

    Its grid is aligned with the surface's principal axes, so that it turns with the surface. A tight hull has a finer
    grid and is slightly below the surface: it separates limbs that touch, and loses thin parts.
    """
    mesh = surface.working
    axes = _principal_axes(mesh)
    resolution, inset = (HULLS.tight_resolution, HULLS.tight_inset) if tight else (HULLS.resolution, 0.0)
    vertices, triangles = voxel_remesh(mesh.vertices @ axes.T, mesh.triangles, resolution, inset)
    hull, _ = Surface(vertices @ axes, triangles).working.part(0)
    nearest = np.asarray(cKDTree(hull.vertices).query(hull.from_surface(mesh.vertices))[1])
    return replace(
        hull,
        vertex_of=np.where(mesh.vertex_of >= 0, nearest[mesh.vertex_of], -1),
        triangle_of=np.zeros(0, dtype=np.int64),
        scale=mesh.scale * hull.scale,
        origin=mesh.to_surface(hull.origin),
        is_hull=True,
    )


def main_part_coverage(surface: Surface, hull: WorkingMesh) -> float:
    """The part of a hull's area, in [0, 1], that the largest component of its surface covers."""
    mesh = surface.working
    largest = mesh.triangles[mesh.component[mesh.triangles[:, 0]] == 0]
    below, _ = surface_samples(mesh.vertices, largest, HULLS.main_points)
    on_hull, _ = surface_samples(hull.vertices, hull.triangles, HULLS.hull_points)
    distance = cKDTree(hull.from_surface(mesh.to_surface(below))).query(on_hull)[0]
    return float(np.mean(distance < HULLS.below))


def shares_of_outside(surface: Surface, hull: WorkingMesh) -> Floats:
    """(c,) the part of a hull's area, in [0, 1], to which each component of its surface is nearest."""
    component = surface.components[surface.triangles[outer_triangles(surface, hull), 0]]
    return np.bincount(component, minlength=surface.working.component.max() + 1) / len(component)


def outer_triangles(surface: Surface, hull: WorkingMesh) -> Integers:
    """(p,) the triangle of a surface that is nearest to each of many even samples of its hull."""
    mesh = surface.working
    points, on = surface_samples(mesh.vertices, mesh.triangles, OUTSIDE_POINTS)
    on_hull, _ = surface_samples(hull.vertices, hull.triangles, OUTSIDE_POINTS)
    nearest = cKDTree(hull.from_surface(mesh.to_surface(points))).query(on_hull)[1]
    return np.asarray(mesh.triangle_of[on[nearest]])


def orient_outwards(mesh: WorkingMesh, hull: WorkingMesh) -> WorkingMesh:
    """A surface's working mesh with wide open components, which enclose no volume, wound like the hull around them."""
    triangles = mesh.oriented_triangles
    near = cKDTree(hull.vertices).query(hull.from_surface(mesh.to_surface(mesh.vertices[triangles].mean(axis=1))))[1]
    normals, component = area_normals(mesh.vertices, triangles), mesh.component[triangles[:, 0]]
    agreement = np.bincount(component, np.einsum("mx,mx->m", normals, hull.vertex_normals[near]))
    mean = segment_sum(normals, component)
    area = np.bincount(component, np.linalg.norm(normals, axis=1))
    inward = (np.linalg.norm(mean, axis=1) > NEARLY_CLOSED * area) & (agreement < 0)
    return replace(mesh, flipped=mesh.flipped ^ inward[component])


def _principal_axes(mesh: WorkingMesh) -> Floats:
    """(3, 3) rows: principal axes of a mesh's area, by decreasing variance, oriented by the skewness along them."""
    centres = mesh.vertices[mesh.triangles].mean(axis=1)
    areas = triangle_areas(mesh.vertices, mesh.triangles)
    centres = centres - areas @ centres / areas.sum()
    axes = np.linalg.eigh(centres.T @ (areas[:, None] * centres))[1].T[::-1]
    skew = areas @ (centres @ axes.T) ** 3
    axes = axes * np.where(skew < 0, -1, 1)[:, None]
    axes[2] *= np.sign(np.linalg.det(axes))
    return np.asarray(axes)
