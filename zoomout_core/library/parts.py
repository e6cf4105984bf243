# SPDX-License-Identifier: GPL-3.0-or-later
"""Find parts of a target, such as its head, that another source fits better than the best source of the whole.

The joints of the best source divide the target into pieces that are nearly rigid in any pose. The fit of a source to a
piece is measured by the error of the similarity that places the piece on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.asset import Asset
from zoomout_core.assets.files import GLTF, read_asset
from zoomout_core.assets.part_names import joints_below
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.geometry.procrustes import Similarities, procrustes
from zoomout_core.library.found import FoundPart, FoundSource
from zoomout_core.matching.result import MatchResult
from zoomout_core.transfer.rigging.poses import parents_first
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class PartTuning(Tuning, set_by="library"):
    """The conditions for proposing another source for a part."""

    min_share: float = tuned(0.03, "of the area", 0, 1)  # smallest part of the target, as a share of its area
    max_share: float = tuned(0.5, "of the area", 0, 1)  # largest part
    piece: int = tuned(20, "vertices of a body", 4, 1000)  # smaller pieces are merged with that of the joint above
    poor: float = tuned(0.005, "at unit area", 0, 1)  # mean error of the best source there; less is noise of bodies
    better: float = tuned(0.55, "1", 0, 1)  # error of the other source, relative to that of the best one


PARTS = PartTuning()

# Rounds of closest points; they converge within about this number.
ROUNDS = 10
# Maximum ratio of a part's size on two sources, relative to their bodies. Without a limit, a wrong map may shrink a
# part to a point, which always fits.
MAX_SCALE = 2.0


def find_part(ranked: Sequence[FoundSource]) -> FoundPart | None:
    """The part of a target that another source fits better, by the largest gain; None if none fits much better.

    Args:
        ranked: the sources, the best first. Its joints define the parts, so it must be a glTF file with a skin.
    """
    fitting = [each for each in ranked if each.fits]
    if len(fitting) < 2 or fitting[0].path.suffix.lower() not in GLTF:
        return None
    asset = read_asset(fitting[0].path)
    if asset.skin is None:
        return None
    best, others = fitting[0].match, fitting[1:]
    assert best is not None
    joint = _main_joint(asset, best)
    piece = _pieces(joint, asset.skin.parents)
    vertices, areas = best.target.vertices, best.target.vertex_areas / best.target.area
    errors = [_errors(each.match, vertices, areas, piece) for each in fitting if each.match is not None]
    found, most = None, 0.0
    for number, name in enumerate(asset.skin.names):
        below = joints_below(asset.skin, np.arange(len(asset.skin.names)) == number)
        inside = below[joint]
        share = float(areas[inside].sum())
        if not PARTS.min_share <= share <= PARTS.max_share:
            continue
        of_best, *of_others = (float(np.sqrt(areas[inside] @ each[inside] / share)) for each in errors)
        other = int(np.argmin(of_others))
        gain = (of_best**2 - of_others[other] ** 2) * share
        if of_best > PARTS.poor and of_others[other] < PARTS.better * of_best and gain > most:
            most = gain
            names = tuple(each for each, is_below in zip(asset.skin.names, below, strict=True) if is_below)
            fits = (1 - each / np.sqrt(share) for each in (of_others[other], of_best))
            found = FoundPart(others[other].path, fitting[0].path, name, names, *fits)
    return found


def _main_joint(asset: Asset, match: MatchResult) -> Integers:
    """(n_t,) the joint that moves each vertex of the target of a match between bodies, from the asset's weights."""
    assert asset.skin is not None
    nearest = np.asarray(cKDTree(asset.surface.vertices).query(match.source.vertices)[1])
    weights = match.surface_map.interpolate(asset.skin.weights[nearest].toarray())
    return np.asarray(weights.argmax(axis=1))


def _pieces(joint: Integers, parents: Integers) -> Integers:
    """(n,) the joint of the nearly rigid piece of each vertex, from the joint that moves it.

    A joint that moves few vertices belongs to the piece of the joint above.
    """
    piece = joint.copy()
    for each in reversed(parents_first(parents)):
        if parents[each] >= 0 and np.count_nonzero(piece == each) < PARTS.piece:
            piece[piece == each] = parents[each]
    return piece


def _errors(match: MatchResult, vertices: Floats, areas: Floats, piece: Integers) -> Floats:
    """(n,) squared distances of vertices (n, 3) from the source, on which a similarity places each piece, at unit area.

    The similarity is first fitted to the images of the piece. Its scale is then fixed, and it is fitted to closest
    points, so that errors of the map along the surface have no effect.

    Args:
        match: the match, of any body of the target.
        vertices: vertices of the target.
        areas: (n,) their areas.
        piece: (n,) the pieces that have a similarity each.
    """
    near = cKDTree(match.target.vertices).query(vertices)[1]
    images = match.surface_map.interpolate(match.source.vertices)[near]
    search = SurfaceSearch(match.source.vertices, match.source.triangles)
    size = float(np.sqrt(match.source.area / match.target.area))
    members = [np.flatnonzero(piece == each) for each in np.unique(piece)]
    scales = [(size / MAX_SCALE, size * MAX_SCALE)] * len(members)
    onto = images
    # One search for all pieces in each round: a search for few points takes about as long as one for thousands.
    for _ in range(ROUNDS):
        motions = _place(members, vertices, onto, areas, scales)
        scales = [(float(motion.scale), float(motion.scale)) for motion in motions]
        triangle, barycentric = search.closest(_move(members, vertices, motions))
        onto = np.einsum("nk,nkx->nx", barycentric, match.source.vertices[match.source.triangles[triangle]])
    motions = _place(members, vertices, onto, areas, scales)
    found = ((_move(members, vertices, motions) - onto) ** 2).sum(axis=1)
    for own, motion in zip(members, motions, strict=True):
        found[own] /= motion.scale**2
    return np.asarray(found / match.target.area)


def _place(
    members: Sequence[Integers], vertices: Floats, onto: Floats, areas: Floats, scales: Sequence[tuple[float, float]]
) -> list[Similarities]:
    """The similarity, with a scale within limits, that places the vertices of each piece best."""
    return [
        procrustes(vertices[own], onto[own], areas[own], scales=limits)
        for own, limits in zip(members, scales, strict=True)
    ]


def _move(members: Sequence[Integers], vertices: Floats, motions: Sequence[Similarities]) -> Floats:
    """(n, 3) vertices, each moved by the similarity of its piece."""
    moved = np.empty_like(vertices)
    for own, motion in zip(members, motions, strict=True):
        moved[own] = motion(vertices[own])
    return moved
