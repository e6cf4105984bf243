# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts from existing maps: vertices in the same order, and a file that `zoomout match` wrote."""

from __future__ import annotations

import bpy
import numpy as np

import zoomout_core as zo
from zoomout_core.arrays import Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.maps.surface_map import read_vertex_map
from zoomout_core.messages import message, plural

from ...mesh_data import ObjectPair
from ...storage.stored_match import StoredMatch

# Meshes with the same vertex order share nearly all edges; below this fraction, the order differs.
SHARED_EDGES = 0.5


def same_order(pair: ObjectPair) -> StoredMatch:
    """The match of meshes with the same vertex order, which maps each vertex to the one of the same number.

    Raises:
        MeshError: the meshes differ in the number of vertices, or share too few edges.
    """
    source, target = pair.source, pair.target
    shared = _share_of_edges(pair)
    notes = []
    if shared < 1:
        notes.append(
            message("{share:.1%} of the target's edges connect different vertices on the source.", share=1 - shared)
        )
    count = len(target.vertices)
    of_faces = np.zeros(count, dtype=bool)
    of_faces[source.triangles] = True
    loose = np.flatnonzero(~of_faces)
    vertex = np.where(of_faces, np.arange(count), source.triangles[0, 0])
    surface_map = zo.SurfaceMap.from_vertices(vertex, source)
    if len(loose):
        places = closest_points(source.vertices[loose], source.vertices, source.triangles)
        surface_map.triangle[loose], surface_map.barycentric[loose] = places
        notes.append(
            plural(
                len(loose),
                "1 vertex belongs to no face of the source: mapped to the nearest point, with zero confidence.",
                "{count:,} vertices belong to no face of the source: mapped to the nearest point, with zero "
                "confidence.",
            )
        )
    return StoredMatch(surface_map, of_faces.astype(float), tuple(notes))


def _share_of_edges(pair: ObjectPair) -> float:
    """The part of the target's edges, in [0, 1], that connect vertices of the same numbers as on the source.

    Raises:
        MeshError: the meshes differ in the number of vertices, or share too few edges.
    """
    source, target = pair.source, pair.target
    count = len(target.vertices)
    if len(source.vertices) != count:
        raise zo.MeshError(
            "'{source}' has {source_vertices:,} vertices but '{target}' has {target_vertices:,}, so "
            "their vertex order differs: choose another method.",
            source=pair.source_name,
            source_vertices=len(source.vertices),
            target=pair.target_name,
            target_vertices=count,
        )
    shared = float(np.isin(_number_edges(target.edges, count), _number_edges(source.edges, count)).mean())
    if shared < SHARED_EDGES:
        raise zo.MeshError(
            "'{source}' and '{target}' share only {share:.0%} of their edges, so their vertex order "
            "differs: choose another method.",
            source=pair.source_name,
            target=pair.target_name,
            share=shared,
        )
    return shared


def map_of_file(pair: ObjectPair, path: str) -> Integers:
    """The source vertex (n_t,) of each target vertex, from a file that `zoomout match` wrote for these meshes.

    Raises:
        MeshError: the file does not exist, or belongs to other meshes.
    """
    if not path:
        raise zo.MeshError("The map file is missing: choose a map.npz written by `zoomout match`.")
    vertex = read_vertex_map(bpy.path.abspath(path))
    are_numbers = vertex.ndim == 1 and vertex.dtype.kind in "iu"
    least = int(vertex.max(initial=-1)) + 1 if are_numbers else 0
    fits = are_numbers and len(vertex) == len(pair.target.vertices) and least <= len(pair.source.vertices)
    if not fits or vertex.min() < 0:
        raise zo.MeshError(
            "{path} maps {vertices:,} vertices to a mesh of at least {least:,}, but '{target}' has "
            "{target_vertices:,} and '{source}' has {source_vertices:,}: choose the file of these two "
            "meshes, in this direction.",
            path=path,
            vertices=len(vertex),
            least=least,
            target=pair.target_name,
            target_vertices=len(pair.target.vertices),
            source=pair.source_name,
            source_vertices=len(pair.source.vertices),
        )
    return vertex


def _number_edges(edges: Integers, count: int) -> Integers:
    """(e,) a number for each undirected edge (e, 2) of a mesh with `count` vertices."""
    ends = np.sort(edges.astype(np.int64), axis=1)
    return ends[:, 0] * count + ends[:, 1]
