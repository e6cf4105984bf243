"""A map of a surface onto itself: what mirroring needs, whether it was just found or kept from before."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.analysis import ANALYSIS, ShapeAnalysis
from zoomout_core.matching.components.bodies import Bodies, bodies_steps
from zoomout_core.matching.match import ANALYSES, prepared_steps
from zoomout_core.matching.memory_cache import kept_analysis_steps
from zoomout_core.matching.proxy import proxy_size
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.stepping import Progress, Steps, drain, spread, within
from zoomout_core.runtime.threads import alone, in_background, on_one_blas_thread
from zoomout_core.symmetry.sides import Line, zero_line

# Size of the final functional maps, and how many samples they are refined on.
K_FINAL, SAMPLES = 120, 1000


@dataclass(frozen=True, eq=False, kw_only=True)
class SelfMap:
    """A map of a surface onto itself, and the sides that it gives the surface.

    Attributes:
        surface: that it is a map of.
        surface_map: for every vertex the point that corresponds to it.
        confidence: (n,) in [0, 1].
        reverses_orientation: whether it is a reflection, as left and right are, and not a turn.
        distance: (n,) signed distance along the surface from the symmetry line, in the surface's unit, positive on the
            left; it grows no more some way off the line, and is zero throughout where there are no two sides.
        prepared: the surface's main part, where it was analysed before; see `shape`.
    """

    surface: Surface
    surface_map: SurfaceMap
    confidence: Floats
    reverses_orientation: bool
    distance: Floats
    prepared: ShapeAnalysis | None = None

    @property
    def has_partner(self) -> None:
        """Every vertex has one, so that there is nothing to say which have."""

    @cached_property
    def line(self) -> Line:
        """The symmetry line, where `distance` is zero; without points where there are no two sides."""
        return zero_line(self.distance, self.surface)

    @cached_property
    def shape(self) -> ShapeAnalysis:
        """The surface's main part; analysed now, if it was not before."""
        return self.prepared or drain(main_shape_steps(self.surface))

    @property
    def has_sides(self) -> bool:
        """Whether a line divides the surface into left and right."""
        return bool(np.any(self.distance))

    def sides(self, width: float = 0.0) -> Integers:
        """(n,) 1 on the left, -1 on the right, 0 in the middle: no farther from the line than `width`, in its unit."""
        return np.where(np.abs(self.distance) <= width, 0, np.sign(self.distance)).astype(np.int8)


@memory_in_words
@on_one_blas_thread
def main_shape_steps(
    surface: Surface,
    k_final: int = K_FINAL,
    samples: int = SAMPLES,
    seed: int = 0,
    proxy_vertices: int | Literal["auto"] | None = "auto",
) -> Steps[ShapeAnalysis]:
    """The main part of a surface, ready to have its symmetries found, or at once if it was prepared before.

    Arguments as for `detect_symmetry`.

    Raises:
        MeshError: a mesh that cannot be analysed; the message says what to do.
    """
    (body, *_) = yield from within(bodies_of_steps(surface, seed), 0.0, 0.04)
    return (yield from within(body_shape_steps(body.source, k_final, samples, seed, proxy_vertices), 0.04, 1.0))


def bodies_of_steps(surface: Surface, seed: int) -> Steps[list[Bodies]]:
    """What of a surface may stand for it, the most promising first."""
    yield Progress(0.0, "Reading the mesh")
    yield from spread(in_background(lambda: surface.working), 0.0, 0.5, "Reading the mesh")
    return (yield from spread(bodies_steps(surface, surface, seed), 0.5, 1.0, "Finding the body"))


def body_shape_steps(
    body: WorkingMesh, k_final: int, samples: int, seed: int, proxy_vertices: int | Literal["auto"] | None
) -> Steps[ShapeAnalysis]:
    """A surface's body, ready to have its symmetries found; arguments as for `detect_symmetry`."""
    k = max(k_final, ANALYSIS.fewest_functions)
    preparing = kept_analysis_steps(body, k, samples, seed, proxy_size(len(body.vertices), proxy_vertices))
    return (yield from spread(alone(prepared_steps(preparing, ANALYSES)), 0.0, 1.0, "Analysing the shape"))
