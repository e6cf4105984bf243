# SPDX-License-Identifier: GPL-3.0-or-later
"""Fit the target to the source, from stiff to soft.

The images of the target's vertices are noisy, folded in places, and as uneven as the map. The target's own edges,
rotated with their surroundings by the map, regularise them. Each round updates the rotations, then solves for positions
near the goals of the vertices. Goals are closest points with similar normals, source vertices that no vertex would
reach, and images where the map is right. All rounds of a stage have the same matrix and share one factorisation (as in
projective dynamics, Bouaziz et al. 2014). The stiff stages of large targets run on a coarse copy, which resolves their
motion.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, segment_sum
from zoomout_core.geometry.procrustes import SMALLEST
from zoomout_core.mesh.triangles import area_normals, edge_lengths, triangle_areas
from zoomout_core.runtime.progress import advance, portion
from zoomout_core.transfer.frames import frames_of, on_working_mesh
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.wrapping.coarsening import Coarsening
from zoomout_core.transfer.wrapping.elastic import Elastic, Pins, RestMesh
from zoomout_core.transfer.wrapping.projections import Projections
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class FitTuning(Tuning, set_by="wrap"):
    """The stiffness of the target, and the number of rounds of projection.

    Attributes:
        coarse: length over which edges resist in the first stage, and in the form at detail zero.
        softest: the same in the last stage, at smoothness zero.
        stiffest: the same in the last stage, at smoothness one.
        stages: number of stages from coarse to the last one.
        rounds: rounds of each stage.
        last_rounds: further rounds, in which projections move along the source.
        coarse_vertices: number of vertices of the coarse copy of the target on which the first stages are run.
        worthwhile: minimum ratio of the target's vertices to those of the copy; other targets have none.
        spacings: stages are run on the copy if their length is at least this multiple of its vertex spacing.
        averaged_over: length over which rotations and errors of the map are averaged.
        scales_over: length over which scales are averaged.
        max_growth: maximum growth of a face by the map, relative to its surroundings; beyond it the map is wrong there.
        max_stretch: maximum stretch of a face by the map, in one direction relative to another.
        image_pull: weight of images relative to projections at smoothness zero; decreases to zero at one.
    """

    coarse: float = tuned(0.1, "at unit area", 1e-6, 1)
    softest: float = tuned(0.002, "at unit area", 1e-6, 1)
    stiffest: float = tuned(0.032, "at unit area", 1e-6, 1)
    stages: int = tuned(5, "stages", 2, 100)
    rounds: int = tuned(5, "rounds", 1, 100)
    last_rounds: int = tuned(6, "rounds", 0, 100)
    coarse_vertices: int = tuned(5000, "vertices", 4, 10**6)
    worthwhile: float = tuned(2.0, "1", 1, 10**6)
    spacings: float = tuned(1.0, "1", 0, 1000)
    averaged_over: float = tuned(0.02, "at unit area", 1e-6, 1)
    scales_over: float = tuned(0.1, "at unit area", 1e-6, 1)
    max_growth: float = tuned(2.45, "1", 1, 100)
    max_stretch: float = tuned(3.0, "1", 1, 100)
    image_pull: float = tuned(2.0, "1", 0, 1000)


FIT = FitTuning()
# Weight of a vertex whose surroundings are wrongly mapped.
MIN_SOUNDNESS = 1e-4


class Fit:
    """The target being fitted to the source; positions are those of its working mesh, at unit area of the source.

    Args:
        mapped: the target on the source; without confidence where it should not follow the map.
        weight: (n_t,) how far each vertex moves to the source, in [0, 1].
        given: (n_s,) which vertices of the source have a partner on the target.
        pins: places of the working mesh that must reach given positions.
        smoothness: how evenly edges flow, in [0, 1].

    Attributes:
        weight: (n,) the same for the working mesh's vertices.
        turns: (n, 3, 3) rotations of its vertices.
        trust: (n,) how far the map is followed.
        length: length over which edges resist in the last stage, at unit area.
        elastic: the system of the last stage, after `run`.
    """

    elastic: Elastic

    def __init__(self, mapped: MappedTarget, weight: Floats, given: Booleans, pins: Pins, smoothness: float) -> None:
        frames = frames_of(mapped)
        self.working, self.pins = mapped.target.working, pins
        self.weight = on_working_mesh(self.working, weight)
        self.turns = np.swapaxes(frames.rotations, 1, 2)
        self.rest_mesh = RestMesh.of(frames, FIT.averaged_over)
        self.projections = Projections(mapped, given, turn_normals(self.working.vertex_normals, self.turns))
        self.trust = frames.trust * self._soundness()
        self.rest_mesh = replace(self.rest_mesh, scales=self._smooth_scales())
        self.length = FIT.softest * (FIT.stiffest / FIT.softest) ** smoothness
        self._image_pull = FIT.image_pull * (1 - smoothness) ** 2 * self.trust

    def run(self) -> None:
        """Move the target near the source, in stages from stiff to soft."""
        lengths = np.geomspace(FIT.coarse, self.length, FIT.stages)
        rounds = FIT.stages * FIT.rounds + FIT.last_rounds
        positions, number = self.projections.images, self._coarse_stages(lengths)
        if number:
            with portion(0, 0):
                coarsening = Coarsening.of(self.working.vertices, self.working.oriented_triangles, FIT.coarse_vertices)
            with portion(0, number * FIT.rounds / rounds):
                positions = self._lift_stages(coarsening, lengths[:number])
        with portion(number * FIT.rounds / rounds, 1 - FIT.last_rounds / rounds):
            self.elastic, positions = self._run_stages(lengths[number:], positions, first=not number)
        with portion(1 - FIT.last_rounds / rounds, 1):
            self.projections.jump(positions)
            for done in range(FIT.last_rounds):
                self.turns = self.elastic.turns(positions)
                self.projections.walk(positions)
                goals = self.projections.with_images(self._image_pull)
                positions = self.elastic.solve(goals, self.rest_mesh.loads(self.turns))
                advance((done + 1) / FIT.last_rounds)
        self.turns = self.elastic.turns(positions)
        self.projections.walk(positions)

    def _coarse_stages(self, lengths: Floats) -> int:
        """How many of the stages, by their lengths (s,), are run on a coarse copy of the target; never the last."""
        if len(self.weight) < FIT.worthwhile * FIT.coarse_vertices:
            return 0
        return min(int((lengths >= FIT.spacings / np.sqrt(FIT.coarse_vertices)).sum()), len(lengths) - 1)

    def _lift_stages(self, coarsening: Coarsening, lengths: Floats) -> Floats:
        """(n, 3) positions after stages of lengths (s,) on a coarse copy."""
        some, rest = coarsening.vertices, self.rest_mesh.rest
        coarse = copy(self)  # all that `_run_stages` reads is replaced
        coarse.rest_mesh = self.rest_mesh.coarsen(some, coarsening.triangles)
        coarse.projections = self.projections.coarsen(some, coarsening.triangles)
        coarse.weight, coarse.trust, coarse.turns = self.weight[some], self.trust[some], self.turns[some]
        coarse._image_pull = self._image_pull[some]
        coarse.pins = self.pins.on(rest, rest[some], coarsening.triangles)
        elastic, positions = coarse._run_stages(lengths, coarse.projections.images, first=True)
        linear = coarse.rest_mesh.scales[:, None, None] * elastic.turns(positions)
        return coarsening.lift(rest, positions, linear, self.projections.images)

    def _run_stages(self, lengths: Floats, positions: Floats, first: bool) -> tuple[Elastic, Floats]:
        """Run stages of lengths (s,) from positions (n, 3); the first one starts from the map.

        Returns the system of the last stage, and (n, 3) positions.
        """
        for stage, length in enumerate(lengths):
            from_map = first and not stage
            elastic = Elastic(self.rest_mesh, self.trust if from_map else self.weight, length, self.pins)
            for number in range(FIT.rounds):
                goals = self.projections.images
                if not from_map:
                    self.projections.jump(positions)
                    goals = self.projections.goals(positions, self._image_pull)
                if number or not from_map:
                    self.turns = elastic.turns(positions)
                positions = elastic.solve(goals, self.rest_mesh.loads(self.turns))
                advance((stage * FIT.rounds + number + 1) / (len(lengths) * FIT.rounds))
        return elastic, positions

    def form(self) -> Floats:
        """(n, 3) positions of the target's own form, fitted to its projections over long distances only."""
        return Elastic(self.rest_mesh, self.weight, FIT.coarse, self.pins).solve(
            self.projections.places, self.rest_mesh.loads(self.turns)
        )

    def _soundness(self) -> Floats:
        """(n,) soundness of the map around each vertex, in (0, 1]: the share of area of sound faces."""
        corners, images = self.working.oriented_triangles, self.projections.images
        scale = float(np.median(self.rest_mesh.scales))
        area = triangle_areas(self.working.vertices, corners)
        normals = area_normals(images, corners)
        outwards = (self.projections.outwards[:, None] * self.projections.normals)[corners].sum(axis=1)
        growth = np.linalg.norm(normals, axis=1) / 2 / (scale**2 * np.maximum(area, SMALLEST))
        edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)
        stretch = edge_lengths(images, edges) / np.maximum(edge_lengths(self.working.vertices, edges), SMALLEST)
        wrong = np.einsum("mx,mx->m", normals, outwards) < 0
        wrong |= np.abs(np.log(np.maximum(growth, SMALLEST))) > 2 * np.log(FIT.max_growth)
        wrong |= stretch.max(axis=1) > FIT.max_stretch * stretch.min(axis=1)
        of_wrong, whole = (segment_sum(np.repeat(x, 3), corners.ravel(), len(images)) for x in (wrong * area, area))
        share = of_wrong / np.maximum(whole, SMALLEST)
        return np.asarray(np.clip(1 - 2 * self.rest_mesh.averaging.smooth(share[:, None])[:, 0], MIN_SOUNDNESS, 1) ** 2)

    def _smooth_scales(self) -> Floats:
        """(n,) scales of the mesh, averaged over long distances where the map is trusted."""
        middle = float(np.median(self.rest_mesh.scales))
        scales = np.log(np.clip(self.rest_mesh.scales / middle, 1 / FIT.max_stretch, FIT.max_stretch))
        no_pins = Pins(csr_array((0, len(scales))), np.zeros((0, 3)))
        elastic = Elastic(self.rest_mesh, self.trust, FIT.scales_over, no_pins)
        sums = elastic.smooth(np.column_stack([scales, np.ones(len(scales))]))
        return np.asarray(middle * np.exp(sums[:, 0] / sums[:, 1]))


def turn_normals(normals: Floats, turns: Floats) -> Floats:
    """(q, 3) normals (q, 3), rotated or reflected by (q, 3, 3), still on the outer side."""
    return np.asarray(np.linalg.det(turns)[:, None] * np.einsum("qij,qj->qi", turns, normals))
