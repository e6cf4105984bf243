# SPDX-License-Identifier: GPL-3.0-or-later
"""The target fitted to the source: from stiff to soft, then onto its surface, and no face turned over.

The images of the target's vertices are noisy, folded here and there, and as uneven as the map. So the target's own
edges, turned as the map turns its surroundings, hold against them. Rounds follow in which edges turn on as they lie,
and vertices are drawn to feet that are nearer to them: closest points whose normals agree, what of the source would be
left over, and the images as far as the map is sound there. The matrix of the system stays the same for all rounds of a
stage, which so take one factorisation (as in projective dynamics, Bouaziz et al. 2014).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from zoomout_core.arrays import Booleans, Floats, segment_sum
from zoomout_core.mesh.triangles import area_normals, triangle_areas
from zoomout_core.runtime.progress import advance
from zoomout_core.transfer.cut_mesh import edge_lengths
from zoomout_core.transfer.frames import frames_of, on_working_mesh
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.wrapping.elastic import Elastic, Pins, Skin, no_pins
from zoomout_core.transfer.wrapping.feet import Feet
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class FitTuning(Tuning, set_by="wrap"):
    """How stiff the target is, and how often feet are sought.

    Attributes:
        coarse: length over which edges hold in the first stage, and in the form that is left where no detail is
            followed.
        softest: the same of the last stage, where smoothness is zero.
        stiffest: the same where it is one.
        stages: from coarse to the last one.
        rounds: of each.
        last_rounds: besides, in which feet walk along the source.
        averaged_over: length over which turns are averaged, and what is wrong with the map.
        scales_over: the same of scales.
        most_growth: of an edge or a face by the map, beside its surroundings, from which on it is wrong there.
        most_stretch: of a face in one direction beside another.
        image_pull: how much images count beside feet, where smoothness is zero; not at all where it is one.
    """

    coarse: float = tuned(0.1, "at unit area", 1e-6, 1)
    softest: float = tuned(0.002, "at unit area", 1e-6, 1)
    stiffest: float = tuned(0.032, "at unit area", 1e-6, 1)
    stages: int = tuned(5, "stages", 2, 100)
    rounds: int = tuned(5, "rounds", 1, 100)
    last_rounds: int = tuned(6, "rounds", 0, 100)
    averaged_over: float = tuned(0.02, "at unit area", 1e-6, 1)
    scales_over: float = tuned(0.1, "at unit area", 1e-6, 1)
    most_growth: float = tuned(2.45, "1", 1, 100)
    most_stretch: float = tuned(3.0, "1", 1, 100)
    image_pull: float = tuned(2.0, "1", 0, 1000)


FIT = FitTuning()
# Guard against division by zero.
SMALLEST = 1e-300
# A vertex in the midst of what is wrong with a map still counts by this part.
LEAST_SOUND = 1e-4


class Fit:
    """The target on its way onto the source; positions are those of its working mesh, at unit area of the source.

    Args:
        mapped: the target on the source; of no confidence where it is not to follow the map.
        weight: (n_t,) how far each vertex goes onto the source, in [0, 1].
        given: (n_s,) which vertices of the source have something on the target.
        pins: places of the working mesh that must come to given positions.
        smoothness: how evenly edges flow, in [0, 1].

    Attributes:
        weight: the same of the working mesh's vertices (n,).
        skin: the target as an elastic skin.
        feet: where its vertices belong.
        turns: (n, 3, 3) of its vertices.
        pins: as given.
        trust: (n,) how far the map is followed.
        length: over which edges hold in the end, at unit area.
    """

    def __init__(self, mapped: MappedTarget, weight: Floats, given: Booleans, pins: Pins, smoothness: float) -> None:
        frames = frames_of(mapped)
        self.working, self.pins = mapped.target.working, pins
        self.weight = on_working_mesh(self.working, weight)
        self.turns = np.swapaxes(frames.rotations, 1, 2)
        self.skin = Skin.of(frames, FIT.averaged_over)
        self.feet = Feet(mapped, given, self.turned_normals(self.working.vertex_normals, self.turns))
        self.trust = frames.trust * self._soundness()
        self.skin = replace(self.skin, scales=self._smooth_scales())
        self.length = FIT.softest * (FIT.stiffest / FIT.softest) ** smoothness
        self._image_pull = FIT.image_pull * (1 - smoothness) ** 2 * self.trust

    def run(self) -> Floats:
        """(n, 3) positions near the source: stages from stiff to soft."""
        lengths = np.geomspace(FIT.coarse, self.length, FIT.stages)
        positions, done, rounds = self.feet.images, 0, FIT.stages * FIT.rounds + FIT.last_rounds
        for stage, length in enumerate(lengths):
            elastic = Elastic(self.skin, self.weight if stage else self.trust, length, self.pins)
            for number in range(FIT.rounds):
                drawn_to = self._feet_of_round(positions) if stage else self.feet.images
                if stage or number:
                    self.turns = elastic.turns(positions)
                positions = elastic.solve(drawn_to, self.skin.loads(self.turns))
                done += 1
                advance(done / rounds)
        self.feet.jump(positions)
        for _ in range(FIT.last_rounds):
            self.turns = elastic.turns(positions)
            self.feet.walk(positions)
            positions = elastic.solve(self.feet.with_images(self._image_pull), self.skin.loads(self.turns))
            done += 1
            advance(done / rounds)
        self.turns = elastic.turns(positions)
        self.feet.walk(positions)
        return positions

    def form(self) -> Floats:
        """(n, 3) positions of the target's own form, as its feet lie over long distances."""
        return Elastic(self.skin, self.weight, FIT.coarse, self.pins).solve(
            self.feet.places, self.skin.loads(self.turns)
        )

    def turned_normals(self, normals: Floats, turns: Floats) -> Floats:
        """(q, 3) normals (q, 3) of the working mesh, turned (q, 3, 3)."""
        return np.asarray(np.linalg.det(turns)[:, None] * np.einsum("qij,qj->qi", turns, normals))

    def _feet_of_round(self, positions: Floats) -> Floats:
        self.feet.jump(positions)
        return self.feet.drawn(positions, self._image_pull)

    def _soundness(self) -> Floats:
        """(n,) how sound the map is around each vertex, in (0, 1]: few faces there turn over, or grow beside others."""
        corners, images, scale = self.working.oriented_triangles, self.feet.images, float(np.median(self.skin.scales))
        area = triangle_areas(self.working.vertices, corners)
        normals = area_normals(images, corners)
        outwards = (self.feet.outwards[:, None] * self.feet.normals)[corners].sum(axis=1)
        growth = np.linalg.norm(normals, axis=1) / 2 / (scale**2 * np.maximum(area, SMALLEST))
        edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)
        stretch = edge_lengths(images, edges) / np.maximum(edge_lengths(self.working.vertices, edges), SMALLEST)
        wrong = np.einsum("mx,mx->m", normals, outwards) < 0
        wrong |= np.abs(np.log(np.maximum(growth, SMALLEST))) > 2 * np.log(FIT.most_growth)
        wrong |= stretch.max(axis=1) > FIT.most_stretch * stretch.min(axis=1)
        of_vertex = segment_sum(np.repeat(wrong * area, 3), corners.ravel(), len(images))
        share = of_vertex / np.maximum(segment_sum(np.repeat(area, 3), corners.ravel(), len(images)), SMALLEST)
        return np.asarray(np.clip(1 - 2 * self.skin.averaging.smooth(share[:, None])[:, 0], LEAST_SOUND, 1) ** 2)

    def _smooth_scales(self) -> Floats:
        """(n,) scales of the skin, averaged over long distances where the map can be trusted."""
        middle = float(np.median(self.skin.scales))
        scales = np.log(np.clip(self.skin.scales / middle, 1 / FIT.most_stretch, FIT.most_stretch))
        elastic = Elastic(self.skin, self.trust, FIT.scales_over, no_pins(len(scales)))
        sums = elastic.spread(np.column_stack([scales, np.ones(len(scales))]))
        return np.asarray(middle * np.exp(sums[:, 0] / sums[:, 1]))
