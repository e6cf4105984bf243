"""What of two surfaces is matched: their main parts, or skins around all of their parts."""

from __future__ import annotations

from collections.abc import Generator
from functools import partial
from typing import NamedTuple

from zoomout_core.matching.components.main_parts import main_part_steps
from zoomout_core.matching.components.skins import covered_by_main_part, skin_of
from zoomout_core.mesh.surface import MeshError, Surface
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.stepping import scaled
from zoomout_core.runtime.threads import for_each

# A main part that lies below so much of the skin is the body, and what else there is lies on it. One that lies below
# less may still be more alike than skins that are hair and skirts, unless it is less than the third. Skins tell nothing
# more than one that lies below as much as the first: `benchmarks characters`, a body without its eyes.
ALL_OF_BODY, WHOLE_BODY, MUCH_OF_BODY = 0.98, 0.9, 0.5


class Bodies(NamedTuple):
    """What stands for each of two surfaces in a match.

    Attributes:
        source: a mesh.
        target: a mesh.
        coverage: the part of both bodies, in [0, 1], that they tell of.
    """

    source: WorkingMesh
    target: WorkingMesh
    coverage: float


def bodies_steps(source: Surface, target: Surface, seed: int) -> Generator[float, None, list[Bodies]]:
    """The bodies of two surfaces; more than one pair where it is not clear what they are, the most promising first.

    Yields the fraction done.

    Raises:
        MeshError: they are too small to be known by.
    """
    surfaces = (source,) if source is target else (source, target)
    if all(surface.working.component.max() == 0 for surface in surfaces):
        return [Bodies(*(yield from main_part_steps(source, target, seed)), 1.0)]
    skins = yield from scaled(for_each(skin_of, surfaces), 0.0, 0.6)
    coverage = min(covered_by_main_part(*each) for each in zip(surfaces, skins, strict=True))
    around = Bodies(skins[0], skins[-1], 1.0)
    if coverage < MUCH_OF_BODY:
        return [around]
    try:
        main = Bodies(*(yield from scaled(main_part_steps(source, target, seed), 0.6, 1.0)), coverage)
    except MeshError:  # the skins are not too small
        return [around]
    if coverage >= ALL_OF_BODY:
        return [main]
    return [main, around] if coverage >= WHOLE_BODY else [around, main]


def tight_bodies_steps(source: Surface, target: Surface) -> Generator[float, None, Bodies]:
    """Skins that part limbs which touch, for surfaces that are not known by others; yields the fraction done."""
    skins = yield from for_each(partial(skin_of, tight=True), (source, target))
    return Bodies(skins[0], skins[1], 1.0)
