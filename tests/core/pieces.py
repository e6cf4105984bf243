# SPDX-License-Identifier: GPL-3.0-or-later
"""Pieces of generated creatures for partial matching."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from creatures import Creature, creature, true_vertex

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.matching.partial.incomplete_shape import IncompleteShape
from zoomout_core.matching.partial.landmark_maps import place_all, place_few
from zoomout_core.matching.partial.region import Region
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.mesh.surface import Surface

FUNCTIONS, SAMPLES = 60, 400


def piece_of(made: Creature, kept: Booleans) -> Creature:
    """Cut a creature down to the triangles whose vertices are all kept (n,)."""
    triangles = made.surface.triangles[kept[made.surface.triangles].all(axis=1)]
    used = np.unique(triangles)
    number = np.full(len(kept), -1)
    number[used] = np.arange(len(used))
    return Creature(Surface(made.surface.vertices[used], number[triangles]), made.directions[used])


def analyse_piece(made: Creature) -> ShapeAnalysis:
    return analyse(made.surface.working.part(0)[0], FUNCTIONS, SAMPLES, 0)


@dataclass(frozen=True, eq=False)
class PartAndWhole:
    """A piece of a bent creature and the whole creature at rest, in the same unit.

    Attributes:
        made_part: the generated piece.
        made_whole: the generated creature.
        part: analysed shape of the piece.
        whole: analysed shape of the creature.
    """

    made_part: Creature
    made_whole: Creature
    part: IncompleteShape
    whole: IncompleteShape

    @property
    def everywhere(self) -> Region:
        """The whole surface as the search region of the part."""
        return Region.everywhere(self.part, self.whole)

    def true_places(self) -> Integers:
        """(d,) number of the place of the whole that is nearest to the true image of each place of the part."""
        part, whole = (each.shape.search.samples[: len(each.between)] for each in (self.part, self.whole))
        apart = self.made_part.directions[part] @ self.made_whole.directions[whole].T
        return np.asarray(np.argmax(apart, axis=1))

    def errors(self, images: Integers, vertices: Integers | slice = slice(None)) -> np.ndarray:
        """(q,) Euclidean distance between images on the whole (q,) and the true images of vertices of the part."""
        true = true_vertex(self.made_whole, self.made_part)[vertices]
        points = self.whole.shape.mesh.vertices
        return np.asarray(np.linalg.norm(points[images] - points[true], axis=1))


def in_lower_half(made: Creature) -> Booleans:
    """(n,) which vertices of a creature are on the legs, the tail or one arm."""
    return made.directions @ [0.6, 0, -0.8] > -0.15


def lower_half(count: int = 1100) -> tuple[Creature, Creature]:
    """The legs, tail and one arm of a lopsided creature with bent limbs, and the whole creature at rest."""
    bent = creature(count, seed=1, bend=0.5, asymmetry=0.3)
    return piece_of(bent, in_lower_half(bent)), creature(1000, seed=0, asymmetry=0.3)


def extend_landmarks(
    landmarks: Integers, placed: Integers, unlike: Floats, target: IncompleteShape, source: IncompleteShape
) -> Integers:
    """(d_t,) the source's place for each place of the target, by landmarks (m,), placed on the source (m,)."""
    return place_all(place_few(landmarks, placed, unlike, target, source), unlike, target, source)
