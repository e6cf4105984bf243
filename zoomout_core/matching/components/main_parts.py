# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose the component of a surface that is its body: the largest, unless a cloak or a dress is larger."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.matching.preparation.proxy import make_proxy
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.threads import for_each
from zoomout_core.spectral.eigenbasis import working_basis

# Fewest vertices of a component that can be matched.
MIN_VERTICES = 12
# A component may be the body if its area is at least this fraction of the largest one's.
MIN_AREA_FRACTION = 0.4
# Number of nonzero eigenvalues that compare components, and of vertices of the proxies that give them.
COMPARED_EIGENVALUES = 20
SPECTRUM_VERTICES = 1500
# Mean difference of log eigenvalues by which a pair may exceed the best one and still be the same body in two poses.
SPECTRAL_TOLERANCE = 0.1


def main_parts(source: Surface, target: Surface, seed: int) -> tuple[WorkingMesh, WorkingMesh]:
    """Choose the component of each of two surfaces to match; the others follow it.

    These are the components of largest area, unless others have clearly more similar spectra, or the largest are
    sheets.

    Raises:
        MeshError: a component is too small.
    """
    roles = ((source, "mesh"),) * 2 if source is target else ((source, "source"), (target, "target"))
    with portion(0.0, 0.2):
        ours, theirs = for_each(lambda each: _comparable(*each), roles)
    if len(ours) == len(theirs) == 1:
        return ours[0], theirs[0]
    count = min(COMPARED_EIGENVALUES + 1, *(len(part.vertices) - 1 for part in (*ours, *theirs)))
    with portion(0.2, 1.0):
        spectra = for_each(lambda part: _spectrum(part, count, seed), (*ours, *theirs))
    of_source, of_target = np.array(spectra[: len(ours)]), np.array(spectra[len(ours) :])
    difference = np.abs(of_source[:, None] - of_target).mean(axis=2)
    pairs = [(ours[i], theirs[j]) for i, j in np.argwhere(difference <= difference.min() + SPECTRAL_TOLERANCE)]
    return max(pairs, key=lambda pair: (sum(part.sides_are_known for part in pair), pair[0].scale * pair[1].scale))


def _comparable(surface: Surface, role: str) -> list[WorkingMesh]:
    """The components that may be the body, the largest first."""
    working = surface.working
    area = np.bincount(working.component[working.triangles[:, 0]], triangle_areas(working.vertices, working.triangles))
    parts = [working.part(int(number))[0] for number in np.flatnonzero(area >= MIN_AREA_FRACTION * area[0])]
    enough = [part for part in parts if len(part.vertices) >= MIN_VERTICES]
    if not enough:
        raise MeshError(
            f"The largest part of the {role} has only {{count:,}} vertices, too few for matching: subdivide it to at "
            "least {least}.",
            count=len(parts[0].vertices),
            least=MIN_VERTICES,
        )
    return enough


def _spectrum(part: WorkingMesh, count: int, seed: int) -> Floats:
    """(count - 1,) logarithms of the eigenvalues but the first, at unit area: the same in every pose."""
    basis = working_basis(make_proxy(part, SPECTRUM_VERTICES).mesh, count, seed)
    return np.log(np.maximum(basis.eigenvalues[1:], 1e-12))
