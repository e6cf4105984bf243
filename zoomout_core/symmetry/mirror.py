# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror attributes across a symmetry, make them symmetric, and measure their asymmetry.

The partner of a vertex is its image under the symmetry, so values are transferred as from a source to a target, by the
same rules (`zoomout_core.transfer`). Data with a side in its name, such as the weights of Arm.L, is swapped with its
partner.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy.sparse import csr_array, diags_array

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.symmetry.flip_name import partner_of
from zoomout_core.symmetry.self_map import SelfMap
from zoomout_core.transfer import RULES, Attribute, Domain, Kind, transfer
from zoomout_core.transfer.attribute import mean_over_vertices

# Which side gives its values to the other, or whether both are exchanged or averaged.
Direction: TypeAlias = Literal["left_to_right", "right_to_left", "exchange", "average"]
# Weight of an element's own value relative to that from the other side, for each direction: on the left and the right.
OWN_SHARES = {"left_to_right": (1.0, 0.0), "right_to_left": (0.0, 1.0), "exchange": (0.0, 0.0), "average": (0.5, 0.5)}
# Directions from one side to the other, which need a symmetry with two sides.
ONE_WAY = ("left_to_right", "right_to_left")


def mirror(attribute: Attribute, symmetry: SelfMap, **options: Any) -> Attribute:
    """Exchange the sides of an attribute of the symmetry's surface, with options of its kind as for `transfer`.

    Weights have the names of their groups as labels; a group without a partner gets one.

    Raises:
        MeshError: the attribute does not fit the surface, or its kind cannot be transferred.
    """
    if attribute.kind is Kind.WEIGHT:
        attribute = flip_names(attribute)
    return transfer(attribute, symmetry, symmetry.surface, symmetry.surface, **options)


def symmetrise(
    attribute: Attribute, symmetry: SelfMap, direction: Direction = "left_to_right", **options: Any
) -> Attribute:
    """Make an attribute the same on both sides, or exchange its sides.

    Args:
        attribute: an attribute of the symmetry's surface, as for `mirror`.
        symmetry: a symmetry of the surface.
        direction: "left_to_right" or "right_to_left": one side is copied to the other. "exchange": the sides are
            swapped. "average": both become their mean. Binary data, such as a selection, becomes the union, and marks
            the stronger one.
        options: options of the attribute's kind, as for `transfer`.

    Raises:
        MeshError: as for `mirror`, or the symmetry has no two sides, or such values have no mean.
    """
    if attribute.kind is Kind.WEIGHT:
        attribute = with_partners(attribute)
    other = mirror(attribute, symmetry, **options)
    own_share = own_share_of(attribute.domain, symmetry, direction)
    if attribute.kind is Kind.WEIGHT:
        return _mix_weights(attribute, other, own_share, symmetry.surface, options)
    own, theirs = np.asarray(attribute.values), np.asarray(other.values)
    share = own_share.reshape(-1, *[1] * (own.ndim - 1))
    if has_mean(attribute) and RULES[attribute.kind].mixable:
        values = share * own + (1 - share) * theirs
        return replace(other, values=values.astype(theirs.dtype))
    if direction != "average":
        return replace(other, values=np.where(share >= 0.5, own, theirs))
    if not has_mean(attribute):
        raise MeshError(
            "The values of '{name}' cannot be averaged: copy the left or the right side, or exchange them.",
            name=attribute.name,
        )
    return replace(other, values=np.maximum(own, theirs))


def has_mean(attribute: Attribute) -> bool:
    """Whether an attribute's values have a mean, or a substitute for it."""
    return RULES[attribute.kind].mirrorable


def asymmetry(attribute: Attribute, symmetry: SelfMap) -> Floats:
    """(count,) difference of each value from that on the other side; for weights the share in other groups.

    Labels are equal, with a difference of 0, or not, with 1.
    """
    if attribute.kind is Kind.WEIGHT:
        attribute = with_partners(attribute)
        difference = csr_array(mirror(attribute, symmetry).values - attribute.values)
        return np.asarray(abs(difference).sum(axis=1)) / 2
    own, theirs = np.asarray(attribute.values), np.asarray(mirror(attribute, symmetry).values)
    if has_mean(attribute) and RULES[attribute.kind].mixable:
        return np.asarray(np.linalg.norm((theirs - own).reshape(len(own), -1), axis=1))
    return np.asarray((theirs != own).reshape(len(own), -1).any(axis=1).astype(float))


def own_share_of(domain: Domain, symmetry: SelfMap, direction: Direction) -> Floats:
    """(count,) weight, from 0 to 1, of an element's own value relative to that from the other side.

    A face and its corners are on one side. Edges along the symmetry line belong to both sides and keep their values, so
    that a line there stays whole. Vertices without a face have no other side and keep theirs too.

    Raises:
        MeshError: the direction needs two sides, but the symmetry has none.
        ValueError: the direction is unknown.
    """
    if direction not in OWN_SHARES:
        raise ValueError(f"direction is {direction!r}: give one of {', '.join(OWN_SHARES)}.")
    if direction in ONE_WAY and not symmetry.has_sides:
        raise MeshError(
            "This symmetry has no left and right side: choose a reflection, or exchange or average the sides."
        )
    on_left, on_right = OWN_SHARES[direction]
    distance = mean_over_vertices(symmetry.distance, domain, symmetry.surface)
    share = np.where(distance > 0, on_left, np.where(distance < 0, on_right, (on_left + on_right) / 2))
    if domain is Domain.EDGE and direction in ONE_WAY:
        share[_along_line(symmetry)] = 1.0
    if domain is Domain.POINT:
        share[~_on_faces(symmetry.surface)] = 1.0
    return share


def with_partners(weights: Attribute, others: Collection[str] = ()) -> Attribute:
    """Add an empty group to weights, labelled by their groups, for every name whose other side is missing.

    Other existing names, such as those of bones, also count as partners, see `partner_of`.
    """
    missing = [name for name in _partner_names(weights.labels, others) if name not in weights.labels]
    if not missing:
        return weights
    values = csr_array(weights.values)
    values = csr_array(
        (values.data, values.indices, values.indptr), shape=(values.shape[0], values.shape[1] + len(missing))
    )
    return replace(weights, values=values, labels=(*weights.labels, *missing))


def flip_names(weights: Attribute) -> Attribute:
    """Exchange the groups of weights with those of the other side; the order of names stays."""
    weights = with_partners(weights)
    column = {name: i for i, name in enumerate(weights.labels)}
    partner = _partner_names(weights.labels)
    columns = [column[partner[name]] for name in weights.labels]
    return replace(weights, values=csr_array(csr_array(weights.values)[:, columns]))


def _partner_names(labels: Sequence[str], others: Collection[str] = ()) -> dict[str, str]:
    """The partners of names, and the partners of these, which may be among other names.

    The partner of a partner may be a third name: "arm lEFT" gives "arm right", which gives "arm left". So the
    first name is paired in both directions.
    """
    names, partner = {*labels, *others}, dict[str, str]()
    for name in labels:
        other = partner.setdefault(name, partner_of(name, names))
        partner.setdefault(other, name)
    return partner


def _on_faces(surface: Surface) -> Booleans:
    """(n,) which vertices belong to a face."""
    return np.isin(np.arange(len(surface.vertices)), surface.triangles)


def _along_line(symmetry: SelfMap) -> Booleans:
    """(e,) which edges are along the symmetry line: both ends are closer to it than half the edge's length."""
    surface = symmetry.surface
    start, end = surface.vertices[surface.edges].transpose(1, 0, 2)
    half = np.linalg.norm(end - start, axis=1) / 2
    return np.asarray(np.abs(symmetry.distance[surface.edges]).max(axis=1) < half)


def _mix_weights(
    own: Attribute, other: Attribute, own_share: Floats, surface: Surface, options: Mapping[str, Any]
) -> Attribute:
    """Mix two sets of weights at each vertex, with at most as many groups per vertex as the first one has."""
    weights = csr_array(own.values)
    mixed = diags_array(own_share) @ weights + diags_array(1 - own_share) @ other.values
    limit = max(1, int(np.diff(weights.indptr).max()))
    on_faces = _on_faces(surface)
    stay = SurfaceMap.from_vertices(np.where(on_faces, np.arange(len(on_faces)), surface.triangles[0, 0]), surface)
    limited = transfer(replace(other, values=csr_array(mixed)), stay, surface, surface, **{"limit": limit, **options})
    if on_faces.all():
        return limited
    loose = diags_array((~on_faces).astype(limited.values.dtype))
    whole = diags_array(on_faces.astype(limited.values.dtype)) @ limited.values + loose @ weights
    return replace(limited, values=csr_array(whole))
