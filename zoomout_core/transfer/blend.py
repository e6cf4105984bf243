# SPDX-License-Identifier: GPL-3.0-or-later
"""Blend transferred values with the target's existing ones."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, diags_array

from zoomout_core.arrays import Floats, to_floats
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.transfer.attribute import Attribute, Domain, Kind, is_nothing, mean_over_vertices
from zoomout_core.transfer.blend_settings import Blend, Mode
from zoomout_core.transfer.normals import outward_normals
from zoomout_core.transfer.rules import RULES


def blend(
    transferred: Attribute, present: Attribute | None, target: Surface, how: Blend, sharing: Collection[str] = ()
) -> Attribute:
    """Blend a transferred attribute with the target's own.

    Args:
        transferred: the attribute transferred to the target.
        present: the target's attribute of the same name, kind and domain; for weights, all its groups; None if it has
            none, which counts as zeros, or as the surface's normals.
        target: the surface that has them.
        how: how to blend them.
        sharing: names of the vertex groups that share a vertex, as deforming groups do.

    Returns:
        The blended values; only weights of the transferred groups, though other groups also determine what is missing.

    Raises:
        ValueError: the mask does not fit the target.
    """
    amount = _amounts(transferred, target, how)
    if transferred.kind is Kind.WEIGHT:
        return replace(transferred, values=_blend_weights(transferred, present, amount, how.mode, set(sharing)))
    new = np.asarray(transferred.values)
    if present is not None:
        old = np.asarray(present.values)
    elif transferred.kind is Kind.NORMAL and how.mode == "mix":
        old = outward_normals(target, transferred.domain)
    else:
        old = np.zeros_like(new)
    amount = amount.reshape(-1, *[1] * (new.ndim - 1))
    if how.mode == "missing":
        is_key = transferred.kind is Kind.OFFSET
        missing = (old == 0).all(axis=(0, 2))[:, None] if is_key else is_nothing(old).reshape(amount.shape)
        amount = amount * missing
    if transferred.kind is Kind.NORMAL:
        return replace(transferred, values=_mix_normals(old, new, amount).astype(new.dtype))
    if RULES[transferred.kind].mixable:
        return replace(transferred, values=(old + amount * (new - old)).astype(new.dtype))
    return replace(transferred, values=np.where(amount > 0.5, new, old))


def mask_of(mask: ArrayLike | None, target: Surface) -> Floats:
    """(n_t,) a mask of the target's vertices, 1 everywhere when not given.

    Raises:
        ValueError: the mask does not fit the target.
    """
    n = len(target.vertices)
    values = np.ones(n) if mask is None else to_floats(mask, "A mask")
    if values.shape != (n,) or not ((values >= 0) & (values <= 1)).all():
        raise ValueError(f"A mask must have a number from 0 to 1 for each of the target's {n} vertices.")
    return values


def _amounts(attribute: Attribute, target: Surface, how: Blend) -> Floats:
    """(count,) share of each transferred value; the corners of a face are chosen together."""
    mask = how.factor * mask_of(how.mask, target)
    if attribute.domain is Domain.CORNER and (attribute.kind is Kind.NORMAL or RULES[attribute.kind].mixable):
        return np.asarray(mask[target.corner_vertex])
    return mean_over_vertices(mask, attribute.domain, target)


def _mix_normals(old: Floats, new: Floats, amount: Floats) -> Floats:
    """(count, 3) unit normals between old ones and a share (count, 1) of new ones; of opposite ones, one is taken."""
    mixed = unit_vectors(old + amount * (new - old))
    return np.where(mixed.any(axis=1, keepdims=True), mixed, np.where(amount > 0.5, new, old))


def _blend_weights(
    transferred: Attribute, present: Attribute | None, amount: Floats, mode: Mode, sharing: set[str]
) -> Any:
    """(n, groups) sparse weights of the transferred groups."""
    new = csr_array(transferred.values)
    if present is None:
        return csr_array(diags_array(amount) @ new).astype(new.dtype)
    theirs, column = csr_array(present.values), {name: i for i, name in enumerate(present.labels)}
    pairs = [(column[name], i) for i, name in enumerate(transferred.labels) if name in column]
    rows, columns = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    old = csr_array(theirs @ csr_array((np.ones(len(rows)), (rows, columns)), shape=(theirs.shape[1], new.shape[1])))
    if mode == "mix":
        mixed = diags_array(1 - amount) @ old + diags_array(amount) @ new
    else:
        shares = np.array([name in sharing for name in transferred.labels], dtype=bool)
        theirs_share = np.array([name in sharing for name in present.labels], dtype=float)
        bare = theirs @ theirs_share == 0
        alone = new - new.multiply(old > 0)  # for groups that do not share vertices
        added = diags_array(bare.astype(float)) @ new @ diags_array(shares.astype(float))
        mixed = old + diags_array(amount) @ (added + alone @ diags_array((~shares).astype(float)))
    mixed = csr_array(mixed).astype(new.dtype)
    mixed.eliminate_zeros()
    return mixed
