# SPDX-License-Identifier: GPL-3.0-or-later
"""Keys of worn objects that follow the shape keys of the body.

Cloth on the skin moves like the skin below it. A place farther away moves like the mean of a wider patch of skin, which
local changes of shape hardly affect: a skirt keeps its shape when the thighs grow, and rises with the hips. Where the
skin would come through, cloth is pushed out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats, to_floats
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.shapes import as_placed_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.progress import Progress, advance, listening, stage
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.transfer.dressing.barriers import CONTACT, Barrier, SidedSurface
from zoomout_core.transfer.dressing.contact import Contact
from zoomout_core.transfer.dressing.form import Form, Lines, place_worn, read_masks
from zoomout_core.transfer.dressing.kept_parts import KeptParts
from zoomout_core.transfer.dressing.patches import Patches
from zoomout_core.transfer.keys.shape_keys import without_noise
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class BodyKeyTuning(Tuning, set_by="outfits"):
    """The width of the patch of skin whose key moves a place.

    Attributes:
        nearest: standard deviation of the weights of a patch near the skin.
        close: distance from the skin up to which patches have this width.
        spreading: growth of the standard deviation beyond it, as a share of the distance.
    """

    nearest: float = tuned(0.004, "at unit area", 1e-6, 1)
    close: float = tuned(0.012, "at unit area", 0, 1)
    spreading: float = tuned(1.5, "1", 0, 100)


BODY_KEYS = BodyKeyTuning()


@memory_in_words
@on_one_blas_thread
def follow_keys(
    body: Surface,
    offsets: ArrayLike,
    worn: Sequence[Surface | Lines],
    *,
    keep: Sequence[ArrayLike | None] | None = None,
    progress: Callable[[Progress], object] | None = None,
) -> tuple[Floats, ...]:
    """Offsets that make worn objects follow the shape keys of the body that wears them.

    With a key at 1, vertices that were outside the skin are still outside it. Vertices that a key does not move visibly
    stay exactly in place.

    Args:
        body: the body, at rest, without the objects.
        offsets: (n, keys, 3) offsets of its vertices.
        worn: the objects on the body, surfaces and lines.
        keep: for each object weights (n,) in [0, 1] of vertices that keep their form, or None, see `dress`.
        progress: called with the `Progress`, see `zoomout_core.progress`.

    Returns:
        For each object (n, keys, 3) offsets of its vertices.

    Raises:
        ValueError: the offsets have another shape, or are not finite; or a mask has another shape.

    Example:
        >>> wider = 0.1 * source.vertices[:, None] * [1, 0, 1]
        >>> (of_cloth,) = zo.follow_keys(source, wider, [source])
        >>> of_cloth.shape == wider.shape
        True
    """
    keys, unit = to_floats(offsets, "Offsets"), float(np.sqrt(body.area))
    if keys.ndim != 3 or keys.shape[::2] != body.vertices.shape or not np.isfinite(keys).all():
        raise ValueError(
            f"offsets are of the shape {keys.shape}, or not finite: give finite ones ({len(body.vertices)}, keys, 3)."
        )
    masks, worn, body = read_masks(worn, keep), place_worn(worn), as_placed_surface(body)
    followed = list[Floats]()
    with listening(progress), stage("Following the keys"):
        patches = Patches(body.vertices / unit, body.triangles)
        skin = SidedSurface.of(body, unit)
        keyed = [skin.with_vertices((body.vertices + offsets) / unit) for offsets in keys.transpose(1, 0, 2)]
        for number, (each, mask) in enumerate(zip(worn, masks, strict=True)):
            advance(number / len(worn))
            form = Form.of(each, unit, mask)
            offsets = without_noise(_keep_parts(form, _follow(patches, form.places, keys), unit), body.area)
            followed.append(offsets + unit * _pushes(form, offsets / unit, skin, keyed))
    return tuple(followed)


def _follow(patches: Patches, places: Floats, keys: Floats) -> Floats:
    """(q, keys, 3) mean offsets of the patches of skin around places (q, 3), from those (n, keys, 3) of the skin."""
    means = means_of_skin(patches, places)
    return np.asarray(means @ keys.reshape(len(keys), -1)).reshape(len(places), *keys.shape[1:])


def means_of_skin(patches: Patches, places: Floats) -> csr_array:
    """(q, n) matrix of the means of values of the skin's vertices over the patches that move places (q, 3)."""
    apart = np.maximum(patches.distances(places) - BODY_KEYS.close, 0)
    return patches.means(places, BODY_KEYS.nearest + BODY_KEYS.spreading * apart)


def _keep_parts(form: Form, offsets: Floats, unit: float) -> Floats:
    """Offsets (n_v, keys, 3) with parts that keep their form."""
    kept = KeptParts.of(form)
    if not kept.count or not offsets.size:
        return offsets
    of_points, points = offsets[form.first] / unit, kept.points
    rigid = np.stack(
        [kept.fit_rigidly(form, form.rest + each)[0] - form.rest[points] for each in of_points.transpose(1, 0, 2)],
        axis=1,
    )
    missing = (rigid - of_points[points]).reshape(len(points), -1)
    changes = unit * kept.displace(form, missing, form.areas, CONTACT.spread).reshape(of_points.shape)
    return offsets + np.where((form.number >= 0)[:, None, None], changes[form.number], 0.0)


def _pushes(form: Form, offsets: Floats, skin: SidedSurface, keyed: Sequence[SidedSurface]) -> Floats:
    """(n_v, keys, 3) pushes out of the skin for the vertices of a form with offsets (n_v, keys, 3), at unit area."""
    number, first, pushes = form.number, form.first, np.zeros_like(offsets)
    moves = np.linalg.norm(offsets[first], axis=2) > CONTACT.settled
    if not moves.any():
        return pushes
    contact = Contact(form, form.rest, [Barrier(skin, skin)], np.flatnonzero(moves.any(axis=1)))
    # A place need not be farther from the skin than without the key.
    margins, growth = (-np.inf, CONTACT.min_margin), np.ones(len(form.rest))
    for key in np.flatnonzero(moves.any(axis=0)):
        moved = form.rest + offsets[first, key]
        pushed, _ = contact.push_out(moved, growth, [keyed[key]], margins, moves[:, key])
        pushes[:, key] = np.where((number >= 0)[:, None], (pushed - moved)[number], 0.0)
    return pushes
