# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers of fitted objects, from the skin outwards, each pushed out of the ones below it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.triangles import area_normals
from zoomout_core.messages import plural_warning
from zoomout_core.runtime.progress import advance, stage
from zoomout_core.transfer.dressing.barriers import Barrier, Bounds, Margins, SidedSurface
from zoomout_core.transfer.dressing.contact import Contact, push_out_rigidly
from zoomout_core.transfer.dressing.fitted_object import DRESS, FittedObject
from zoomout_core.transfer.dressing.following import Following
from zoomout_core.transfer.dressing.posed_contact import POSED_CONTACT, PosedBody, PosedBounds

# The motion of a body by its bones, and the weights (n, b) of an object that the same bones move.
Posed: TypeAlias = tuple[PosedBody, csr_array]

# Notes on points that are left inside the skin.
STUCK = "1 point still intersects the skin: check it.", "{count:,} points still intersect the skin: check these."


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

    fits: list[FittedObject]
    following: Following
    skin: Barrier
    margins: Margins
    layers: list[Layer] = field(init=False)

    def __post_init__(self) -> None:
        self.layers = sorted((layer for fit in self.fits for layer in _layers_of(fit)), key=lambda layer: layer.height)

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
class Layer:
    """A part of a fit that is kept above the skin and the layers below it."""

    fit: FittedObject  # the object
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


def _layers_of(fit: FittedObject) -> list[Layer]:
    """The large connected parts of an object, such as a jacket and a belt, and the rest; one layer if it is rigid."""
    form, soft = fit.form, fit.soft
    if fit.is_rigid:
        return [Layer(fit, np.arange(len(form.rest)))]
    component = form.component[soft]
    area = np.bincount(component, form.areas[soft]) if len(form.triangles) else np.zeros(0)
    large = np.flatnonzero(area >= DRESS.layer)
    parts = [soft[component == number] for number in large] + [soft[~np.isin(component, large)]]
    return [Layer(fit, points) for points in parts if len(points)]
