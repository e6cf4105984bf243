# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotations: quaternions, and the rotations of matrices.

A quaternion and its negative are the same rotation, so the outer products q q' are mixed, and the mean is the
eigenvector of the largest eigenvalue: Markley et al., Averaging quaternions (2007).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.frames import rotations
from zoomout_core.transfer.interpolate import MIX
from zoomout_core.transfer.mapped_target import MappedTarget

# If all quaternions are zero, this makes their mean the identity.
NOTHING = 1e-12


def mix_quaternions(attribute: Attribute, mapped: MappedTarget, *, turned: bool = False) -> Attribute:
    """Mix unit quaternions (count, 4), w first; if `turned`, they rotate with the surface."""
    values = np.asarray(attribute.values, dtype=np.float64)
    both = replace(attribute, values=np.column_stack([_outer_products(values), values]))
    mixed = MIX[attribute.domain](both, mapped)
    quaternions = _mean(mixed.values[:, :16], mixed.values[:, 16:])
    if turned:
        quaternions = _quaternions(_turning(attribute, mapped) @ _matrices(quaternions))
    return replace(mixed, values=quaternions.astype(attribute.values.dtype))


def mix_matrices(attribute: Attribute, mapped: MappedTarget, *, turned: bool = False) -> Attribute:
    """Mix matrices (count, 16), row by row: rotations as quaternions, stretch and translation as numbers.

    If `turned`, their rotations rotate with the surface.
    """
    matrices = np.asarray(attribute.values, dtype=np.float64).reshape(-1, 4, 4)
    left, stretch, right = np.linalg.svd(matrices[:, :3, :3])
    # Polar decomposition into a rotation and a stretch, which includes any reflection.
    handed = np.sign(np.linalg.det(left @ right))
    left[:, :, 2] *= handed[:, None]
    stretch[:, 2] *= handed
    rest = matrices.copy()
    rest[:, :3, :3] = np.einsum("qkx,qk,qky->qxy", right, stretch, right)
    parts = np.column_stack([_outer_products(_quaternions(left @ right)), rest.reshape(-1, 16)])
    mixed = MIX[attribute.domain](replace(attribute, values=parts), mapped)
    rotation = _matrices(_mean(mixed.values[:, :16], None))
    if turned:
        rotation = _turning(attribute, mapped) @ rotation
    result = mixed.values[:, 16:].reshape(-1, 4, 4)
    result[:, :3, :3] = rotation @ result[:, :3, :3]
    return replace(mixed, values=result.reshape(-1, 16).astype(attribute.values.dtype))


def _turning(attribute: Attribute, mapped: MappedTarget) -> Floats:
    """(count, 3, 3) rotations from the source's surface to the target's; point reflections undo mirrored ones."""
    found = rotations(mapped, attribute.domain)
    return found * np.sign(np.linalg.det(found))[:, None, None]


def _outer_products(quaternions: Floats) -> Floats:
    """(q, 16) products of quaternions (q, 4) with themselves."""
    return np.einsum("qx,qy->qxy", quaternions, quaternions).reshape(-1, 16)


def _mean(squared: Floats, like: Floats | None) -> Floats:
    """(q, 4) unit quaternions of mixed products (q, 16), with the sign of `like` (q, 4), else with positive w."""
    products = squared.reshape(-1, 4, 4)
    products[:, 0, 0] += NOTHING
    mean = np.linalg.eigh(products)[1][:, :, 3]
    towards = mean[:, 0] if like is None else np.einsum("qx,qx->q", mean, like)
    return np.asarray(mean * np.where(towards < 0, -1, 1)[:, None])


def _matrices(quaternions: Floats) -> Floats:
    return np.asarray(Rotation.from_quat(np.roll(quaternions, -1, axis=1)).as_matrix())


def _quaternions(matrices: Floats) -> Floats:
    return np.roll(Rotation.from_matrix(matrices).as_quat(), 1, axis=1)
