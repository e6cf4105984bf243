# SPDX-License-Identifier: GPL-3.0-or-later
"""Data on a mesh, independent of the program that it comes from."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoomout_core.arrays import Booleans, Floats, fill_masked
from zoomout_core.mesh.surface import Surface


class Domain(Enum):
    """The elements that an attribute has values for.

    Example:
        >>> [domain.name for domain in zo.Domain]
        ['POINT', 'EDGE', 'FACE', 'CORNER']
    """

    POINT = auto()
    EDGE = auto()
    FACE = auto()
    CORNER = auto()


class Kind(Enum):
    """How values may be mixed; the rules are in `rules.RULES`.

    Example:
        >>> zo.Kind.UV.name
        'UV'
    """

    SCALAR = auto()
    VECTOR = auto()
    DIRECTION = auto()
    NORMAL = auto()
    COLOR = auto()
    UV = auto()
    QUATERNION = auto()
    MATRIX = auto()
    LABEL = auto()
    BOOLEAN = auto()
    MARK = auto()
    WEIGHT = auto()
    OFFSET = auto()


@dataclass(frozen=True, eq=False)
class Attribute:
    """A named array over the points, edges, faces or corners of a mesh.

    Attributes:
        name: name shown to the user.
        domain: the elements that have one value each.
        kind: the meaning of the values, which determines how they are mixed.
        values: (count, ...) array; for WEIGHT a sparse (n, groups) csr_array, for OFFSET (n, keys, 3). Masked values
            become NaN.
        labels: names of the columns, if they have names (vertex groups, shape keys).
        notes: sentences for the user about the origin of the values.

    Raises:
        TypeError: the domain or the kind is something else.

    Example:
        >>> heights = zo.Attribute("height", zo.Domain.POINT, zo.Kind.SCALAR, source.vertices[:, 2])
        >>> heights.values.shape == (len(source.vertices),)
        True
    """

    name: str
    domain: Domain
    kind: Kind
    values: Any
    labels: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for field, given, enumeration in (("domain", self.domain, Domain), ("kind", self.kind, Kind)):
            if not isinstance(given, enumeration):
                choice = f"zo.{enumeration.__name__}"
                raise TypeError(
                    f"The {field} of the attribute '{self.name}' is {given!r:.60}: give a {choice}, such as "
                    f"{choice}.{_member_name(given, enumeration)}."
                )
        object.__setattr__(self, "values", fill_masked(self.values))
        object.__setattr__(self, "labels", tuple(self.labels))


def _member_name(given: object, enumeration: type[Enum]) -> str:
    """The name in an enumeration that equals a text regardless of case, otherwise the first one."""
    names = list(enumeration.__members__)
    return str(given).upper() if str(given).upper() in names else names[0]


def element_count(domain: Domain, surface: Surface) -> int:
    """The number of elements of a surface."""
    counts = {
        Domain.POINT: len(surface.vertices),
        Domain.FACE: len(surface.face_start) - 1,
        Domain.CORNER: len(surface.corner_vertex),
    }
    return len(surface.edges) if domain is Domain.EDGE else counts[domain]


def nothing(values: NDArray[Any], count: int) -> NDArray[Any]:
    """(count, ...) zeros, false or empty strings, of the type of values."""
    if values.dtype.kind == "O":
        return np.full((count, *values.shape[1:]), "", dtype=object)
    return np.zeros((count, *values.shape[1:]), dtype=values.dtype)


def is_nothing(values: NDArray[Any]) -> Booleans:
    """(count,) which of the values (count, ...) are zero, false or empty in all their columns."""
    same = np.asarray(values == nothing(values, 1), dtype=bool)
    return np.asarray(same.all(axis=tuple(range(1, same.ndim))))


def mean_over_vertices(values: Floats, domain: Domain, surface: Surface) -> Floats:
    """(count, ...) means of values (n, ...) over the vertices of each element; all corners of a face take its mean."""
    if domain is Domain.POINT:
        return values
    if domain is Domain.EDGE:
        return np.asarray(values[surface.edges].mean(axis=1))
    size = np.diff(surface.face_start).reshape(-1, *[1] * (values.ndim - 1))
    of_face = np.add.reduceat(values[surface.corner_vertex], surface.face_start[:-1]) / size
    return np.asarray(of_face[surface.corner_face] if domain is Domain.CORNER else of_face)
