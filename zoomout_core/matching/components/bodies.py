# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose the meshes that represent two surfaces: their main parts, or hulls around all of their parts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.matching.components.hulls import main_part_coverage, shares_of_outside
from zoomout_core.matching.components.main_parts import main_parts
from zoomout_core.matching.preparation.memory_cache import cached_hull
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.threads import for_each
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class BodyTuning(Tuning, set_by="characters"):
    """Which bodies to try, by the part of the hull that the main part covers."""

    # From this coverage on, only the main part is matched, because a hull adds nothing, such as to a body without its
    # eyes.
    all_of_body: float = tuned(0.98, "1", 0, 1)
    whole_body: float = tuned(0.9, "1", 0, 1)  # from this coverage on, the main part is tried first
    # If the main parts' shares of the two outsides differ by more than this, one surface shows hair, shoes or glasses
    # that are fused with the body on the other one, and hulls are tried first.
    outside: float = tuned(0.02, "1", 0, 1)
    # Below this coverage only the hull is matched. Above it, main parts may be more similar than hulls that consist of
    # hair and skirts.
    much_of_body: float = tuned(0.5, "1", 0, 1)


BODIES = BodyTuning()


class Bodies(NamedTuple):
    """The meshes that represent two surfaces in a match."""

    source: WorkingMesh
    target: WorkingMesh
    coverage: float  # the part of both bodies, in [0, 1], that they cover
    shares: Floats  # (c,) the part of the source's outside, in [0, 1], that each of its components makes up


def find_bodies(source: Surface, target: Surface, seed: int) -> list[Bodies]:
    """The bodies of two surfaces, the most promising pair first; more than one pair if the choice is not clear.

    Raises:
        MeshError: they have too few vertices.
    """
    surfaces = (source,) if source is target else (source, target)
    if all(surface.working.component.max() == 0 for surface in surfaces):
        return [Bodies(*main_parts(source, target, seed), 1.0, np.ones(1))]
    with portion(0.0, 0.6):
        hulls = for_each(cached_hull, surfaces)
    coverage = min(main_part_coverage(*each) for each in zip(surfaces, hulls, strict=True))
    shares = [shares_of_outside(*each) for each in zip(surfaces, hulls, strict=True)]
    outside = [float(each[0]) for each in shares]
    around = Bodies(hulls[0], hulls[-1], 1.0, shares[0])
    if coverage < BODIES.much_of_body:
        return [around]
    try:
        with portion(0.6, 1.0):
            main = Bodies(*main_parts(source, target, seed), coverage, shares[0])
    except MeshError:  # the hulls are not too small
        return [around]
    if abs(outside[0] - outside[-1]) > BODIES.outside:
        return [around, main._replace(coverage=min(outside))]
    if coverage >= BODIES.all_of_body:
        return [main]
    return [main, around] if coverage >= BODIES.whole_body else [around, main]


def tight_bodies(source: Surface, target: Surface, shares: Floats) -> Bodies:
    """Hulls that separate touching limbs, if the match of other bodies is uncertain; `shares` (c,) are theirs."""
    hulls = for_each(partial(cached_hull, tight=True), (source, target))
    return Bodies(hulls[0], hulls[1], 1.0, shares)
