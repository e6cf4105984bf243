# SPDX-License-Identifier: GPL-3.0-or-later
"""Check clothes on an avatar, at rest and in two poses: cloth in the skin, and stretched cloth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.assets.asset import Asset
from zoomout_core.matching.report.verdict import AMBER, GREEN, Verdict
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_lengths, unique_edges
from zoomout_core.messages import message
from zoomout_core.outfits.dress_avatar import DressedAvatar
from zoomout_core.transfer.dressing.barriers import SidedSurface
from zoomout_core.transfer.rigging.poses import extend_poses, find_limbs, pose_of_turns

# The poses, and the axes about which limbs rotate in them; y is up. In one pose, limbs swing forward and back, in the
# other one to the sides.
REST, SWING, SPREAD = "rest", "swing", "spread"
AXES: Mapping[str, tuple[float, float, float]] = {SWING: (1, 0, 0), SPREAD: (0, 0, 1)}
UP = 1
# Degrees by which each limb rotates.
ANGLE = 30.0
# Cloth is in the skin if it is deeper than this share of the height: a millimetre for an adult.
DEEP = 6e-4
# An edge is stretched if it grows by this factor, relative to the growth of the body.
STRETCHED = 2.0
# Maximum shares for a green verdict: of places at rest, of places in a pose, and of edges.
MAX_INSIDE, MAX_INSIDE_POSED, MAX_STRETCHED = 0.001, 0.01, 0.001
INSIDE = "{share:.1%} of the cloth is in the skin."
INSIDE_POSED = "{share:.1%} of the cloth is in the skin when limbs move."
MANY_STRETCHED = "{share:.1%} of the edges of the cloth are stretched to more than twice their length."
LOOK = "Look at the pictures: it is marked red there."


class RiggedSurface(NamedTuple):
    """A surface at rest, and its skin weights."""

    surface: Surface
    parents: Integers | None  # (b,) the number of each joint's parent, -1 for none; None if it is not bound
    weights: csr_array | None  # (n, b) weights of the joints, whose rows sum to one


@dataclass(frozen=True, eq=False)
class CheckedOutfit:
    """The figures of clothes on an avatar.

    Attributes:
        inside: the share of places of the cloth, in each pose, that are in the skin here, but not on the other body.
        stretched: the share of its edges that are stretched.
        bodies: (n_t, 3) the body in each pose.
        clothes: (n, 3) the cloth in each pose.
        marks: (n,) vertices of the cloth that are newly in the skin, in each pose.
    """

    inside: dict[str, float]
    stretched: float
    bodies: dict[str, Floats]
    clothes: dict[str, Floats]
    marks: dict[str, Booleans]

    @property
    def verdict(self) -> Verdict:
        """The verdict on the clothes, assuming that the match of the bodies is right."""
        posed = max((share for pose, share in self.inside.items() if pose != REST), default=0.0)
        cases = (
            (self.inside[REST] > MAX_INSIDE, message(INSIDE, share=self.inside[REST])),
            (self.stretched > MAX_STRETCHED, message(MANY_STRETCHED, share=self.stretched)),
            (posed > MAX_INSIDE_POSED, message(INSIDE_POSED, share=posed)),
        )
        found = next((sentence for is_present, sentence in cases if is_present), None)
        return (
            Verdict(GREEN, message("The clothes fit."), "") if found is None else Verdict(AMBER, found, message(LOOK))
        )


def check_outfit(source: Surface, worn: Surface, dressed: DressedAvatar, target: Asset) -> CheckedOutfit:
    """Check clothes on an avatar.

    Args:
        source: the body that wore them before.
        worn: the clothes on it.
        dressed: the clothes on the avatar.
        target: the avatar's body.
    """
    cloth, body = (
        RiggedSurface(each.surface, *((None, None) if each.skin is None else (each.skin.parents, each.skin.weights)))
        for each in (dressed.clothes, target)
    )
    heads = np.zeros((0, 3))
    if target.skin is not None and target.document is not None:
        heads = target.document.worlds()[0][target.skin.nodes, :3, 3]
    return check_rigged(source, worn, cloth, body, heads)


def check_rigged(
    source: Surface, worn: Surface, cloth: RiggedSurface, body: RiggedSurface, heads: Floats
) -> CheckedOutfit:
    """Check clothes on a body.

    Args:
        source: the body that wore them before; y is up.
        worn: the clothes on it.
        cloth: the clothes on the other body.
        body: that body.
        heads: (b, 3) heads of its joints, which are the first of those of the clothes; none if it is not bound.
    """
    height = float(np.ptp(body.surface.vertices[:, 1]))
    before = _depths(source, source.vertices, worn, worn.vertices)
    was_outside = before < DEEP * float(np.ptp(source.vertices[:, 1]))
    bodies, clothes = {REST: body.surface.vertices}, {REST: cloth.surface.vertices}
    if len(heads) and body.parents is not None and cloth.parents is not None:
        for pose in AXES:
            transforms = _pose(pose, body.parents, heads)
            bodies[pose], clothes[pose] = (_move(each, transforms) for each in (body, cloth))
    inside, marks = {}, {}
    for pose in bodies:
        wrong = was_outside & (_depths(body.surface, bodies[pose], cloth.surface, clothes[pose]) > DEEP * height)
        inside[pose], marks[pose] = float(wrong.mean()), wrong[: len(cloth.surface.vertices)]
    growth = float(np.sqrt(body.surface.area / source.area))
    edges, _ = unique_edges(cloth.surface.triangles)
    old, new = (edge_lengths(points, edges) for points in (worn.vertices, cloth.surface.vertices))
    return CheckedOutfit(inside, float((new > STRETCHED * growth * old).mean()), bodies, clothes, marks)


def _depths(body: Surface, skin: Floats, cloth: Surface, points: Floats) -> Floats:
    """(q,) depths in the skin of the vertices of cloth, and of the middles of its triangles; negative outside."""
    sided = SidedSurface.of(body, 1.0).with_vertices(skin)
    return -sided.sides(np.concatenate([points, points[cloth.triangles].mean(axis=1)]))[0]


def _pose(name: str, parents: Integers, heads: Floats) -> Floats:
    """(b, 3, 4) transforms of joints with heads (b, 3) to a pose: each limb rotates about its first joint."""
    limbs = find_limbs(heads, parents, UP)
    turns = np.radians(ANGLE) * (limbs.root * limbs.side)[:, None] * np.array(AXES[name])
    return pose_of_turns(turns, heads, parents)


def _move(rigged: RiggedSurface, transforms: Floats) -> Floats:
    """(n, 3) vertices moved by transforms (b, 3, 4) of the first joints, which the others follow."""
    assert rigged.parents is not None
    assert rigged.weights is not None
    (every,) = extend_poses(transforms[None], rigged.parents)
    return transform_points(blend_matrices(every, rigged.weights), rigged.surface.vertices)
