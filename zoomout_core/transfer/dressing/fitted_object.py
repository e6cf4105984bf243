# SPDX-License-Identifier: GPL-3.0-or-later
"""An object that a source wears, fitted to the shape of a target by its stiffness and its rigid parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.sparse import coo_array, csc_array, diags_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.gradients import turn_gradients
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.mesh.triangles import unique_edges
from zoomout_core.transfer.dressing.following import Following, Motion
from zoomout_core.transfer.dressing.form import Form
from zoomout_core.transfer.dressing.kept_parts import KeptParts
from zoomout_core.transfer.dressing.solid_parts import solid_parts, touching_points, with_solid_parts
from zoomout_core.tuning import Tuning, tuned

# Ways to fit objects: soft ones keep their form according to their stiffness, rigid ones rotate and scale as a whole.
# "automatic" is soft, except for small solid parts. "hair" is automatic, but moves as a whole where it hangs freely.
Manner: TypeAlias = Literal["automatic", "soft", "rigid", "hair"]
# Stiffness of a link between touching points: that of an edge between equilateral triangles. It is doubled if each of
# the two is among the nearest points of the other.
LINK = 3**-0.5
# An edge is reported as stretched if it grows by more than the first multiple of the body's growth there, and is longer
# than the second number, at unit area. Shorter ones are hardly visible.
STRETCHED, MIN_LENGTH = 2.0, 0.01


@dataclass(frozen=True)
class DressTuning(Tuning, set_by="outfits"):
    """How far soft objects keep their form.

    Attributes:
        softest: length over which they keep their form at stiffness zero.
        stiffest: the same at stiffness one.
        near: distance from the skin at which they follow it half as much.
        layer: minimum area of a connected part that is a separate layer. Strands of a braid, which pass over and under
            each other, are smaller.
    """

    softest: float = tuned(0.005, "at unit area", 1e-6, 1)
    stiffest: float = tuned(0.1, "at unit area", 1e-6, 10)
    near: float = tuned(0.03, "at unit area", 1e-6, 1)
    layer: float = tuned(0.03, "at unit area", 0, 1)


DRESS = DressTuning()


@dataclass(eq=False)
class FittedObject:
    """A worn object that was moved with the body."""

    form: Form  # the worn object
    motion: Motion  # the motion of its points with the body
    positions: Floats  # (n, 3) its current positions
    parts: list[Integers]  # points of its solid parts
    is_rigid: bool  # whether it is one solid part as a whole

    @classmethod
    def of(cls, form: Form, motion: Motion, manner: Manner, stiffness: float) -> FittedObject:
        """Fit a form to the motion of its surroundings, with a stiffness in [0, 1]."""
        if manner == "rigid":
            moved = procrustes(form.rest, motion.images, form.areas)(form.rest)
            return cls(form, motion, moved, [], True)
        # Near the positions moved by the body, with the rest edges rotated and scaled.
        length = DRESS.softest * (DRESS.stiffest / DRESS.softest) ** stiffness
        pull = form.areas / (1 + (motion.distance / DRESS.near) ** 2)
        joined = csc_array(form.stiffness + _links(form))
        gradients = (turn_gradients(joined, motion.turns) @ form.rest.ravel()).reshape(-1, 3)
        moved = ScreenedSmoothing.of(pull, joined, length).fit(motion.images, gradients)
        solid = [] if manner == "soft" else solid_parts(form)
        kept = KeptParts.of(form)
        if kept.count:
            rigid, _ = kept.fit_rigidly(form, moved, float(np.median(motion.growth)))
            moved = moved + kept.displace(form, rigid - moved[kept.points], pull, length)
            solid = [part for part in solid if not form.keep[part].any()]
        return cls(form, motion, moved, solid, False)

    @property
    def soft(self) -> Integers:
        """Points outside solid parts."""
        return np.setdiff1d(np.arange(len(self.form.rest)), np.concatenate([[], *self.parts]))

    def of_vertices(self, following: Following) -> tuple[Floats, Floats, Booleans]:
        """(n_v, 3) positions and (n_v, 3, 3) turns of the vertices, in units of the shape and of the body.

        Also returns a mask (n_v,) of those that are stretched. Unconnected vertices only follow the body.
        """
        positions = with_solid_parts(self.form, self.parts, self.soft, self.motion.images, self.positions)
        number = self.form.number
        found, turns, alone = positions[number], self._turns(positions)[number], np.flatnonzero(number < 0)
        stretched = _stretched_points(self.form, self.motion, positions)[number] & (number >= 0)
        if len(alone):
            motion = following.motion(self.form.places[alone])
            found[alone], turns[alone] = motion.images, motion.turns
        return following.unit_after * found, following.unit_after / following.unit * turns, stretched

    def _turns(self, positions: Floats) -> Floats:
        """(n, 3, 3) rotation and growth around each point, of the body or of the part that keeps its form."""
        kept, turns = KeptParts.of(self.form), self.motion.turns.copy()
        _, linear = kept.fit_rigidly(self.form, positions, float(np.median(self.motion.growth)))
        turns[kept.points] += kept.weights[kept.points, None, None] * (linear - turns[kept.points])
        return turns


def _links(form: Form) -> csc_array:
    """(n, n) stiffness of links between touching parts, which keep the strands of a braid together."""
    first, second = touching_points(form.rest, form.component).T
    links = coo_array((np.full(len(first), LINK), (first, second)), shape=form.stiffness.shape)
    weights = csc_array(links + links.T)
    return csc_array(diags_array(weights.sum(axis=0)) - weights)


def _stretched_points(form: Form, motion: Motion, positions: Floats) -> Booleans:
    """(n,) points at edges that grow far more than the body does there."""
    edges, _ = unique_edges(form.triangles)
    before, after = (np.linalg.norm(each[edges[:, 0]] - each[edges[:, 1]], axis=1) for each in (form.rest, positions))
    allowed = STRETCHED * np.maximum(motion.growth[edges].max(axis=1), 1) * before
    return np.isin(np.arange(len(form.rest)), edges[(after > allowed) & (after > MIN_LENGTH)])
