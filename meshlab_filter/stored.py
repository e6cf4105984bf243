# SPDX-License-Identifier: GPL-3.0-or-later
"""Correspondences stored on the target as custom attributes, so that several filters can use them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from meshlab_filter.layer import Layer
from meshlab_filter.mesh_data import attribute_values, has_attribute
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.maps.surface_map import SurfaceMap, fault_of_map
from zoomout_core.mesh.errors import MeshError

if TYPE_CHECKING:
    from pymeshlab import Mesh

# If an image has moved by more than this fraction of the source's size, the source has changed.
MOVED = 1e-6


@dataclass(frozen=True, eq=False)
class Correspondence:
    """The part of a match that filters use.

    Attributes:
        surface_map: the map from target vertices to points on the source.
        confidence: (n_t,) in [0, 1].
        has_partner: (n_t,) whether a vertex has a partner on the source; None if unknown.
    """

    surface_map: SurfaceMap
    confidence: Floats
    has_partner: Booleans | None = None


def check_names(mesh: Mesh, names: Iterable[str]) -> None:
    """Check that custom attributes with these names can be added to a mesh and used in expressions.

    Raises:
        ValueError: a name has other characters than letters, digits and underscores.
        MeshError: an attribute of that name exists; pymeshlab can neither change nor delete it.
    """
    for name in names:
        if not (name.isascii() and name.isidentifier()):
            raise ValueError(f"'{name}' is not a valid attribute name: use letters, digits and underscores.")
        if has_attribute(mesh, name):
            raise MeshError(f"Layer '{mesh.label()}' already has an attribute '{name}': choose another name.")


def attribute_names(name: str) -> tuple[str, ...]:
    """The names of a correspondence's attributes: triangle, barycentric coordinates, point (three), confidence.

    The point is stored as three scalars because expressions of MeshLab's filters misread custom points: they are in a
    list that is reallocated as it grows.
    """
    return tuple(f"{name}_{part}" for part in ("triangle", "barycentric", "x", "y", "z", "confidence"))


def partner_name(name: str) -> str:
    """The name of the attribute that is 1 at vertices with a partner, and 0 elsewhere."""
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
    """Read the correspondence of a target that `store` has written under a name.

    Raises:
        MeshError: there is none, or its source is another mesh or has changed.
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
