# SPDX-License-Identifier: GPL-3.0-or-later
"""A tube with three bones and its exact bent shape: ground truth for skinning and for unposing."""

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from zoomout_core.geometry.procrustes import Similarities
from zoomout_core.mesh.affine_maps import transform_points
from zoomout_core.samples.grids import ring_faces
from zoomout_core.transfer.rigging.skinning import skinning_matrices

LENGTH = 6.0
PARENTS = np.array([-1, 0, 1])


def tube(around=16, along=41, turned=0.0):
    """A closed tube along z; its oval cross-section makes twist visible."""
    angle, height = np.meshgrid(2 * np.pi * (np.arange(around) + turned) / around, np.linspace(0, 1, along))
    angle, height = angle.ravel(), height.ravel()
    points = np.column_stack([0.6 * np.cos(angle), 0.4 * np.sin(angle), LENGTH * height])
    ends = [list(range(around))[::-1], list(range(around * (along - 1), around * along))]
    return zo.Surface(points, [*ring_faces(along, around).tolist(), *ends])


def weights_of(points, softness=1.0):
    """(n, 3) weights that fade from bone to bone around heights of 2 and 4."""
    beyond = [np.clip((points[:, 2] - joint) / softness + 0.5, 0, 1) for joint in (2.0, 4.0)]
    return csr_array(np.column_stack([1 - beyond[0], beyond[0] * (1 - beyond[1]), beyond[0] * beyond[1]]))


def bend(first=(60, 0, 30), second=(40, 20, 0), scale=1.0):
    """Transforms of the three bones for rotations in degrees about the joints."""
    turns = [np.eye(3)]
    turns += [turns[-1] @ Rotation.from_euler("xyz", first, degrees=True).as_matrix()]
    turns += [turns[-1] @ Rotation.from_euler("xyz", second, degrees=True).as_matrix()]
    shifts = [np.zeros(3)]
    for bone, joint in ((1, 2.0), (2, 4.0)):
        at = np.array([0, 0, joint])
        shifts.append(turns[bone - 1] @ at + shifts[bone - 1] - turns[bone] @ at)
    return Similarities(np.full(3, scale), np.stack(turns), scale * np.stack(shifts))


def pose_surface(surface, transforms, weights=None, *, preserve_volume=False):
    """Pose a surface by its skin weights."""
    weights = weights_of(surface.vertices) if weights is None else weights
    matrices = skinning_matrices(transforms, weights, preserve_volume=preserve_volume)
    return surface.with_vertices(transform_points(matrices, surface.vertices))
