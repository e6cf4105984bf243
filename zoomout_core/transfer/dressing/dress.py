# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress: fit the objects that a source wears (clothes, hair, eyes, teeth, props) to the body of a target.

The source's body takes the target's shape along the match, and the space around it moves along, with the worn objects.
Soft objects keep their form according to their stiffness, and solid ones rotate and scale as a whole. Nothing that was
outside the skin is pushed into it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array, csc_array, csr_array, diags_array

from zoomout_core.arrays import Booleans, Floats, Integers, check_fractions
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.shapes import as_placed_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import area_normals, unique_edges
from zoomout_core.messages import plural_warning
from zoomout_core.runtime.option_names import suggest_names
from zoomout_core.runtime.progress import Progress, advance, listening, portion, stage
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.transfer.dressing.contact import (
    Barrier,
    Bounds,
    Contact,
    Margins,
    SidedSurface,
    margins_with,
    push_out_rigidly,
)
from zoomout_core.transfer.dressing.following import Following, Motion
from zoomout_core.transfer.dressing.form import Form, Lines, place_worn, read_masks
from zoomout_core.transfer.dressing.hair import hang
from zoomout_core.transfer.dressing.kept_parts import KeptParts
from zoomout_core.transfer.dressing.posed_contact import POSED_CONTACT, PosedBody, PosedBounds
from zoomout_core.transfer.dressing.solid_parts import solid_parts, touching_points, with_solid_parts
from zoomout_core.transfer.frames import turn_gradients
from zoomout_core.transfer.rules import Match
from zoomout_core.transfer.wrapping.wrap import reverse_match, wrap
from zoomout_core.tuning import Tuning, tuned

# Ways to fit objects: soft ones keep their form according to their stiffness, rigid ones rotate and scale as a whole.
# "automatic" is soft, except for small solid parts. "hair" is automatic, but moves as a whole where it hangs freely.
Manner: TypeAlias = Literal["automatic", "soft", "rigid", "hair"]
Carried: TypeAlias = Surface | Lines
# The motion of a body by its bones, and the weights (n, b) of an object that the same bones move.
Posed: TypeAlias = tuple[PosedBody, csr_array]
# Fractions of the progress: inverting the match, as a share of shaping the body, and shaping the body, of the whole.
TURNED_ROUND, SHAPED = 0.5, 0.8
# Stiffness of a link between touching points: that of an edge between equilateral triangles. It is doubled if each of
# the two is among the nearest points of the other.
LINK = 3**-0.5
# An edge is reported as stretched if it grows by more than the first multiple of the body's growth there, and is longer
# than the second number, at unit area. Shorter ones are hardly visible.
STRETCHED, MIN_LENGTH = 2.0, 0.01

# Notes on points that are left inside the skin.
STUCK = "1 point still intersects the skin: check it.", "{count:,} points still intersect the skin: check these."


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


@dataclass(frozen=True, eq=False)
class Dressed:
    """The objects fitted to a target.

    Attributes:
        vertices: for each object (n, 3) positions of its vertices, in the target's frame and unit.
        turns: for each object (n, 3, 3) matrices that transform small differences of positions from the source to the
            target.
        stretched: for each object (n,) vertices at edges that are stretched much more than the body.
        notes: sentences for the user.
        outfit: the state of the fit, which `clear_in_poses` continues.

    Example:
        >>> dressed = zo.dress(result, source, target, [source])
        >>> dressed.vertices[0].shape == source.vertices.shape
        True
    """

    vertices: tuple[Floats, ...]
    turns: tuple[Floats, ...]
    stretched: tuple[Booleans, ...]
    notes: tuple[str, ...]
    outfit: Outfit | None = field(default=None, repr=False)


@suggest_names
@memory_in_words
@on_one_blas_thread
def dress(
    result: Match | SurfaceMap,
    source: Surface,
    target: Surface,
    carried: Sequence[Carried],
    *,
    manners: Sequence[Manner] | None = None,
    keep: Sequence[ArrayLike | None] | None = None,
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
        manners: how to fit each; "automatic" if omitted. All "hair" moves as one.
        keep: for each object weights (n,) in [0, 1] of vertices that keep their form, such as those of buckles, plates
            and soles, or None. Each connected patch moves as a whole, with the object's scale.
        stiffness: stiffness of soft objects, from 0, where they follow every detail of the body, to 1.
        gap: minimum distance from the skin, in the target's unit, of everything that was outside it.
        progress: called with the `Progress`, see `zoomout_core.progress`.

    Raises:
        MeshError: the map is of other surfaces, or nothing corresponds.
        ValueError: a number is out of its range, or the number of manners or masks does not match the objects.

    Example:
        >>> dressed = zo.dress(result, source, target, [source])
        >>> len(dressed.vertices)
        1
    """
    _check(carried, manners, stiffness, gap)
    read_masks(carried, keep)
    source, target = as_placed_surface(source), as_placed_surface(target)
    with listening(progress):
        with portion(0, SHAPED):
            shape = shape_of_source(result, source, target)
        with portion(SHAPED, 1):
            return carry(source, shape, target, carried, manners=manners, keep=keep, stiffness=stiffness, gap=gap)


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
    keep: Sequence[ArrayLike | None] | None = None,
    stiffness: float = 0.5,
    gap: float = 0.0,
) -> Dressed:
    """Fit worn objects to a body whose vertices take another shape (n, 3), see `dress`.

    The skin is the surface, in the new shape, that objects must not enter. The gap is in the unit of the shape.

    Raises:
        ValueError: a number is out of its range, or the number of manners or masks does not match the objects.
    """
    _check(carried, manners, stiffness, gap)
    how: Sequence[Manner] = ["automatic"] * len(carried) if manners is None else manners
    masks, carried = read_masks(carried, keep), place_worn(carried)
    fits = list[_Fit]()
    with stage("Dressing"):
        following = Following(body, shape)
        advance(0.1)
        barrier = Barrier(SidedSurface.of(body, following.unit), SidedSurface.of(skin, following.unit_after))
        advance(0.2)
        forms = [Form.of(each, following.unit, mask) for each, mask in zip(carried, masks, strict=True)]
        motions = [following.motion(form.rest) for form in forms]
        hair = [number for number, manner in enumerate(how) if manner == "hair"]
        hanging = hang([forms[number] for number in hair], [motions[number] for number in hair])
        for number, motion in zip(hair, hanging, strict=True):
            motions[number] = motion
        for number, (form, motion, manner) in enumerate(zip(forms, motions, how, strict=True), start=1):
            fits.append(_Fit.of(form, motion, manner, stiffness))
            advance(0.2 + 0.3 * number / len(carried))
        outfit = Outfit(fits, following, barrier, margins_with(gap / following.unit_after))
        with portion(0.5, 1):
            return outfit.push_out()


def clear_in_poses(dressed: Dressed, body: PosedBody, weights: Sequence[csr_array | None]) -> Dressed:
    """Displace fitted objects a little, so that they also stay outside the skin in poses.

    Args:
        dressed: the fitted objects, by `carry`.
        body: the motion of the body that they were fitted to, in its unit.
        weights: for each object (n, b) its weights, whose rows sum to one; None if it is not displaced.
    """
    assert dressed.outfit is not None
    unit = dressed.outfit.following.unit_after
    scaled = body._replace(poses=body.poses * np.array([1, 1, 1, 1 / unit]))
    return dressed.outfit.push_out([None if each is None else (scaled, each) for each in weights])


@dataclass(eq=False)
class Outfit:
    """Objects during their fit.

    Attributes:
        fits: the objects.
        following: the motion of the space around the body.
        skin: the body, as a barrier.
        margins: the bounds of the distance from the skin that is kept.
        layers: their layers, from the skin outwards: each is a barrier for those above it.
    """

    fits: list[_Fit]
    following: Following
    skin: Barrier
    margins: Margins
    layers: list[_Layer] = field(init=False)

    def __post_init__(self) -> None:
        every = (layer for fit in self.fits for layer in fit.layers())
        self.layers = sorted(every, key=lambda layer: layer.height)

    def push_out(self, posed: Sequence[Posed | None] = ()) -> Dressed:
        """Push each layer out of the skin and the layers below it, also in poses if these are given."""
        stuck, barriers = 0, [self.skin]
        poses_of = dict(zip(self.fits, posed, strict=False))
        with stage("Dressing"):
            for done, layer in enumerate(self.layers, start=1):
                stuck += layer.push_out(barriers, self.margins, poses_of.get(layer.fit))
                if done < len(self.layers) and layer.is_barrier:
                    barriers.append(layer.as_barrier(barriers[0].before))
                advance(done / len(self.layers))
        found = [fit.of_vertices(self.following) for fit in self.fits]
        vertices, turns, stretched = zip(*found, strict=True)
        notes = (plural_warning(stuck, *STUCK),) if stuck else ()
        return Dressed(vertices, turns, stretched, notes, self)


@dataclass(eq=False)
class _Fit:
    """A form moved with the body."""

    form: Form  # the worn object
    motion: Motion  # the motion of its points with the body
    positions: Floats  # (n, 3) its current positions
    parts: list[Integers]  # points of its solid parts
    is_rigid: bool  # whether it is one solid part as a whole

    @classmethod
    def of(cls, form: Form, motion: Motion, manner: Manner, stiffness: float) -> _Fit:
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

    def layers(self) -> list[_Layer]:
        """Its large connected parts, such as a jacket and a belt, and the rest. A rigid form is one layer."""
        if self.is_rigid:
            return [_Layer(self, np.arange(len(self.form.rest)))]
        soft = self.soft
        component = self.form.component[soft]
        area = np.bincount(component, self.form.areas[soft]) if len(self.form.triangles) else np.zeros(0)
        large = np.flatnonzero(area >= DRESS.layer)
        parts = [soft[component == number] for number in large] + [soft[~np.isin(component, large)]]
        return [_Layer(self, points) for points in parts if len(points)]

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


@dataclass(eq=False)
class _Layer:
    """A part of a fit that is kept above the skin and the layers below it."""

    fit: _Fit  # the object
    points: Integers  # numbers of its points
    contact: Contact | None = None  # its contact with these before the change of shape, once computed

    @property
    def height(self) -> float:
        """The median distance from the skin."""
        return float(np.median(self.fit.motion.distance[self.points]))

    @property
    def is_barrier(self) -> bool:
        """Whether it is a barrier for the layers above it."""
        fit = self.fit
        is_soft = not fit.is_rigid and 2 * len(fit.soft) > len(fit.form.rest)
        return is_soft and len(fit.form.between(self.points)) > 0

    def push_out(self, barriers: Sequence[Barrier], margins: Margins, posed: Posed | None = None) -> int:
        """Push it out of barriers that it was outside of. Returns the number of places that are still in the skin."""
        fit, form = self.fit, self.fit.form
        if fit.is_rigid:
            fit.positions, stuck = push_out_rigidly(form, fit.positions, fit.motion.growth, barriers, margins)
        else:
            if self.contact is None:
                self.contact = Contact(form, fit.positions, barriers, self.points)
            contact, after = self.contact, [barrier.after for barrier in barriers]
            growth, more, spread = fit.motion.growth, list[Bounds](), None
            if posed is not None:
                body, weights = posed
                of_places = csr_array(contact.probes @ csr_array(weights)[form.first])
                more.append(PosedBounds(contact.probes @ fit.positions, of_places, after[0], body))
                spread = POSED_CONTACT.spread
            fit.positions, stuck = contact.push_out(fit.positions, growth, after, margins, more=more, spread=spread)
        return stuck

    def as_barrier(self, skin: SidedSurface) -> Barrier:
        """Its surface, oriented so that each connected component faces away from the skin."""
        form = self.fit.form
        corners = form.between(self.points)
        first, middles = corners[:, 0], form.rest[corners].mean(axis=1)
        facing = np.einsum("mx,mx->m", area_normals(form.rest, corners), skin.sides(middles)[1])
        inward = (np.bincount(form.component[first], facing) < 0)[form.component[first]]
        corners[inward] = corners[inward, ::-1]
        before, after = (SidedSurface(places, corners, is_part=True) for places in (form.rest, self.fit.positions))
        return Barrier(before, after, is_layer=True)


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


def _check(carried: Sequence[Carried], manners: Sequence[Manner] | None, stiffness: float, gap: float) -> None:
    if not (isinstance(carried, Sequence) and all(isinstance(each, Surface | Lines) for each in carried)):
        raise TypeError("The clothes must be a list of surfaces or lines.")
    if not len(carried):
        raise ValueError("There is nothing to fit: give at least one surface or set of lines.")
    if manners is not None and (len(manners) != len(carried) or not set(manners) <= set(get_args(Manner))):
        known = ", ".join(repr(each) for each in get_args(Manner))
        raise ValueError(f"manners are {list(manners)!r}: give one of {known} for each of the {len(carried)} objects.")
    check_fit(stiffness, gap)


def check_fit(stiffness: float, gap: float) -> None:
    """Raise a ValueError unless these numbers can describe a fit, see `dress`."""
    check_fractions(stiffness=stiffness)
    if not (isinstance(gap, Real) and 0 <= gap < math.inf):
        raise ValueError(f"gap is {gap!r}: give a distance of zero or more.")
