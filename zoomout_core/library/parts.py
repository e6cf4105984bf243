# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a target, such as its head, that another source fits better than the best source of the whole.

The joints of the best source divide the target into pieces that are nearly rigid in any pose. The fit of a source to a
piece is measured by the error of the similarity that places the piece on it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.assets.asset import Asset, Skin
from zoomout_core.assets.part_names import joints_below
from zoomout_core.geometry.closest_points import SurfaceSearch
from zoomout_core.geometry.procrustes import Similarities, procrustes
from zoomout_core.library.found import FoundPart, FoundSource
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.rigging.poses import parents_first
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class PartTuning(Tuning, set_by="library"):
    """The conditions for proposing another source for a part."""

    min_share: float = tuned(0.03, "of the area", 0, 1)  # smallest part of the target, as a share of its area
    max_share: float = tuned(0.5, "of the area", 0, 1)  # largest part
    piece: int = tuned(20, "vertices of a body", 4, 1000)  # smaller pieces are merged with that of the joint above
    # Mean error of the best source there, and maximum of the other one; less is noise of bodies. The right heads of six
    # women have 0.0017 to 0.0031, and a head of a man with the same hair as a woman 0.0055.
    poor: float = tuned(0.005, "at unit area", 0, 1)
    better: float = tuned(0.55, "1", 0, 1)  # error of the other source, relative to that of the best one
    # Minimum share of the best source's mean squared error that the other source removes. Right heads of four women
    # remove 0.39 to 0.58, and a forearm of another build 0.05.
    min_gain: float = tuned(0.2, "1", 0, 1)


PARTS = PartTuning()

# Rounds of closest points; they converge within about this number.
ROUNDS = 10
# Maximum ratio of a part's size on two sources, relative to their bodies. Without a limit, a wrong map may shrink a
# part to a point, which always fits.
MAX_SCALE = 2.0
# Vertices of a hull that are farther from the main part, at unit area, belong to a part that the latter lacks. This is
# 7 cm for a person, more than clothes and the width of a voxel.
COVERED = 0.05


@dataclass(frozen=True, eq=False)
class JointParts:
    """The parts of a target's body, by the joints of its best source, and the errors of that source there."""

    path: Path  # of the best source
    skin: Skin  # of the best source
    body: Surface  # of the target, n vertices
    joint: Integers  # (n,) the joint that moves each vertex
    piece: Integers  # (n,) the joint of the nearly rigid piece of each vertex
    errors: Floats  # (n,) squared distances of the best source, at unit area, see `_errors`

    @classmethod
    def of(cls, path: Path, asset: Asset, matches: Sequence[MatchResult]) -> JointParts:
        """The parts of the last match's target.

        Args:
            path: file of the best source.
            asset: the best source, with a skin.
            matches: matches of its bodies. Each vertex has the joint of the first match whose target reaches it.
        """
        assert asset.skin is not None
        body = matches[-1].target
        joint = _main_joint(asset, matches[-1], body)
        for match in matches[-2::-1]:
            joint = np.where(is_covered(body, match.target), _main_joint(asset, match, body), joint)
        piece = _pieces(joint, asset.skin.parents)
        errors = np.min([_errors(match, body, piece) for match in matches], axis=0)
        return cls(path, asset.skin, body, joint, piece, errors)

    def poorest(self) -> Booleans | None:
        """(n,) the part that the best source fits worst; None if none is poor and causes much of its error."""

        def is_poor(part: _Part) -> bool:
            error = part.error(self.errors)
            return error > PARTS.poor and error**2 * part.share > self._min_gain

        poor = list(filter(is_poor, self._parts()))
        # The mean squared error is weighted by the root of the area: its integral would favour a part with all its
        # surroundings, and the mean alone a small part of it.
        return max(poor, key=lambda part: part.error(self.errors) ** 2 * part.share**0.5).inside if poor else None

    def is_fitted(self, inside: Booleans, other: FoundSource) -> bool:
        """Whether another source fits a part (n,) as well as a body with few vertices can show."""
        part = _Part(0, inside, self._areas)
        return other.fits and other.match is not None and part.error(self._errors_of(other)) <= PARTS.poor

    def find(self, others: Sequence[FoundSource]) -> FoundPart | None:
        """The part that another source fits better, by the largest gain; None if none fits much better."""
        fitting = [each for each in others if each.fits and each.match is not None]
        if not fitting:
            return None
        errors = [self._errors_of(each) for each in fitting]
        found, most = None, self._min_gain
        for part in self._parts():
            of_best, of_others = part.error(self.errors), [part.error(each) for each in errors]
            other = int(np.argmin(of_others))
            gain = (of_best**2 - of_others[other] ** 2) * part.share
            limit = min(PARTS.better * of_best, PARTS.poor)
            if of_best > PARTS.poor and of_others[other] < limit and gain > most:
                most = gain
                names = tuple(self.skin.names[each] for each in np.flatnonzero(self._below(part.joint)))
                fits = (1 - each / np.sqrt(part.share) for each in (of_others[other], of_best))
                found = FoundPart(fitting[other].path, self.path, self.skin.names[part.joint], names, *fits)
        return found

    @cached_property
    def _areas(self) -> Floats:
        return self.body.vertex_areas / self.body.area

    @property
    def _min_gain(self) -> float:
        """The mean squared error that a second source must remove."""
        return PARTS.min_gain * float(self._areas @ self.errors)

    def _errors_of(self, source: FoundSource) -> Floats:
        assert source.match is not None
        return _errors(source.match, self.body, self.piece)

    def _below(self, joint: int) -> Booleans:
        return joints_below(self.skin, np.arange(len(self.skin.names)) == joint)

    def _parts(self) -> Iterator[_Part]:
        """The parts whose area is within limits, one for each joint."""
        for joint in range(len(self.skin.names)):
            part = _Part(joint, self._below(joint)[self.joint], self._areas)
            if PARTS.min_share <= part.share <= PARTS.max_share:
                yield part


class _Part(NamedTuple):
    """A joint with all joints below it, and the vertices that they move."""

    joint: int
    inside: Booleans  # (n,)
    areas: Floats  # (n,) of all vertices; their sum is one

    @property
    def share(self) -> float:
        """Its share of the area."""
        return float(self.areas[self.inside].sum())

    def error(self, squares: Floats) -> float:
        """The root of the mean of squared errors (n,)."""
        return float(np.sqrt(self.areas[self.inside] @ squares[self.inside] / self.share))


def is_covered(body: Surface, other: Surface) -> Booleans:
    """(n,) whether vertices of a body are near another one, which may lack parts such as the head."""
    return np.asarray(cKDTree(other.vertices).query(body.vertices)[0] < COVERED * np.sqrt(body.area))


def _main_joint(asset: Asset, match: MatchResult, body: Surface) -> Integers:
    """(n,) the joint that moves each vertex of a body of the target, from the asset's weights."""
    assert asset.skin is not None
    nearest = np.asarray(cKDTree(asset.surface.vertices).query(match.source.vertices)[1])
    joint = match.surface_map.interpolate(asset.skin.weights[nearest].toarray()).argmax(axis=1)
    return np.asarray(joint[cKDTree(match.target.vertices).query(body.vertices)[1]])


def _pieces(joint: Integers, parents: Integers) -> Integers:
    """(n,) the joint of the nearly rigid piece of each vertex, from the joint that moves it.

    A joint that moves few vertices belongs to the piece of the joint above.
    """
    piece = joint.copy()
    for each in reversed(parents_first(parents)):
        if parents[each] >= 0 and np.count_nonzero(piece == each) < PARTS.piece:
            piece[piece == each] = parents[each]
    return piece


def _errors(match: MatchResult, body: Surface, piece: Integers) -> Floats:
    """(n,) squared distances of a body from the source, on which a similarity places each piece, at unit area.

    The similarity is first fitted to the images of the piece. Its scale is then fixed, and it is fitted to closest
    points, so that errors of the map along the surface have no effect. A vertex that the match does not cover has at
    least the error `COVERED`.

    Args:
        match: the match, of any body of the target.
        body: a body of the target.
        piece: (n,) the pieces that have a similarity each.
    """
    vertices, areas = body.vertices, body.vertex_areas
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
    found /= body.area
    return np.where(is_covered(body, match.target), found, np.maximum(found, COVERED**2))


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
