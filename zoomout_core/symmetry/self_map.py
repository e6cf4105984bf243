# SPDX-License-Identifier: GPL-3.0-or-later
"""A map of a surface onto itself, new or stored, as mirroring needs it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.components.bodies import Bodies, find_bodies
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.prepare import prepare_shape
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.runtime.summary import Summary
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.symmetry.sides import Line, zero_line

# Size of the final functional maps, and number of samples for refining them.
K_FINAL, SAMPLES = 120, 1000


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SelfMap(Summary):
    """A map of a surface onto itself, and the sides that it defines.

    Attributes:
        surface: the surface of the map.
        surface_map: the corresponding point for every vertex.
        confidence: (n,) in [0, 1].
        reverses_orientation: whether it is a reflection, like left and right, and not a rotation.
        distance: (n,) signed distance along the surface from the symmetry line, in the surface's unit, positive on the
            left. It is constant beyond some distance from the line, and zero everywhere if there are no two sides.
        prepared: the surface's main part, if it was analysed before; see `shape`.
    """

    surface: Surface
    surface_map: SurfaceMap
    confidence: Floats
    reverses_orientation: bool
    distance: Floats
    prepared: ShapeAnalysis | None = None

    @property
    def source(self) -> Surface:
        """The surface, which the map lands on."""
        return self.surface

    @property
    def target(self) -> Surface:
        """The surface, which the map starts from."""
        return self.surface

    @property
    def has_partner(self) -> None:
        """None, since every vertex has a partner."""

    @cached_property
    def line(self) -> Line:
        """The symmetry line, where `distance` is zero; without points if there are no two sides."""
        return zero_line(self.distance, self.surface)

    @cached_property
    def shape(self) -> ShapeAnalysis:
        """The surface's main part; analysed on first use."""
        return self.prepared or main_shape(self.surface)

    def _summary(self) -> dict[str, str]:
        return {
            "surface": f"{len(self.surface.vertices):,} vertices",
            "kind": "reflection" if self.reverses_orientation else "rotation",
            "confidence": f"{self.confidence.mean():.2f} on average",
        }

    @property
    def has_sides(self) -> bool:
        """Whether a line divides the surface into left and right."""
        return bool(np.any(self.distance))

    def sides(self, width: float = 0.0) -> Integers:
        """(n,) 1 on the left, -1 on the right, 0 within `width` of the line, in the surface's unit.

        Example:
            >>> symmetry = zo.detect_symmetry(source, k_final=30)[0]
            >>> symmetry.sides(width=0.02).shape == (len(source.vertices),)
            True
        """
        return np.where(np.abs(self.distance) <= width, 0, np.sign(self.distance)).astype(np.int8)


@memory_in_words
@on_one_blas_thread
def main_shape(
    surface: Surface,
    k_final: int = K_FINAL,
    samples: int = SAMPLES,
    seed: int = 0,
    proxy_vertices: int | Literal["auto"] | None = "auto",
) -> ShapeAnalysis:
    """Prepare the main part of a surface for finding symmetries; returns at once if it was prepared before.

    Arguments and errors as for `detect_symmetry`.
    """
    with portion(0.0, 0.04):
        body, *_ = bodies_of(surface, seed)
    with portion(0.04, 1.0):
        return body_shape(body.source, k_final, samples, seed, proxy_vertices)


def bodies_of(surface: Surface, seed: int) -> list[Bodies]:
    """Parts of a surface that may represent it, the most promising first."""
    with stage("Reading the mesh", 0.0, 0.5):
        _ = surface.working
    with stage("Finding the body", 0.5, 1.0):
        return find_bodies(surface, surface, seed)


def body_shape(
    body: WorkingMesh, k_final: int, samples: int, seed: int, proxy_vertices: int | Literal["auto"] | None
) -> ShapeAnalysis:
    """Prepare a surface's body for finding symmetries; arguments as for `detect_symmetry`."""
    with stage("Analyzing the shape"):
        return prepare_shape(body, k_final, samples, seed, proxy_vertices)
