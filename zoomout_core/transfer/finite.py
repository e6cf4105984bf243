# SPDX-License-Identifier: GPL-3.0-or-later
"""Replace NaN and infinite values, which would spread to all values that they are mixed with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.input_checks import measurable
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import message
from zoomout_core.transfer.attribute import Attribute, Domain, mean_over_vertices

NOT_FINITE = "{count:,} of {total:,} values of '{name}' are not finite, and were replaced by the nearest finite values."


def places_of(domain: Domain, surface: Surface) -> Floats:
    """(count, 3) centres of elements; corners are at their vertices."""
    if domain is Domain.CORNER:
        return np.asarray(surface.vertices[surface.corner_vertex])
    return mean_over_vertices(surface.vertices, domain, surface)


def with_finite_values(attribute: Attribute, surface: Surface) -> Attribute:
    """Replace values that are not finite by those of the nearest places on a surface, and note it.

    Raises:
        MeshError: none of the attribute's values is finite.
    """
    values = np.asarray(attribute.values)
    if values.dtype.kind != "f":
        return attribute
    finite = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    if finite.all():
        return attribute
    places = places_of(attribute.domain, surface)
    somewhere = measurable(places)
    known = np.flatnonzero(finite & somewhere)
    if not len(known):
        raise MeshError("'{name}' has no finite values: correct them.", name=attribute.name)
    filled = values.copy()
    unknown = np.flatnonzero(~finite)
    # Elements without a position belong to no face, and take any value.
    at = np.where(somewhere[unknown, None], places[unknown], 0)
    filled[unknown] = values[known[cKDTree(places[known]).query(at)[1]]]
    note = message(NOT_FINITE, count=len(unknown), total=len(values), name=attribute.name)
    return replace(attribute, values=filled, notes=(*attribute.notes, note))
