# SPDX-License-Identifier: GPL-3.0-or-later
"""Correspondences stored on the target as custom attributes: found once, used by several filters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from meshlab_filter.mesh_data import Layer, attribute_values, has_attribute
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.maps.surface_map import SurfaceMap, fault_of_map
from zoomout_core.mesh.surface import MeshError

if TYPE_CHECKING:
    from pymeshlab import Mesh

# An image that is farther from where it was stored than this, of the source's size, lies on another source.
MOVED = 1e-6


@dataclass(frozen=True, eq=False)
class Correspondence:
    """What filters need of a match.

    Attributes:
        surface_map: for every target vertex a point on the source surface.
        confidence: (n_t,) in [0, 1].
        has_partner: (n_t,) whether there is something on the source for a vertex; None where that was not asked.
    """

    surface_map: SurfaceMap
    confidence: Floats
    has_partner: Booleans | None = None


def check_names(mesh: Mesh, names: Iterable[str]) -> None:
    """Whether custom attributes can be added to a mesh under these names, and used in expressions.

    Raises:
        ValueError: a name has other characters than letters, digits and underscores.
        MeshError: there is an attribute of that name; pymeshlab can neither change nor delete it.
    """
    for name in names:
        if not (name.isascii() and name.isidentifier()):
            raise ValueError(f"'{name}' is not a valid attribute name: use letters, digits and underscores.")
        if has_attribute(mesh, name):
            raise MeshError(f"Layer '{mesh.label()}' already has an attribute '{name}': choose another name.")


def attribute_names(name: str) -> tuple[str, ...]:
    """The attributes that a correspondence is stored in: triangle, coordinates in it, point (three), confidence.

    The point is three scalars since expressions of MeshLab's filters misread custom points: they are stored in a
    list that moves as it grows.
    """
    return tuple(f"{name}_{part}" for part in ("triangle", "barycentric", "x", "y", "z", "confidence"))


def partner_name(name: str) -> str:
    """The attribute that says, by 1 or 0, whether a vertex has a partner."""
    return f"{name}_has_partner"


def store(mesh: Mesh, name: str, found: Correspondence, source: Layer) -> None:
    """Store a correspondence on a target; points are in the source's own frame."""
    triangle, barycentric, *axes, confidence = attribute_names(name)
    mesh.add_vertex_custom_scalar_attribute(found.surface_map.triangle.astype(np.float64), triangle)
    mesh.add_vertex_custom_point_attribute(found.surface_map.barycentric.astype(np.float64), barycentric)
    for axis, values in zip(axes, found.surface_map.interpolate(source.vertices).T, strict=True):
        mesh.add_vertex_custom_scalar_attribute(np.ascontiguousarray(values), axis)
    mesh.add_vertex_custom_scalar_attribute(found.confidence.astype(np.float64), confidence)
    if found.has_partner is not None:
        mesh.add_vertex_custom_scalar_attribute(found.has_partner.astype(np.float64), partner_name(name))


def read_stored(mesh: Mesh, name: str, source: Layer) -> Correspondence:
    """The correspondence of a target that `store` stored under a name.

    Raises:
        MeshError: there is none, or it leads to another source, or to one that has changed.
    """
    if not all(has_attribute(mesh, part) for part in attribute_names(name)):
        raise MeshError(
            f"Layer '{mesh.label()}' has no correspondence '{name}': find it with compute_correspondence_by_zoomout."
        )
    number, barycentric, *point, confidence = (attribute_values(mesh, part) for part in attribute_names(name))
    triangle = np.nan_to_num(number, nan=-1.0).astype(np.int64)
    if not fault_of_map(triangle, barycentric, len(source.surface.triangles)) and not np.isnan(confidence).any():
        surface_map = SurfaceMap(triangle, barycentric, source.surface.triangles)
        moved = np.abs(surface_map.interpolate(source.vertices) - np.column_stack(point)).max()
        if moved <= MOVED * np.ptp(source.vertices[source.surface.triangles.ravel()], axis=0).max():
            known = has_attribute(mesh, partner_name(name))
            return Correspondence(
                surface_map, confidence, attribute_values(mesh, partner_name(name)) > 0.5 if known else None
            )
    raise MeshError(
        f"The correspondence '{name}' of layer '{mesh.label()}' belongs to a different source than '{source.label}', "
        "or to an earlier version of it: compute it again under another name."
    )
