# SPDX-License-Identifier: GPL-3.0-or-later
"""Adapt the skin weights of worn objects to another body: they change like the weights of the skin below.

A match may slide along limbs, and two armatures have different joints. Cloth that keeps its weights then bends beside
the knee, and the skin comes through in poses. Cloth close to the skin, such as a cuff, gets the weights of the skin
below it, because even small differences push it into the skin. Cloth that moved differently from the skin before, such
as a stiff collar or a skirt with its own bones, still does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, diags_array

from zoomout_core.arrays import Floats
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.maps.surface_map import interpolation_matrix
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import vertex_normals
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.transfer.dressing.body_keys import means_of_skin
from zoomout_core.transfer.dressing.form import Form, Lines, read_masks
from zoomout_core.transfer.dressing.patches import Patches
from zoomout_core.transfer.inpaint import MIN_WEIGHT
from zoomout_core.transfer.rigging.weights import limit_weights
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class BodyWeightTuning(Tuning, set_by="outfits"):
    """How smoothly weights change, and which places move with the skin.

    Attributes:
        smooth: length over which the change of the skin's weights is averaged.
        facing: the distance equivalent to a unit difference of normals when skins are compared.
        agreement: share of the weights in common with the skin below from which a place moves with it.
        close: distance from the skin up to which a place that moves with it gets its weights. From twice this distance,
            it keeps its own difference.
    """

    smooth: float = tuned(0.02, "at unit area", 1e-6, 1)
    facing: float = tuned(0.05, "at unit area", 1e-6, 10)
    agreement: float = tuned(0.5, "1", 1e-6, 1)
    close: float = tuned(0.01, "at unit area", 1e-6, 1)


BODY_WEIGHTS = BodyWeightTuning()
# Columns of weights that are smoothed together; bounds the memory.
COLUMNS = 32
# Bones per vertex that every format and engine supports. Objects and bodies with fewer may get this number.
BONES = 4
# Skin below cloth may have this multiple of the weight that the same skin has of a bone. Near joints, where a shape
# slides a little, weights differ by less; those of a touching limb differ by more.
MORE = 4.0


class WeightedBody(NamedTuple):
    """A body at rest with its skin weights, normalised."""

    surface: Surface
    weights: csr_array  # (n, b)


@memory_in_words
@on_one_blas_thread
def follow_weights(
    before: WeightedBody,
    after: WeightedBody,
    worn: Sequence[Surface | Lines],
    fitted: Sequence[Floats],
    weights: Sequence[csr_array],
    keep: Sequence[Floats | None] | None = None,
    shape: Floats | None = None,
) -> tuple[csr_array, ...]:
    """Change the weights of worn objects like the weights of the skin below them, from one body to another.

    An object follows to the degree to which its weights agree with the skin's on the first body. A braid that is bound
    to the head keeps its weights. Where an object that moves with the skin is close to it, it gets the skin's weights.

    Args:
        before: the body that wore the objects.
        after: the body that they were fitted to.
        worn: the objects on the first body.
        fitted: for each (n, 3) its vertices on the second one.
        weights: for each (n, b) its weights, of the same bones as those of both bodies.
        keep: for each object weights (n,) in [0, 1] of vertices that keep their form, or None, see `dress`. These also
            keep their skin weights, so that they stay stiff in poses.
        shape: (m, 3) vertices of the first body in the shape of the second one, see `shape_of_source`. Cloth between
            limbs that touch on the second body then follows the limb that it was on.

    Returns:
        For each (n, b) its weights, with the same sums.
    """
    skins = [_Skin.of(body) for body in (before, after)]
    same_skin = None if shape is None else skins[0]._replace(weights=_weights_in_shape(before.surface, shape, after))
    limit = int(np.diff(after.weights.indptr).max(initial=BONES))
    found = []
    masks = read_masks(worn, keep)
    for thing, moved, given, mask in zip(worn, fitted, weights, masks, strict=True):
        below = [skin.weights_below(points) for skin, points in zip(skins, (thing.vertices, moved), strict=True)]
        if same_skin is not None:
            below[1] = _clip(below[1], same_skin.weights_below(thing.vertices))
        change = _change(normalise(given), below[0], below[1], skins[1].distances(moved))
        smoothed = _smooth(Form.of(thing, skins[0].unit), change)
        changed = _add(given, smoothed if mask is None else csr_array(diags_array(1 - mask) @ smoothed))
        if isinstance(thing, Surface):
            most = int(np.diff(given.indptr).max(initial=limit))
            limit_weights(changed, thing, np.ones(given.shape[1], dtype=bool), most)
        found.append(changed)
    return tuple(found)


def moving_with_skin(
    body: WeightedBody, worn: Sequence[Surface | Lines], weights: Sequence[csr_array | None]
) -> list[Floats | None]:
    """The degree, in [0, 1], to which each vertex of worn objects moves with the skin below it as bones rotate.

    It is 1 if they have `BodyWeightTuning.agreement` of their weights in common: cloth near a joint often has
    smoother weights than the skin. It is 0 for the front of a skirt that is bound to the hips alone.

    Args:
        body: the body that wears the objects, at rest.
        worn: the objects.
        weights: for each (n, b) its weights, of the same bones as those of the body, or None.

    Returns:
        For each object (n,) degrees, or None without weights.
    """
    skin = _Skin.of(body)
    return [
        None if given is None else _moving(_agreement(given, skin.weights_below(each.vertices)))
        for each, given in zip(worn, weights, strict=True)
    ]


class _Skin(NamedTuple):
    """A body, sampled for weights of the skin below places."""

    patches: Patches
    unit: float  # length of the unit of the patches
    weights: csr_array  # (n, b) normalised

    @classmethod
    def of(cls, body: WeightedBody) -> _Skin:
        unit = float(np.sqrt(body.surface.area))
        return cls(Patches(body.surface.vertices / unit, body.surface.triangles), unit, normalise(body.weights))

    def weights_below(self, places: Floats) -> csr_array:
        """(q, b) mean weights of the skin below places (q, 3)."""
        return csr_array(means_of_skin(self.patches, places / self.unit) @ self.weights)

    def distances(self, places: Floats) -> Floats:
        """(q,) distances of places (q, 3) from the skin, at unit area."""
        return self.patches.distances(places / self.unit)


def _weights_in_shape(body: Surface, shape: Floats, other: WeightedBody) -> csr_array:
    """(n, b) weights that another body has where the skin of a body is in its shape (n, 3)."""
    skin, unit = other.surface, float(np.sqrt(other.surface.area))
    outwards = np.zeros(len(skin.triangles), dtype=bool)
    surface = OrientedSurface(skin.vertices, skin.triangles, outwards, BODY_WEIGHTS.facing * unit)
    triangle, barycentric, _ = surface.closest(shape, vertex_normals(shape, body.triangles))
    nearest = interpolation_matrix(skin.triangles[triangle], barycentric, len(skin.vertices))
    return normalise(csr_array(nearest @ other.weights))


def _clip(below: csr_array, same: csr_array) -> csr_array:
    """Weights (n, b) of the skin below, bounded by multiples of those of the same skin (n, b); otherwise the latter."""
    kept = normalise(csr_array(below.minimum(MORE * same)))
    has_none = np.asarray(kept.sum(axis=1)).ravel() == 0
    return csr_array(kept + diags_array(has_none.astype(np.float64)) @ same)


def _change(weights: csr_array, before: csr_array, after: csr_array, distance: Floats) -> csr_array:
    """(n, b) change of normalised weights (n, b) of places at distances (n,) from the other body.

    Args:
        weights: those of the places.
        before: (n, b) those of the skin below them on the first body.
        after: (n, b) the same on the other body.
        distance: (n,) distances from the skin of the other body.
    """
    agreement = _agreement(weights, before)
    close = _moving(agreement) * np.clip(2 - distance / BODY_WEIGHTS.close, 0, 1)
    alike = diags_array((1 - close) * agreement) @ (after - before)
    return csr_array(alike + diags_array(close) @ (after - weights))


def _moving(agreement: Floats) -> Floats:
    """(n,) the degree to which places move with the skin, by their agreement (n,) with it."""
    return np.minimum(agreement / BODY_WEIGHTS.agreement, 1)


def _agreement(weights: csr_array, below: csr_array) -> Floats:
    """(n,) the share of weights (n, b) that vertices have in common with the skin below them."""
    return np.asarray(normalise(weights).minimum(below).sum(axis=1), dtype=np.float64).ravel()


def _smooth(form: Form, change: csr_array) -> csr_array:
    """(n_v, b) changes of weights (n_v, b), averaged over a form; those of unconnected vertices are zero."""
    number = form.number
    used = np.flatnonzero(number >= 0)
    columns = np.unique(change.indices)
    smoothing = ScreenedSmoothing.of(form.areas, form.stiffness, BODY_WEIGHTS.smooth)
    smoothed = np.zeros((len(number), len(columns)))
    for start in range(0, len(columns), COLUMNS):
        some = slice(start, start + COLUMNS)
        smoothed[used, some] = smoothing.smooth(change[form.first][:, columns[some]].toarray())[number[used]]
    rows, entries = np.nonzero(np.abs(smoothed) >= MIN_WEIGHT)
    return csr_array((smoothed[rows, entries], (rows, columns[entries])), shape=change.shape)


def _add(weights: csr_array, change: csr_array) -> csr_array:
    """Weights (n, b) with a change added, not negative, and with the same sums as before."""
    added = csr_array(normalise(weights) + change)
    added.data[added.data < MIN_WEIGHT] = 0
    added.eliminate_zeros()
    return csr_array(diags_array(np.asarray(weights.sum(axis=1)).ravel()) @ normalise(added))
