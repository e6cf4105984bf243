"""Which component of a surface is its body: the largest, unless a cloak or a dress is larger."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.matching.proxy import make_proxy
from zoomout_core.mesh.surface import MeshError, Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.threads import for_each
from zoomout_core.spectral.eigenbasis import working_basis
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class MainPartTuning(Tuning, set_by="judgement"):
    """Which component may be the body, and how components are compared.

    Attributes:
        smallest_part: that can be matched.
        comparable: a component whose area is at least this part of the largest one's may be the body.
        eigenvalues: that components are compared by.
        vertices: of the stand-ins that these are computed on.
        alike: spectra that differ by less, in the mean of the logarithm, may be the same body's in two poses.
    """

    smallest_part: int = tuned(12, "vertices", 4, 1000)
    comparable: float = tuned(0.4, "1", 0, 1)
    eigenvalues: int = tuned(20, "eigenvalues", 1, 1000)
    vertices: int = tuned(1500, "vertices", 10, 1_000_000)
    alike: float = tuned(0.1, "1", 0, 10)


MAIN_PARTS = MainPartTuning()


def main_parts(source: Surface, target: Surface, seed: int) -> tuple[WorkingMesh, WorkingMesh]:
    """The component of each of two surfaces that is matched, and takes the others along.

    Those of the largest area, unless others have spectra that are clearly more alike, or are not sheets.

    Args:
        source: a surface.
        target: another one.
        seed: of the eigensolver.

    Returns:
        A component of the source, and one of the target.

    Raises:
        MeshError: a component is too small.
    """
    roles = ((source, "mesh"),) * 2 if source is target else ((source, "source"), (target, "target"))
    with portion(0.0, 0.2):
        ours, theirs = for_each(lambda each: _comparable(*each), roles)
    if len(ours) == len(theirs) == 1:
        return ours[0], theirs[0]
    count = min(MAIN_PARTS.eigenvalues + 1, *(len(part.vertices) - 1 for part in (*ours, *theirs)))
    with portion(0.2, 1.0):
        spectra = for_each(lambda part: _spectrum(part, count, seed), (*ours, *theirs))
    of_source, of_target = np.array(spectra[: len(ours)]), np.array(spectra[len(ours) :])
    difference = np.abs(of_source[:, None] - of_target).mean(axis=2)
    pairs = [(ours[i], theirs[j]) for i, j in np.argwhere(difference <= difference.min() + MAIN_PARTS.alike)]
    return max(pairs, key=lambda pair: (sum(part.sides_are_known for part in pair), pair[0].scale * pair[1].scale))


def _comparable(surface: Surface, role: str) -> list[WorkingMesh]:
    """The components that may be the body, the largest first."""
    working = surface.working
    area = np.bincount(working.component[working.triangles[:, 0]], triangle_areas(working.vertices, working.triangles))
    parts = [working.part(int(number))[0] for number in np.flatnonzero(area >= MAIN_PARTS.comparable * area[0])]
    enough = [part for part in parts if len(part.vertices) >= MAIN_PARTS.smallest_part]
    if not enough:
        raise MeshError(
            f"The largest part of the {role} has {len(parts[0].vertices)} vertices, too few to know it by: "
            f"subdivide it to {MAIN_PARTS.smallest_part} or more."
        )
    return enough


def _spectrum(part: WorkingMesh, count: int, seed: int) -> Floats:
    """(count - 1,) logarithms of the eigenvalues but the first, at unit area: the same in every pose."""
    basis = working_basis(make_proxy(part, MAIN_PARTS.vertices).mesh, count, seed)
    return np.log(np.maximum(basis.eigenvalues[1:], 1e-12))
