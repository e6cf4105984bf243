# SPDX-License-Identifier: GPL-3.0-or-later
"""Agreement of the mean curvature of a part with that of its images on a whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from zoomout_core.matching.partial.part_registration import RegisteredPart
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.ranking.scores import correlation
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class CurvatureTuning(Tuning, set_by="partial"):
    """How the agreement of curvature counts in the score of a part.

    Both numbers were set on 96 searches: people with missing pieces, cuts, holes, and both cut.
    """

    weight: float = tuned(1.0, "1", 0, 100)  # weight in the score of the log of one minus the correlation
    usual_disagreement: float = tuned(0.35, "1", 1e-3, 2)  # one minus the correlation that leaves the score as it is


PART_CURVATURE = CurvatureTuning()
# Name of the correlation of mean curvature at the vertices of a finished part with that of their images.
CURVATURE = "curvature"
# Differences of curvature smaller than this share are due to the meshing of the same surface.
CURVATURE_FLOOR = 0.01


def curvature_agreement(registered: RegisteredPart, part: ShapeAnalysis, whole: ShapeAnalysis) -> float:
    """Correlation between the mean curvature of a part's vertices and that of their images, in [-1, 1].

    Only the finest scale counts, because all limbs are alike on coarse ones. Vertices beyond a cut have no image.
    """
    areas = np.where(registered.on_cut, 0, part.basis.areas)
    finest = slice(-1, None)
    images = registered.closest.interpolate(whole.vertex_curvature[:, finest])
    return correlation(part.vertex_curvature[:, finest], images, areas / max(areas.sum(), 1e-300))


def curvature_score(scores: Mapping[str, float]) -> float:
    """The contribution of curvature to the total score of a part: lower is better, and 0 if it is unknown."""
    if CURVATURE not in scores:
        return 0.0
    disagreement = max(1 - scores[CURVATURE], 0.0) + CURVATURE_FLOOR
    return PART_CURVATURE.weight * float(np.log(disagreement / PART_CURVATURE.usual_disagreement))
