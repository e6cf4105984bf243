# SPDX-License-Identifier: GPL-3.0-or-later
"""Read a match from a file, for a transfer without matching again."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike

import numpy as np

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.maps.surface_map import SurfaceMap, arrays_of_map, read_vertex_map
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface


@dataclass(frozen=True, eq=False)
class KnownMatch:
    """The parts of an earlier match that a transfer needs.

    Attributes:
        surface_map: a point on the source for each vertex of the target.
        confidence: (n_t,) confidence of each vertex, in [0, 1].
        has_partner: (n_t,) whether each vertex has a partner on the source.
        source_has_partner: (n_s,) the same for the source's vertices.
        notes: sentences for the user.
    """

    surface_map: SurfaceMap
    confidence: Floats
    has_partner: Booleans
    source_has_partner: Booleans
    notes: tuple[str, ...] = ()

    @classmethod
    def load(cls, path: str | PathLike[str], source: Surface, target: Surface) -> KnownMatch:
        """Read a match that `zoomout match` or `zoomout collection` wrote; a bare map is trusted everywhere.

        Raises:
            MeshError: it contains no map, or a map of other surfaces.
        """
        surface_map, vertex = SurfaceMap.load(path, source), read_vertex_map(path)
        sizes = dict.fromkeys(("confidence", "has_partner"), len(target.vertices))
        sizes["source_has_partner"] = len(source.vertices)
        values = {name: np.ones(count) for name, count in sizes.items()} | arrays_of_map(path, tuple(sizes))
        for name, each in values.items():
            if each.dtype.kind not in "biuf":
                raise MeshError(f"{path} contains no match, because its {name} is not made of numbers: match again.")
        fits = len(vertex) == len(target.vertices) and np.array_equal(vertex, surface_map.vertex)
        if not fits or any(values[name].shape != (count,) for name, count in sizes.items()):
            other = (
                f"of {len(vertex)} vertices between other surfaces, but this target has {len(target.vertices)}"
                if len(vertex) != len(target.vertices)
                else f"onto another source than this one of {len(source.vertices)} vertices"
            )
            raise MeshError(f"{path} is a map {other}: match these two again.")
        return cls(
            surface_map,
            np.nan_to_num(values["confidence"].astype(np.float64)).clip(0, 1),
            values["has_partner"].astype(bool),
            values["source_has_partner"].astype(bool),
        )
