# SPDX-License-Identifier: GPL-3.0-or-later
"""Match two bodies by the joints of their rigs, if both rigs are humanoid and their bones are known.

Bones of the same humanoid bone are partners. They move the source's joints to the target's, with the skin, and each
vertex of the target goes to the nearest point of the skin of the same bone or of one next to it. No limb can be
confused, however different the bodies are; but places along the skin are less precise than those of a good match.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.oriented_closest_points import OrientedSurface
from zoomout_core.geometry.procrustes import SMALLEST, Similarities, procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import vertex_normals
from zoomout_core.transfer.rigging.bone_pairs import Skeleton, same_humanoid
from zoomout_core.transfer.rigging.bone_tree import next_above
from zoomout_core.transfer.rigging.humanoid import MIN_BONES
from zoomout_core.transfer.rigging.poses import parents_first
from zoomout_core.transfer.rigging.rig import align_bones
from zoomout_core.transfer.rigging.skinning import renumber_bones, skinning_matrices, strongest
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class JointMapTuning(Tuning, set_by="outfits"):
    """How to match bodies by joints.

    Attributes:
        facing: the distance equivalent to a unit difference of normals when points of the skin are compared.
        other_limbs: the largest part of the target that a map may send to other limbs. Right maps of people in other
            builds and styles send .006 there at most, wrong ones at least .077.
        times_own: the largest ratio of this part to that of the map by joints, which is no evidence against another map
            if it sends much to other limbs itself. On characters with weapons bound to a finger, they are .80 and .035.
    """

    facing: float = tuned(0.1, "at unit area", 0, 10)
    other_limbs: float = tuned(0.03, "1", 0, 1)
    times_own: float = tuned(4.0, "1", 0, 1000)


JOINT_MAP = JointMapTuning()


class RiggedBody(NamedTuple):
    """A body with its bones, in one frame."""

    surface: Surface
    bones: Skeleton
    weights: csr_array  # (n, b)


class _Side(NamedTuple):
    """A body with the joints that it shares with another one."""

    surface: Surface
    heads: Floats  # (j, 3)
    weights: csr_array  # (n, j) those of a bone without a partner are added to the bone above
    bone: Integers  # (n,) the joint with the largest weight; -1 without weights


class SharedJoints(NamedTuple):
    """Two bodies with their shared joints."""

    source: _Side
    target: _Side
    parents: Integers  # (j,) the nearest shared joint above each; -1 for none

    @classmethod
    def of(cls, source: RiggedBody, target: RiggedBody) -> SharedJoints | None:
        """The joints of the same humanoid bones of two bodies; None if too few are known."""
        pairs = same_humanoid(source.bones, target.bones)
        if len(pairs) < MIN_BONES:
            return None
        number, other = ({name: i for i, name in enumerate(each.bones.names)} for each in (source, target))
        own = np.array([number[name] for name in pairs])
        theirs = np.array([other[name] for name in pairs.values()])
        parents = next_above(source.bones.parents, own, strictly=True)[own]
        return cls(_side(source, own), _side(target, theirs), parents)

    @property
    def are_near(self) -> Booleans:
        """(j, j) whether joints are the same, or one is the parent of the other."""
        count = len(self.parents)
        near = np.eye(count, dtype=bool)
        below = np.flatnonzero(self.parents >= 0)
        near[below, self.parents[below]] = near[self.parents[below], below] = True
        return near

    def map(self) -> SurfaceMap:
        """The map from the target to the source by the joints."""
        source, target = self.source, self.target
        posed = transform_points(skinning_matrices(self._transforms(), source.weights), source.surface.vertices)
        unit = float(np.sqrt(target.surface.area))
        triangle, barycentric = self._closest(
            target, source._replace(surface=source.surface.with_vertices(posed)), unit
        )
        return SurfaceMap(triangle, barycentric, source.surface.triangles)

    def project_source(self, places: Floats) -> Floats:
        """(n, 3) the points of the target closest to places (n, 3) of the source's vertices, on the same bones."""
        source, target = self.source, self.target.surface
        unit = float(np.sqrt(target.area))
        triangle, barycentric = self._closest(
            source._replace(surface=source.surface.with_vertices(places)), self.target, unit
        )
        return np.asarray(np.einsum("nc,ncx->nx", barycentric, target.vertices[target.triangles[triangle]]))

    def _closest(self, side: _Side, other: _Side, unit: float) -> tuple[Integers, Floats]:
        """Triangles of the other side, and barycentric coordinates there, closest to the vertices of a side.

        They belong to the bone of the vertex or to one next to it.
        """
        triangles = other.surface.triangles
        # Each triangle belongs to all bones near its own one, and those without a bone to none.
        owner, near = other.bone[triangles].max(axis=1), self.are_near
        bone, triangle = np.nonzero(near[:, owner] & (owner >= 0))
        # Vertices without weights, or whose bone moves nothing of the other side, search everywhere.
        everywhere = len(near)
        group = np.concatenate([bone, np.full(len(triangles), everywhere)])
        chosen = np.concatenate([triangle, np.arange(len(triangles))])
        flipped = np.zeros(len(chosen), dtype=bool)
        surface = OrientedSurface(other.surface.vertices, triangles[chosen], flipped, JOINT_MAP.facing * unit, group)
        own = np.where(side.bone >= 0, side.bone, everywhere)
        own[~surface.has_group(own)] = everywhere
        normals = vertex_normals(side.surface.vertices, side.surface.triangles)
        found, barycentric, _ = surface.closest(side.surface.vertices, normals, own)
        return chosen[found], barycentric

    def contradict(self, surface_map: SurfaceMap) -> bool:
        """Whether a map confuses limbs, but the map by the joints hardly does."""
        own, share = (self.share_on_other_limbs(each) for each in (self.map(), surface_map))
        return share > max(JOINT_MAP.other_limbs, JOINT_MAP.times_own * own)

    def share_on_other_limbs(self, surface_map: SurfaceMap) -> float:
        """The share of the target's area that a map sends to a bone that is neither its own nor next to it."""
        image, own = self.source.bone[surface_map.vertex], self.target.bone
        is_known = (image >= 0) & (own >= 0)
        is_off = is_known & ~self.are_near[own, image]
        return self.target.surface.share_of_area(is_off) / max(self.target.surface.share_of_area(is_known), SMALLEST)

    def stretch_source(self) -> Floats:
        """(n, 3) the source's vertices moved by the joints to the target's, without change of girth.

        Bones take the target's lengths, and their surroundings the scale of the whole across them.
        """
        before, after, parents = self.source.heads, self.target.heads, self.parents
        transforms, across = self._transforms(), float(procrustes(before, after).scale)
        linear = np.tile(across * np.eye(3), (len(parents), 1, 1))
        for joint in np.unique(parents[parents >= 0]).tolist():
            arm = (before[parents == joint] - before[joint]).sum(axis=0)
            axis = arm / max(float(np.linalg.norm(arm)), SMALLEST)
            linear[joint] += (transforms.scale[joint] - across) * np.outer(axis, axis)
        linear = transforms.rotation @ linear
        translation = after - np.einsum("jxy,jy->jx", linear, before)
        matrices = np.concatenate([linear, translation[:, :, None]], axis=2)
        return transform_points(blend_matrices(matrices, self.source.weights), self.source.surface.vertices)

    def _transforms(self) -> Similarities:
        """(j,) similarities that take the source's joints, and the directions and lengths of bones, to the target's."""
        before, after, parents = self.source.heads, self.target.heads, self.parents
        whole = procrustes(before, after)
        rotation = align_bones(before, after, parents, np.tile(whole.rotation, (len(parents), 1, 1)))
        scale = np.full(len(parents), float(whole.scale))
        for joint in parents_first(parents):
            below = np.flatnonzero(parents == joint)
            if len(below):
                lengths = [np.linalg.norm(heads[below] - heads[joint], axis=1).sum() for heads in (before, after)]
                scale[joint] = lengths[1] / max(lengths[0], SMALLEST)
                continue
            scale[joint] = self._scale_of_skin(joint, scale[joint])
            if parents[joint] >= 0:
                rotation[joint] = rotation[parents[joint]]
        translation = after - scale[:, None] * np.einsum("jxy,jy->jx", rotation, before)
        return Similarities(scale, rotation, translation)

    def _scale_of_skin(self, joint: int, usual: float) -> float:
        """The ratio of the sizes of the skin that a last joint moves; a usual one if it moves nothing."""
        sizes = [_size_of_skin(each, joint) for each in (self.source, self.target)]
        return sizes[1] / sizes[0] if min(sizes) > 0 else usual


def _side(body: RiggedBody, chosen: Integers) -> _Side:
    """A body with chosen joints (j,)."""
    weights = renumber_bones(body.weights, next_above(body.bones.parents, chosen), len(chosen))
    bone = np.where(np.asarray(weights.sum(axis=1)).ravel() > 0, strongest(weights), -1)
    return _Side(body.surface, body.bones.heads[chosen], weights, bone)


def _size_of_skin(side: _Side, joint: int) -> float:
    """The root mean square distance of the skin that a joint moves from the joint."""
    mass = np.asarray(side.weights[:, [joint]].toarray()).ravel() * side.surface.vertex_areas
    squares = ((side.surface.vertices - side.heads[joint]) ** 2).sum(axis=1)
    return float(np.sqrt(mass @ squares / max(mass.sum(), SMALLEST)))
