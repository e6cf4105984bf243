# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions, which rotate with the surface, and normals, which point out of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zoomout_core.arrays import Floats, Integers, segment_sum
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas, triangle_normals, unit_vectors, vertex_normals
from zoomout_core.transfer.attribute import Attribute, Domain
from zoomout_core.transfer.frames import rotations
from zoomout_core.transfer.interpolate import MIX
from zoomout_core.transfer.mapped_target import MappedTarget

# Sine of the angle to which normals are lifted above the surface, if the transfer pushed them below it.
LIFTED_SINE = 0.05


def turn_directions(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer directions (count, 3): mixed, rotated with the surface, and of the same length as their sources."""
    length = np.linalg.norm(np.asarray(attribute.values, dtype=np.float64), axis=1)
    turned, length = _turn(attribute, length, mapped)
    return replace(turned, values=(unit_vectors(turned.values) * length[:, None]).astype(attribute.values.dtype))


def turn_normals(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer unit normals (count, 3): directions that stay above the surface if they are above the source's.

    The winding of the faces defines the upper side.
    """
    values = np.asarray(attribute.values, dtype=np.float64)
    height = np.einsum("cx,cx->c", values, outward_normals(mapped.source, attribute.domain))
    turned, height = _turn(attribute, height, mapped)
    normals, outward = unit_vectors(turned.values), outward_normals(mapped.target, attribute.domain)
    found = np.einsum("cx,cx->c", normals, outward)
    component = _components(mapped.target, attribute.domain)
    inside_out = (np.bincount(component, height * found) < 0)[component]
    normals[inside_out] -= 2 * (found[:, None] * outward)[inside_out]
    found[inside_out] *= -1
    pushed = (height > 0) & (found < 0)
    normals[pushed] += (LIFTED_SINE - found[pushed])[:, None] * outward[pushed]
    return replace(turned, values=unit_vectors(normals).astype(attribute.values.dtype))


def _turn(attribute: Attribute, number: Floats, mapped: MappedTarget) -> tuple[Attribute, Floats]:
    """Mix and rotate vectors to the target, and mix a number (count,) of each."""
    both = np.column_stack([np.asarray(attribute.values, dtype=np.float64), number])
    mixed = MIX[attribute.domain](replace(attribute, values=both), mapped)
    turned = np.einsum("cxy,cy->cx", rotations(mapped, attribute.domain), mixed.values[:, :3])
    return replace(mixed, values=turned), mixed.values[:, 3]


def _components(surface: Surface, domain: Domain) -> Integers:
    """(count,) number of each element's connected component."""
    at_points = surface.working.component[surface.working.vertex_of]
    if domain is Domain.POINT:
        return at_points
    at_corners = at_points[surface.corner_vertex]
    return at_corners if domain is Domain.CORNER else at_corners[surface.face_start[:-1]]


def outward_normals(surface: Surface, domain: Domain) -> Floats:
    """(count, 3) unit normals of the surface: of the vertices, also for corners, or of the faces."""
    vertices, triangles = surface.vertices, surface.triangles
    if domain is not Domain.FACE:
        normals = vertex_normals(vertices, triangles)
        return normals if domain is Domain.POINT else normals[surface.corner_vertex]
    weighted = triangle_normals(vertices, triangles) * triangle_areas(vertices, triangles)[:, None]
    return unit_vectors(segment_sum(weighted, surface.triangle_face, len(surface.face_start) - 1))
