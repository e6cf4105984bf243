# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion of hair, which hangs from the skin at its roots.

A braid on the back does not grow with the back below it. All hair moves as a whole, by one similarity that its places
near the skin determine. Only these also follow the skin below them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import nearest_rotations, procrustes
from zoomout_core.transfer.dressing.following import Motion
from zoomout_core.transfer.dressing.form import Form
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class HairTuning(Tuning, set_by="outfits"):
    """How far hair follows the skin.

    Attributes:
        near: distance from the skin at which hair follows it half as much.
    """

    near: float = tuned(0.015, "at unit area", 1e-6, 1)


HAIR = HairTuning()


def hang(forms: Sequence[Form], motions: Sequence[Motion]) -> list[Motion]:
    """The motions of pieces of hair that hang together, given the motions of the space around them."""
    if not forms:
        return []
    shares = [1 / (1 + (motion.distance / HAIR.near) ** 2) for motion in motions]
    whole = procrustes(
        np.concatenate([form.rest for form in forms]),
        np.concatenate([motion.images for motion in motions]),
        np.concatenate([share * form.areas for share, form in zip(shares, forms, strict=True)]),
    )
    found = []
    for form, motion, share in zip(forms, motions, shares, strict=True):
        images = _blend(whole(form.rest), motion.images, share[:, None])
        turns = _blend(whole.linear, motion.turns, share[:, None, None])
        growth = _blend(whole.scale, motion.growth, share)
        found.append(Motion(images, growth[:, None, None] * nearest_rotations(turns), motion.distance))
    return found


def _blend(first: Floats, second: Floats, share: Floats) -> Floats:
    """The mean of two arrays, with a share of the second one."""
    return np.asarray((1 - share) * first + share * second)
