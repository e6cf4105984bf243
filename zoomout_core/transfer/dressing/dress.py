# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress: fit the objects that a source wears (clothes, hair, eyes, teeth, props) to the body of a target.

The source's body takes the target's shape along the match, and the space around it moves along, with the worn objects.
Soft objects keep their form according to their stiffness, and solid ones rotate and scale as a whole. Nothing that was
outside the skin is pushed into it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from numbers import Real
from typing import TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats, check_fractions
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.shapes import as_placed_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.option_names import suggest_names
from zoomout_core.runtime.progress import Progress, advance, listening, portion, stage
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.transfer.dressing.barriers import Barrier, SidedSurface, margins_with
from zoomout_core.transfer.dressing.fitted_object import FittedObject, Manner
from zoomout_core.transfer.dressing.following import Following
from zoomout_core.transfer.dressing.form import Form, Lines, place_worn, read_masks
from zoomout_core.transfer.dressing.hair import hang
from zoomout_core.transfer.dressing.layers import Dressed, Outfit
from zoomout_core.transfer.dressing.posed_contact import PosedBody
from zoomout_core.transfer.rules import Match
from zoomout_core.transfer.wrapping.wrap import reverse_match, wrap

Carried: TypeAlias = Surface | Lines
# Fractions of the progress: inverting the match, as a share of shaping the body, and shaping the body, of the whole.
TURNED_ROUND, SHAPED = 0.5, 0.8


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
            return fit_to_shape(
                source, shape, target, carried, manners=manners, keep=keep, stiffness=stiffness, gap=gap
            )


def shape_of_source(result: Match | SurfaceMap, source: Surface, target: Surface) -> Floats:
    """(n_s, 3) the source's vertices in the target's shape."""
    with portion(0, TURNED_ROUND):
        turned = reverse_match(result, source, target)
    with portion(TURNED_ROUND, 1):
        return wrap(turned, target, source).vertices


def fit_to_shape(
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
    fits = list[FittedObject]()
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
            fits.append(FittedObject.of(form, motion, manner, stiffness))
            advance(0.2 + 0.3 * number / len(carried))
        outfit = Outfit(fits, following, barrier, margins_with(gap / following.unit_after))
        with portion(0.5, 1):
            return outfit.push_out()


def clear_in_poses(dressed: Dressed, body: PosedBody, weights: Sequence[csr_array | None]) -> Dressed:
    """Displace fitted objects a little, so that they also stay outside the skin in poses.

    Args:
        dressed: the fitted objects, by `fit_to_shape`.
        body: the motion of the body that they were fitted to, in its unit.
        weights: for each object (n, b) its weights, whose rows sum to one; None if it is not displaced.
    """
    assert dressed.outfit is not None
    unit = dressed.outfit.following.unit_after
    scaled = body._replace(poses=body.poses * np.array([1, 1, 1, 1 / unit]))
    return dressed.outfit.push_out([None if each is None else (scaled, each) for each in weights])


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
