# SPDX-License-Identifier: GPL-3.0-or-later
"""A layer of a MeshSet as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from meshlab_filter.textures import Textures
from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.named_parts import NamedParts, name_parts
from zoomout_core.mesh.point_cloud import PointCloud
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer import Attribute, Domain

TEXCOORD = "texcoord"


@dataclass(frozen=True, eq=False)
class Layer:
    """A layer of a MeshSet as arrays: n vertices and m triangles.

    Attributes:
        label: its name.
        shape: the triangles, or the points, in the global frame.
        vertices: (n, 3) positions, in the layer's own frame.
        normals: (n, 3) vertex normals.
        edges: (e, 2) vertex indices of polylines.
        faux: (m, 3) whether the edge from each corner to the next is inside a polygon.
        transform: (4, 4) from the layer's frame to the global one.
        components: by name those of `mesh_data.COMPONENTS` that the layer has, with scene-linear colours; as
            `TEXCOORD` its texture coordinates (3 m, 2) at the corners of the triangles.
        custom: custom attributes.
        textures: the textures that the texture coordinates refer to.
        texture: (m,) the index of each triangle's texture; None without texture coordinates.
    """

    label: str
    shape: Surface | PointCloud
    vertices: Floats
    normals: Floats
    edges: Integers
    faux: Booleans
    transform: Floats
    components: dict[str, Attribute]
    custom: tuple[Attribute, ...]
    textures: Textures | None
    texture: Integers | None

    @property
    def surface(self) -> Surface:
        """The layer's triangles, or those reconstructed from its points."""
        return as_surface(self.shape)

    @property
    def parts(self) -> NamedParts:
        """The parts of the surface: MeshLab keeps no names but those of textures."""
        if self.textures is None or self.texture is None:
            return name_parts(self.surface)
        return name_parts(self.surface, materials=self.textures.names, material_of=self.texture)

    @property
    def faces(self) -> Integers:
        """(m, 3) vertex indices of the layer's own triangles; points have none."""
        return self.shape.triangles if isinstance(self.shape, Surface) else np.empty((0, 3), dtype=np.int64)

    def can_hold(self, attribute: Attribute) -> bool:
        """Whether the layer has the elements of an attribute's domain: points have no faces or corners."""
        return attribute.domain is Domain.POINT or len(self.faces) > 0
