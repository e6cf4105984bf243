# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of the loose parts of a file, from its objects and materials."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Integers
from zoomout_core.assets.asset import MATERIALS, Asset
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas

# Distance below which two vertices coincide, relative to the size of the mesh: rounding to single precision.
SAME_PLACE = 1e-5


class PartName(NamedTuple):
    """How a file calls a connected component.

    Attributes:
        number: of the component, from 0 for that of the largest area.
        name: of its object; empty if the format has none.
        material: of its material; empty without one.
    """

    number: int
    name: str = ""
    material: str = ""

    @property
    def label(self) -> str:
        """The name for the user."""
        return ": ".join(dict.fromkeys(filter(None, (self.name, self.material)))) or f"part {self.number}"


def name_parts(asset: Asset) -> list[PartName]:
    """The names of the connected components of an asset's surface; the material is that on most of the area."""
    first = _first_of_each(asset.surface.components)
    objects = np.repeat(np.arange(len(asset.objects)), [count for _, count in asset.objects])
    materials = _material_of_each(asset, len(first)).tolist()
    return [
        PartName(
            number,
            asset.objects[objects[vertex]][0] if len(objects) else "",
            asset.materials[material].name if material < len(asset.materials) else "",
        )
        for number, (vertex, material) in enumerate(zip(first.tolist(), materials, strict=True))
    ]


def name_parts_of(surface: Surface, asset: Asset) -> list[PartName]:
    """The names of a surface's components by those of an asset of the same file, which may split vertices otherwise.

    A component without a vertex at the same place in the asset has only its number.
    """
    names = name_parts(asset)
    component = surface.components
    places = surface.vertices[_first_of_each(component)]
    used = np.flatnonzero(asset.surface.components >= 0)
    near = SAME_PLACE * float(np.ptp(surface.vertices, axis=0).max())
    nearest = cKDTree(asset.surface.vertices[used]).query(places)[1]
    found = np.linalg.norm(asset.surface.vertices[used[nearest]] - places, axis=1) <= near
    other = np.where(found, asset.surface.components[used[nearest]], -1)
    return [
        PartName(number) if name < 0 else names[name]._replace(number=number)
        for number, name in enumerate(other.tolist())
    ]


def _material_of_each(asset: Asset, count: int) -> Integers:
    """(c,) the material on most of the area of each connected component; the number of all materials for none."""
    surface, materials = asset.surface, asset.find(MATERIALS)
    shares = np.zeros((count, len(asset.materials) + 1))
    shares[:, -1] = np.finfo(float).tiny
    if materials is not None:
        area = np.bincount(
            surface.triangle_face, triangle_areas(surface.vertices, surface.triangles), len(surface.face_start) - 1
        )
        component = surface.components[surface.corner_vertex[surface.face_start[:-1]]]
        used = component >= 0
        np.add.at(shares, (component[used], materials.values[used]), area[used])  # -1, without one, is the last column
    return shares.argmax(axis=1)


def _first_of_each(component: Integers) -> Integers:
    """(c,) the first vertex of each connected component."""
    first = np.full(component.max(initial=-1) + 1, -1)
    used = np.flatnonzero(component >= 0)[::-1]
    first[component[used]] = used
    return first
