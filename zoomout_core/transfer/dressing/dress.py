# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress: fit the objects that a source wears (clothes, hair, eyes, teeth, props) to the body of a target.

The source's body takes the target's shape along the match. Worn objects follow: the space around the body moves with
it. Soft objects keep their form according to their stiffness, and solid ones rotate and scale as a whole. Nothing that
was outside of the skin is pushed into it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import area_normals, unique_edges
from zoomout_core.messages import warning
from zoomout_core.runtime.progress import Progress, advance, listening, portion, stage
from zoomout_core.transfer.dressing.contact import (
    Barrier,
    Margins,
    SidedSurface,
    margins_with,
    push_out,
    push_out_rigidly,
)
from zoomout_core.transfer.dressing.following import Following, Motion
from zoomout_core.transfer.dressing.form import Form, Lines
from zoomout_core.transfer.dressing.solid_parts import solid_parts, with_solid_parts
from zoomout_core.transfer.frames import turn_gradients
from zoomout_core.transfer.rules import Match
from zoomout_core.transfer.wrapping.wrap import reverse_match, wrap
from zoomout_core.tuning import Tuning, tuned

# How objects are fitted: soft ones keep their form according to their stiffness, rigid ones rotate and scale as a
# whole; "automatic" is soft, except for small solid parts.
Manner: TypeAlias = Literal["automatic", "soft", "rigid"]
Carried: TypeAlias = Surface | Lines
# Fractions of the progress: inverting the match, as a share of shaping the body, and shaping the body, of the whole.
TURNED_ROUND, SHAPED = 0.5, 0.8
# An edge is reported as stretched if it grows by more than this multiple of the body's growth there, and is longer than
# this at unit area: shorter ones are hardly visible.
STRETCHED, MIN_LENGTH = 2.0, 0.01


@dataclass(frozen=True)
class DressTuning(Tuning, set_by="outfits"):
    """How far soft objects keep their form.

    Attributes:
        softest: length over which they keep their form at stiffness zero.
        stiffest: the same at stiffness one.
        near: distance from the skin at which they follow it half as much.
    """

    softest: float = tuned(0.005, "at unit area", 1e-6, 1)
    stiffest: float = tuned(0.1, "at unit area", 1e-6, 10)
    near: float = tuned(0.03, "at unit area", 1e-6, 1)


DRESS = DressTuning()


@dataclass(frozen=True, eq=False)
class Dressed:
    """The objects fitted to a target.

    Attributes:
        vertices: for each object (n, 3) positions of its vertices, in the target's frame and unit.
        turns: for each object (n, 3, 3) matrices that take small differences of positions from the source to the
            target.
        stretched: for each object (n,) vertices at edges that are stretched much more than the body.
        notes: sentences for the user.

    Example:
        >>> dressed = zo.dress(result, source, target, [source])
        >>> dressed.vertices[0].shape == source.vertices.shape
        True
    """

    vertices: tuple[Floats, ...]
    turns: tuple[Floats, ...]
    stretched: tuple[Booleans, ...]
    notes: tuple[str, ...]


@memory_in_words
def dress(
    result: Match | SurfaceMap,
    source: Surface,
    target: Surface,
    carried: Sequence[Carried],
    *,
    manners: Sequence[Manner] | None = None,
    stiffness: float = 0.5,
    gap: float = 0.0,
    progress: Callable[[Progress], object] | None = None,
) -> Dressed:
    """Fit objects that a source wears to the body of a target.

    Args:
        result: the match, or only its map, of each target vertex to a point of the source.
        source: the body that wears the objects, without them.
        target: the body to dress.
        carried: the objects, surfaces and lines, in the source's frame and unit.
        manners: how to fit each; "automatic", when not given.
        stiffness: how far soft objects keep their form, from 0, where they follow every detail of the body, to 1.
        gap: minimum distance from the skin of everything that was outside of it, in the target's unit.
        progress: called with the `Progress`, see `zoomout_core.progress`.

    Raises:
        MeshError: the map is of other surfaces, or nothing corresponds.
        ValueError: a number is out of its range, or there is not a manner for each.

    Example:
        >>> dressed = zo.dress(result, source, target, [source])
        >>> len(dressed.vertices)
        1
    """
    _check(carried, manners, stiffness, gap)
    with listening(progress):
        with portion(0, SHAPED):
            shape = shape_of_source(result, source, target)
        with portion(SHAPED, 1):
            return carry(source, shape, target, carried, manners=manners, stiffness=stiffness, gap=gap)


def shape_of_source(result: Match | SurfaceMap, source: Surface, target: Surface) -> Floats:
    """(n_s, 3) the source's vertices in the target's shape."""
    with portion(0, TURNED_ROUND):
        turned = reverse_match(result, source, target)
    with portion(TURNED_ROUND, 1):
        return wrap(turned, target, source).vertices


def carry(
    body: Surface,
    shape: Floats,
    skin: Surface,
    carried: Sequence[Carried],
    *,
    manners: Sequence[Manner] | None = None,
    stiffness: float = 0.5,
    gap: float = 0.0,
) -> Dressed:
    """Fit worn objects to a body whose vertices take another shape (n, 3), see `dress`.

    The skin is the surface, in the new shape, that objects must not enter. The gap is in the unit of the shape.

    Raises:
        ValueError: a number is out of its range, or there is not a manner for each.
    """
    _check(carried, manners, stiffness, gap)
    how: Sequence[Manner] = ["automatic"] * len(carried) if manners is None else manners
    fits, stuck = list[_Fit](), 0
    found: dict[int, tuple[Floats, Floats, Booleans]] = {}
    with stage("Dressing"):
        following = Following(body, shape)
        advance(0.1)
        barriers = [Barrier(SidedSurface.of(body, following.unit), SidedSurface.of(skin, following.unit_after))]
        advance(0.2)
        for number, (each, manner) in enumerate(zip(carried, how, strict=True), start=1):
            fits.append(_Fit.of(Form.of(each, following.unit), following, manner, stiffness))
            advance(0.2 + 0.3 * number / len(carried))
        margins = margins_with(gap / following.unit_after)
        # From the skin outwards: each layer is a barrier for those above it.
        order = sorted(range(len(fits)), key=lambda number: float(np.median(fits[number].motion.distance)))
        for done, number in enumerate(order, start=1):
            fit = fits[number]
            positions, wrong = fit.push_out(barriers, margins)
            stuck += wrong
            found[number] = fit.of_vertices(positions, following)
            if done < len(order) and fit.is_layer:
                triangles = fit.facing_away(barriers[0].before)
                before, after = (SidedSurface(places, triangles) for places in (fit.form.rest, positions))
                barriers.append(Barrier(before, after, is_layer=True))
            advance(0.5 + 0.5 * done / len(order))
    vertices, turns, stretched = zip(*(found[number] for number in range(len(fits))), strict=True)
    notes = (warning("{count:,} points still intersect the skin: check these.", count=stuck),) if stuck else ()
    return Dressed(vertices, turns, stretched, notes)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A form moved with the body."""

    form: Form  # the worn object
    motion: Motion  # the motion of its points with the body
    positions: Floats  # (n, 3) its current positions
    parts: list[Integers]  # points of its solid parts
    is_rigid: bool  # whether it is one solid part as a whole

    @classmethod
    def of(cls, form: Form, following: Following, manner: Manner, stiffness: float) -> _Fit:
        motion = following.motion(form.rest)
        if manner == "rigid":
            moved = procrustes(form.rest, motion.images, form.areas)(form.rest)
            return cls(form, motion, moved, [], True)
        # Near the positions moved by the body, with the rest edges rotated and scaled.
        length = DRESS.softest * (DRESS.stiffest / DRESS.softest) ** stiffness
        pull = form.areas / (1 + (motion.distance / DRESS.near) ** 2)
        gradients = (turn_gradients(form.stiffness, motion.turns) @ form.rest.ravel()).reshape(-1, 3)
        moved = ScreenedSmoothing.of(pull, form.stiffness, length).fit(motion.images, gradients)
        return cls(form, motion, moved, solid_parts(form) if manner == "automatic" else [], False)

    @property
    def is_layer(self) -> bool:
        """Whether it is a barrier for other objects."""
        return not self.is_rigid and len(self.form.triangles) > 0 and len(self.soft) > len(self.form.rest) / 2

    @property
    def soft(self) -> Integers:
        """Points that belong to no solid part."""
        return np.setdiff1d(np.arange(len(self.form.rest)), np.concatenate([[], *self.parts]))

    def facing_away(self, skin: SidedSurface) -> Integers:
        """(m, 3) its triangles, wound so that each connected component faces away from the skin."""
        corners, first = self.form.triangles.copy(), self.form.triangles[:, 0]
        middles = self.form.rest[corners].mean(axis=1)
        facing = np.einsum("mx,mx->m", area_normals(self.form.rest, corners), skin.sides(middles)[1])
        inward = (np.bincount(self.form.component[first], facing) < 0)[self.form.component[first]]
        corners[inward] = corners[inward, ::-1]
        return corners

    def push_out(self, barriers: Sequence[Barrier], margins: Margins) -> tuple[Floats, int]:
        """(n, 3) positions out of the skin, and how many places are still in it."""
        if self.is_rigid:
            return push_out_rigidly(self.form, self.positions, self.motion.growth, barriers, margins)
        soft = self.soft
        positions, wrong = push_out(self.form, self.positions, self.motion.growth, barriers, margins, soft)
        return with_solid_parts(self.form, self.parts, soft, self.motion.images, positions), wrong

    def of_vertices(self, positions: Floats, following: Following) -> tuple[Floats, Floats, Booleans]:
        """(n_v, 3) positions and (n_v, 3, 3) turns of the vertices, in units of the shape and of the body.

        And (n_v,) which of them are stretched. Unconnected vertices only follow the body.
        """
        number = self.form.number
        found, turns, alone = positions[number], self.motion.turns[number], np.flatnonzero(number < 0)
        stretched = _stretched_points(self.form, self.motion, positions)[number] & (number >= 0)
        if len(alone):
            motion = following.motion(self.form.places[alone])
            found[alone], turns[alone] = motion.images, motion.turns
        return following.unit_after * found, following.unit_after / following.unit * turns, stretched


def _stretched_points(form: Form, motion: Motion, positions: Floats) -> Booleans:
    """(n,) points at edges that grow far more than the body does there."""
    edges, _ = unique_edges(form.triangles)
    before, after = (np.linalg.norm(each[edges[:, 0]] - each[edges[:, 1]], axis=1) for each in (form.rest, positions))
    allowed = STRETCHED * np.maximum(motion.growth[edges].max(axis=1), 1) * before
    return np.isin(np.arange(len(form.rest)), edges[(after > allowed) & (after > MIN_LENGTH)])


def _check(carried: Sequence[Carried], manners: Sequence[Manner] | None, stiffness: float, gap: float) -> None:
    if not len(carried):
        raise ValueError("There is nothing to fit: give at least one surface or set of lines.")
    if manners is not None and (len(manners) != len(carried) or not set(manners) <= set(get_args(Manner))):
        known = ", ".join(repr(each) for each in get_args(Manner))
        raise ValueError(f"manners are {list(manners)!r}: give one of {known} for each of the {len(carried)} objects.")
    if not 0 <= stiffness <= 1:
        raise ValueError(f"stiffness is {stiffness!r}: give a number from 0 to 1.")
    if not gap >= 0:
        raise ValueError(f"gap is {gap!r}: give a distance of zero or more.")
