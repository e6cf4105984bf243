# SPDX-License-Identifier: GPL-3.0-or-later
"""Generated meshes with known correspondence: creatures, a game character, and a scan of it.

Generators share the modules `spheres`, `grids`, `arcs`, `implicit` (bodies) and `skeletons`.
"""

from zoomout_core.samples.characters import (
    STANCE,
    UPRIGHT,
    body,
    character,
    checker,
    in_stance,
    joints,
    scan,
    write_samples,
)
from zoomout_core.samples.creatures import (
    BODY,
    FLAT,
    LENGTHS,
    LIMBS,
    NAMES,
    SHARPNESS,
    Creature,
    creature,
    limb_weights,
    posed,
    true_vertex,
)
from zoomout_core.samples.spheres import directions

__all__ = [
    "BODY",
    "FLAT",
    "LENGTHS",
    "LIMBS",
    "NAMES",
    "SHARPNESS",
    "STANCE",
    "UPRIGHT",
    "Creature",
    "body",
    "character",
    "checker",
    "creature",
    "directions",
    "in_stance",
    "joints",
    "limb_weights",
    "posed",
    "scan",
    "true_vertex",
    "write_samples",
]
