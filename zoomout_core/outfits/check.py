# SPDX-License-Identifier: GPL-3.0-or-later
"""Check clothes on an avatar, at rest and in two poses: cloth in the skin, and stretched cloth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.assets.asset import Asset, Skin
from zoomout_core.matching.report.verdict import AMBER, GREEN, Verdict
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_lengths, unique_edges
from zoomout_core.messages import message
from zoomout_core.outfits.dress_avatar import DressedAvatar
from zoomout_core.transfer.dressing.contact import SidedSurface
from zoomout_core.transfer.rigging.poses import parents_first, pose_of_turns
from zoomout_core.transfer.rigging.skinning import blend_matrices, transform_points

# The poses, and the axes that limbs turn about in them; y is up. In one, limbs swing to the front and back, in the
# other one to the sides.
REST, SWING, SPREAD = "rest", "swing", "spread"
AXES: Mapping[str, tuple[float, float, float]] = {SWING: (1, 0, 0), SPREAD: (0, 0, 1)}
# Degrees by which each limb turns.
ANGLE = 30.0
# A limb begins at a joint this far from the middle, and its chain reaches this much farther: shares of the height.
ASIDE, LONG = 0.02, 0.15
# Cloth is in the skin if it is deeper than this share of the height: a millimetre for an adult.
DEEP = 6e-4
# An edge is stretched if it is this many times as long as before, relative to the growth of the body.
STRETCHED = 2.0
# Largest shares of a green verdict, of places at rest, of places in a pose, and of edges.
MAX_INSIDE, MAX_INSIDE_POSED, MAX_STRETCHED = 0.001, 0.01, 0.001
INSIDE = "{share:.1%} of the cloth is in the skin."
INSIDE_POSED = "{share:.1%} of the cloth is in the skin when limbs move."
MANY_STRETCHED = "{share:.1%} of the edges of the cloth are stretched to more than twice their length."
LOOK = "Look at the pictures: it is marked red there."


@dataclass(frozen=True, eq=False)
class CheckedOutfit:
    """The figures of clothes on an avatar.

    Attributes:
        inside: the share of places of the cloth, in each pose, that are in the skin, and were not on the other body.
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
        """Whether to use the clothes, if the match of the bodies is right."""
        posed = max((share for pose, share in self.inside.items() if pose != REST), default=0.0)
        cases = (
            (self.inside[REST] > MAX_INSIDE, message(INSIDE, share=self.inside[REST])),
            (self.stretched > MAX_STRETCHED, message(MANY_STRETCHED, share=self.stretched)),
            (posed > MAX_INSIDE_POSED, message(INSIDE_POSED, share=posed)),
        )
        found = next((sentence for is_present, sentence in cases if is_present), None)
        return Verdict(GREEN, message("The clothes fit."), "") if found is None else Verdict(AMBER, found, LOOK)


def check_outfit(source: Surface, worn: Surface, dressed: DressedAvatar, target: Asset) -> CheckedOutfit:
    """Check clothes on an avatar.

    Args:
        source: the body that wore them before.
        worn: the clothes on it.
        dressed: the clothes on the avatar.
        target: the avatar's body.
    """
    cloth, height = dressed.clothes.surface, float(np.ptp(target.surface.vertices[:, 1]))
    before = _depths(source, source.vertices, worn, worn.vertices)
    was_outside = before < DEEP * float(np.ptp(source.vertices[:, 1]))
    bodies, clothes = {REST: target.surface.vertices}, {REST: cloth.vertices}
    if target.skin is not None and target.document is not None and dressed.clothes.skin is not None:
        heads = target.document.worlds()[0][target.skin.nodes, :3, 3]
        for pose in AXES:
            transforms = _pose(pose, target.skin, heads)
            bodies[pose] = _move(target.surface.vertices, target.skin, transforms)
            clothes[pose] = _move(cloth.vertices, dressed.clothes.skin, transforms)
    inside, marks = {}, {}
    for pose in bodies:
        wrong = was_outside & (_depths(target.surface, bodies[pose], cloth, clothes[pose]) > DEEP * height)
        inside[pose], marks[pose] = float(wrong.mean()), wrong[: len(cloth.vertices)]
    growth = float(np.sqrt(target.surface.area / source.area))
    edges, _ = unique_edges(cloth.triangles)
    old, new = (edge_lengths(points, edges) for points in (worn.vertices, cloth.vertices))
    return CheckedOutfit(inside, float((new > STRETCHED * growth * old).mean()), bodies, clothes, marks)


def _depths(body: Surface, skin: Floats, cloth: Surface, points: Floats) -> Floats:
    """(q,) depths in the skin of the vertices of cloth, and of the middles of its triangles; negative outside."""
    sided = SidedSurface.of(body, 1.0).with_vertices(skin)
    return -sided.sides(np.concatenate([points, points[cloth.triangles].mean(axis=1)]))[0]


def _pose(name: str, skin: Skin, heads: Floats) -> Floats:
    """(b, 3, 4) transforms of joints with heads (b, 3) to a pose: each limb turns where it begins."""
    middle, height = float(np.median(heads[:, 0])), float(np.ptp(heads[:, 1]))
    side = np.where(np.abs(heads[:, 0] - middle) > ASIDE * height, np.sign(heads[:, 0] - middle), 0)
    reach = np.zeros(len(heads))
    for joint in reversed(parents_first(skin.parents)):
        above = skin.parents[joint]
        if above >= 0:
            reach[above] = max(reach[above], reach[joint] + np.linalg.norm(heads[joint] - heads[above]))
    turns, in_limb = np.zeros((len(heads), 3)), np.zeros(len(heads), dtype=bool)
    for joint in parents_first(skin.parents):
        above = skin.parents[joint]
        in_limb[joint] = above >= 0 and in_limb[above]
        if not in_limb[joint] and side[joint] and reach[joint] > LONG * height:
            in_limb[joint] = True
            turns[joint] = np.radians(ANGLE) * side[joint] * np.array(AXES[name])
    return pose_of_turns(turns, heads, skin.parents)


def _move(points: Floats, skin: Skin, transforms: Floats) -> Floats:
    """(n, 3) points (n, 3) moved by transforms (b, 3, 4) of the first joints of a skin, which the others follow."""
    every = np.zeros((len(skin.names), 3, 4))
    every[: len(transforms)] = transforms
    for joint in parents_first(skin.parents):
        if joint >= len(transforms):
            every[joint] = every[skin.parents[joint]]
    return transform_points(blend_matrices(every, skin.weights), points)
