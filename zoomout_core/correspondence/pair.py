"""The two sides of a match: surfaces as the user gave them, and their main parts, prepared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.correspondence.shape import Shape
from zoomout_core.surface import Floats, Integers, MeshError, Surface


@dataclass(frozen=True, eq=False)
class Pair:
    """Two surfaces with their prepared main parts.

    Attributes:
        source: the surface that the map lands on.
        target: the surface that the map starts from.
        source_shape: the source's largest part.
        target_shape: the target's largest part.
        k_final: size of the final functional map.
        step: growth of the functional map in an iteration.
    """

    source: Surface
    target: Surface
    source_shape: Shape
    target_shape: Shape
    k_final: int
    step: int


def positions_of_part(surface: Surface, shape: Shape) -> Floats:
    """(n, 3) the vertices of a shape's part in the surface's own frame and unit."""
    vertex_of = shape.proxy.full.vertex_of
    used = np.flatnonzero(vertex_of >= 0)
    positions = np.empty_like(shape.proxy.full.vertices)
    positions[vertex_of[used]] = surface.vertices[used]
    return positions


def landmarks_on_parts(pair: Pair, landmarks: tuple[ArrayLike, ArrayLike]) -> tuple[Integers, Integers]:
    """Paired vertices of the surfaces as vertices of the shapes' meshes.

    Raises:
        ValueError: numbers out of range, or not as many on either side.
        MeshError: a landmark lies off the largest part.
    """
    ids = []
    for role, surface, shape, given in (
        ("source", pair.source, pair.source_shape, landmarks[0]),
        ("target", pair.target, pair.target_shape, landmarks[1]),
    ):
        vertices = np.atleast_1d(np.asarray(given, dtype=np.int64))
        if len(vertices) == 0 or vertices.min() < 0 or vertices.max() >= len(surface.vertices):
            raise ValueError(f"Landmarks on the {role} must be numbers of its {len(surface.vertices)} vertices.")
        on_part = shape.proxy.full.vertex_of[vertices]
        if (on_part < 0).any():
            raise MeshError(
                f"Vertex {vertices[on_part < 0][0]} of the {role} is a landmark off its largest part: move it."
            )
        ids.append(shape.proxy.place.vertex[on_part])
    if len(ids[0]) != len(ids[1]):
        raise ValueError(f"{len(ids[0])} source and {len(ids[1])} target landmarks were given: they come in pairs.")
    return ids[0], ids[1]
