# SPDX-License-Identifier: GPL-3.0-or-later
"""Remesh a surface with several of MeshLab's filters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph, triangle_areas

# Standard deviation of the noise, relative to the median edge length.
NOISE = 0.05

Remeshing = Callable[[Surface, int, np.random.Generator], Surface]


def isotropic(surface: Surface, vertices: int, random: np.random.Generator) -> Surface:
    """About a given number of vertices with edges of about the same length (Pietroni et al. 2010)."""
    import pymeshlab  # after bpy, which cannot be imported after pymeshlab

    # The area per vertex of a regular triangulation is sqrt(3) / 2 times the squared edge length.
    edge = np.sqrt(2 / np.sqrt(3) * surface.area / vertices)
    return _filtered(surface, "meshing_isotropic_explicit_remeshing", targetlen=pymeshlab.PureValue(edge), iterations=6)


def simplified(surface: Surface, vertices: int, random: np.random.Generator) -> Surface:
    """Decimated to about a given number of vertices by quadric edge collapse (Garland and Heckbert 1997)."""
    return _filtered(
        surface,
        "meshing_decimation_quadric_edge_collapse",
        targetfacenum=2 * vertices,
        preserveboundary=True,
        preservenormal=True,
        preservetopology=True,
    )


def noisy(surface: Surface, vertices: int, random: np.random.Generator) -> Surface:
    """About a given number of vertices of even edges, with noise like a scanner's."""
    even = isotropic(surface, vertices, random)
    edge = np.median(edge_graph(even.vertices, even.triangles).data)
    return Surface(even.vertices + random.normal(scale=NOISE * edge, size=even.vertices.shape), even.triangles)


REMESHINGS: dict[str, Remeshing] = {"isotropic": isotropic, "simplified": simplified, "noisy": noisy}


def _filtered(surface: Surface, name: str, **parameters: object) -> Surface:
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(surface.vertices, surface.triangles))
    meshes.apply_filter(name, **parameters)
    meshes.apply_filter("meshing_remove_unreferenced_vertices")
    result = meshes.current_mesh()
    vertices, triangles = result.vertex_matrix(), result.face_matrix()
    return Surface(vertices, triangles[triangle_areas(vertices, triangles) > 0])
