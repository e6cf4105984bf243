# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the target of a match is a mirror image of its source, such as a left bone beside a right one.

A match prefers maps that keep the orientation, so a left bone is mapped to a right one in a wrong way that fits about
as well along the surface. A jaw, for example, is flat, and its inner face is mapped to the outer one. The deformation
of space along that map is far from smooth, however, and that along the mirror image is smooth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zoomout_core.geometry.thin_plate import ThinPlateFit
from zoomout_core.matching.registration.smooth_warp import (
    ROUGH_WARP,
    Correspondences,
    Samples,
    outward_normals,
    warp,
)
from zoomout_core.matching.result import MatchResult, check_result
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class MirrorTuning(Tuning, set_by="specimens"):
    """When a shape is taken for a mirror image.

    Attributes:
        ratio: smallest ratio of the bending energies of the warps along the map and along a mirrored one. It is 6 to 14
            for mirror images, up to 1.3 for shapes that are symmetric, and at most 0.7 for others.
        smooth: largest median distance between the warp along the mirrored map and that map, which is coarse.
    """

    ratio: float = tuned(2.5, "1", 1, 1000)
    smooth: float = tuned(0.05, "at unit area", 0, 1)


MIRROR = MirrorTuning()


@on_one_blas_thread
def mirror_candidate(result: MatchResult) -> int | None:
    """The candidate to use if the target is a mirror image of the source, such as a left bone beside a right one.

    None if it is not, if the shapes are their own mirror images, or if the result is of a mirrored candidate already.

    Raises:
        TypeError: it is not a result of `match`.

    Example:
        >>> mirrored = zo.mirror_candidate(result)
        >>> if mirrored is not None:
        ...     result = result.use(mirrored)
    """
    check_result(result)
    if _first_mirror_image(result) is None:
        return None
    here, there = (Samples.of(mesh, outward_normals(mesh)) for mesh in (result.source.working, result.target.working))
    return smoother_mirror_image(result, here, there, warp_back(here, there, Correspondences.of(result)))


def warp_back(here: Samples, there: Samples, known: Correspondences) -> ThinPlateFit:
    """The target warped roughly onto the source.

    Args:
        here: samples of the source.
        there: samples of the target.
        known: correspondences from the source to the target.
    """
    return warp(there.thin(ROUGH_WARP.points), here.thin(ROUGH_WARP.points), known.swap(), ROUGH_WARP).fit


def smoother_mirror_image(result: MatchResult, here: Samples, there: Samples, back: ThinPlateFit) -> int | None:
    """`mirror_candidate` for samples of source and target, and the warp back along the result."""
    number = _first_mirror_image(result)
    if number is None:
        return None
    mirrored = Correspondences.of_candidate(result, number)
    fit = warp_back(here, there, mirrored)
    smooth = np.median(mirrored.swap().distances(fit)) <= MIRROR.smooth
    return number if smooth and back.bending_energy > MIRROR.ratio * fit.bending_energy else None


def _first_mirror_image(result: MatchResult) -> int | None:
    """The first mirrored candidate, if the result is not of a mirrored one."""
    if result.candidates[result.chosen].reverses_orientation:
        return None
    return next((i for i, one in enumerate(result.candidates) if one.reverses_orientation), None)
