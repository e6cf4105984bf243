# SPDX-License-Identifier: GPL-3.0-or-later
"""Replace NaN and infinite values, which would spread to all values that they are mixed with."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.input_checks import measurable
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import message
from zoomout_core.transfer.attribute import Attribute, Domain, Kind, mean_over_vertices
from zoomout_core.transfer.cut_mesh import CUT_TOLERANCE, adjacent_edges, face_edges
from zoomout_core.transfer.groups import label_groups

NOT_FINITE = "{count:,} of {total:,} values of '{name}' are not finite, and were replaced by the nearest finite values."


def places_of(domain: Domain, surface: Surface) -> Floats:
    """(count, 3) centres of elements; corners are at their vertices."""
    if domain is Domain.CORNER:
        return np.asarray(surface.vertices[surface.corner_vertex])
    return mean_over_vertices(surface.vertices, domain, surface)


def with_finite_values(attribute: Attribute, surface: Surface) -> Attribute:
    """Replace values that are not finite by those around them, and note it.

    A corner without a UV takes that of an adjacent face on its island. If no face at its vertex has one, it takes the
    mean of the neighboring corners on the island. Offsets take those of the same key at the nearest vertex. Other
    values, and UVs without any around them, take the nearest ones.

    If one column of another element is not finite, all of its columns are replaced.

    Raises:
        MeshError: none of the values of the attribute, or of a key, is finite.
    """
    given: Any = attribute.values
    values: Any = given.tocsr() if hasattr(given, "tocsr") else np.asarray(given)
    if values.dtype.kind != "f":
        return attribute
    finite = np.isfinite(values).all(axis=2) if attribute.kind is Kind.OFFSET else _finite_rows(values)
    if finite.all():
        return attribute
    if attribute.kind is Kind.OFFSET:
        filled = values.copy()
        for key in np.flatnonzero(~finite.all(axis=0)):
            filled[:, key] = values[_nearest_finite(finite[:, key], attribute, surface), key]
    elif attribute.kind is Kind.UV and finite.any():
        filled, known = _fill_from_islands(values, finite, surface)
        filled = filled[_nearest_finite(known, attribute, surface)]
    else:
        filled = values[_nearest_finite(finite, attribute, surface)]
    note = message(NOT_FINITE, count=int((~finite).sum()), total=finite.size, name=attribute.name)
    return replace(attribute, values=filled, notes=(*attribute.notes, note))


def _finite_rows(values: Any) -> Booleans:
    """(count,) which rows of values (count, ...), an array or a csr_array, are finite."""
    if isinstance(values, np.ndarray):
        return np.asarray(np.isfinite(values.reshape(len(values), -1)).all(axis=1))
    broken = np.flatnonzero(~np.isfinite(values.data))
    row = np.searchsorted(values.indptr, broken, side="right") - 1
    return np.isin(np.arange(len(values.indptr) - 1), row, invert=True)


def _nearest_finite(finite: Booleans, attribute: Attribute, surface: Surface) -> Integers:
    """(count,) the nearest element with a finite value for each element (count,), itself if its own is finite.

    Raises:
        MeshError: there is none.
    """
    places = places_of(attribute.domain, surface)
    somewhere = measurable(places)
    known, unknown = np.flatnonzero(finite & somewhere), np.flatnonzero(~finite)
    nearest = np.arange(len(finite))
    if not len(unknown):
        return nearest
    if not len(known):
        raise MeshError("'{name}' has no finite values: correct them.", name=attribute.name)
    # Elements without a position belong to no face, and take any value.
    at = np.where(somewhere[unknown, None], places[unknown], 0)
    nearest[unknown] = known[cKDTree(places[known]).query(at)[1]]
    return nearest


def _fill_from_islands(values: Floats, finite: Booleans, surface: Surface) -> tuple[Floats, Booleans]:
    """UVs (c, 2) filled in from corners on the same island, and (c,) which are known then."""
    group = _joined_corners(values, finite, surface)
    corner, following = face_edges(surface).T
    filled, known = values.copy(), finite
    for one, other in (
        (corner, corner),
        (np.concatenate([corner, following]), np.concatenate([following, corner])),
    ):
        count = np.bincount(group[one], known[other], len(group))
        total = [np.bincount(group[one], np.where(known[other], axis[other], 0), len(group)) for axis in filled.T]
        mean = np.stack(total, axis=1) / np.maximum(count, 1)[:, None]
        found = ~known & (count[group] > 0)
        filled[found] = mean[group[found]]
        known = known | found
    return filled, known


def _joined_corners(values: Floats, finite: Booleans, surface: Surface) -> Integers:
    """(c,) group of each corner, after joining faces at edges where their known UVs, of one end at least, are equal."""
    first, second = adjacent_edges(surface)
    known = finite[first] & finite[second]
    shown = np.where(finite[:, None], values, 0)
    tolerance = CUT_TOLERANCE * float(np.ptp(values[finite], axis=0).max())
    same = (np.abs(shown[first] - shown[second]) <= tolerance).all(axis=2)
    joined = known.any(axis=1) & (same | ~known).all(axis=1)
    return label_groups(len(values), first[joined].ravel(), second[joined].ravel())
