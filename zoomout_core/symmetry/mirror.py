# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes across a symmetry: taken to the other side, made alike on both, and how far they are from that.

The other side of a vertex is its image under the symmetry, so values go there as they go from a source to a target, by
the same rules (`zoomout_core.transfer`). What has a side in its name, such as the weights of Arm.L, changes places
with its counterpart.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy.sparse import csr_array, diags_array

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import MeshError, Surface
from zoomout_core.symmetry.flip_name import counterpart_of
from zoomout_core.symmetry.self_map import SelfMap
from zoomout_core.transfer import RULES, Attribute, Domain, Kind, transfer

# Which side gives its values to the other one, or whether both change places or get what lies half way between the two.
Direction: TypeAlias = Literal["left_to_right", "right_to_left", "exchange", "average"]
# For each of them what an element's own value counts, against that from the other side: on the left, and on the right.
OWN_SHARES = {"left_to_right": (1.0, 0.0), "right_to_left": (0.0, 1.0), "exchange": (0.0, 0.0), "average": (0.5, 0.5)}
# Those that need two sides, of which one gives and the other one receives.
ONE_WAY = ("left_to_right", "right_to_left")


def mirror(attribute: Attribute, symmetry: SelfMap, **options: Any) -> Attribute:
    """An attribute as it would be with both sides exchanged.

    Args:
        attribute: of the symmetry's surface. Weights have the names of their groups as labels; a group without a
            counterpart gets one.
        symmetry: of the surface.
        options: of the attribute's kind, as for `transfer`.

    Raises:
        MeshError: the attribute does not fit the surface, or its kind cannot be transferred.
    """
    if attribute.kind is Kind.WEIGHT:
        attribute = flip_names(attribute)
    return transfer(attribute, symmetry, symmetry.surface, symmetry.surface, **options)


def symmetrise(
    attribute: Attribute, symmetry: SelfMap, direction: Direction = "left_to_right", **options: Any
) -> Attribute:
    """An attribute that is the same on both sides, or whose sides have changed places.

    Args:
        attribute: of the symmetry's surface; as for `mirror`.
        symmetry: of the surface.
        direction: "left_to_right" or "right_to_left": the one side stays as it is, and the other becomes like it.
            "exchange": each becomes what the other was. "average": both become their mean; of what is there or not,
            such as a selection, what either side has, and of marks the stronger ones.
        options: of the attribute's kind, as for `transfer`.

    Raises:
        MeshError: as for `mirror`, or there are no two sides, or no mean of such values.
    """
    if attribute.kind is Kind.WEIGHT:
        attribute = with_counterparts(attribute)
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
    """Whether both sides can get the mean of an attribute's values, or what stands in for it."""
    return RULES[attribute.kind].mirrorable


def asymmetry(attribute: Attribute, symmetry: SelfMap) -> Floats:
    """(count,) how far each value is from that on the other side; of weights the part that lies in other groups.

    Args:
        attribute: of the symmetry's surface, of numbers or weights, or labels that are alike or not.
        symmetry: of the surface.
    """
    if attribute.kind is Kind.WEIGHT:
        attribute = with_counterparts(attribute)
        difference = csr_array(mirror(attribute, symmetry).values - attribute.values)
        return np.asarray(abs(difference).sum(axis=1)) / 2
    own, theirs = np.asarray(attribute.values), np.asarray(mirror(attribute, symmetry).values)
    if has_mean(attribute) and RULES[attribute.kind].mixable:
        return np.asarray(np.linalg.norm((theirs - own).reshape(len(own), -1), axis=1))
    return np.asarray((theirs != own).reshape(len(own), -1).any(axis=1).astype(float))


def distance_of(domain: Domain, symmetry: SelfMap) -> Floats:
    """(count,) signed distance of elements from the symmetry line; a face, with its corners, lies on one side."""
    surface, distance = symmetry.surface, symmetry.distance
    if domain is Domain.POINT:
        return distance
    if domain is Domain.EDGE:
        return distance[surface.edges].mean(axis=1)
    of_face = np.add.reduceat(distance[surface.corner_vertex], surface.face_start[:-1]) / np.diff(surface.face_start)
    return of_face[surface.corner_face] if domain is Domain.CORNER else of_face


def own_share_of(domain: Domain, symmetry: SelfMap, direction: Direction) -> Floats:
    """(count,) from 0 to 1: weight of an element's own value against that from the other side.

    Edges along the symmetry line are those of both sides, and keep theirs: a line that lies there stays whole. So do
    vertices that belong to no face, which have no other side.

    Raises:
        MeshError: there are no two sides of which one could give.
        ValueError: there is no such direction.
    """
    if direction not in OWN_SHARES:
        raise ValueError(f"direction is {direction!r}: give one of {', '.join(OWN_SHARES)}.")
    if direction in ONE_WAY and not symmetry.has_sides:
        raise MeshError(
            "This symmetry has no left and right side: choose a reflection, or exchange or average the sides."
        )
    on_left, on_right = OWN_SHARES[direction]
    distance = distance_of(domain, symmetry)
    share = np.where(distance > 0, on_left, np.where(distance < 0, on_right, (on_left + on_right) / 2))
    if domain is Domain.EDGE and direction in ONE_WAY:
        share[_along_line(symmetry)] = 1.0
    if domain is Domain.POINT:
        share[~_on_faces(symmetry.surface)] = 1.0
    return share


def with_counterparts(weights: Attribute, others: Collection[str] = ()) -> Attribute:
    """Weights with an empty group for every name whose other side is missing.

    Args:
        weights: labelled by their groups' names.
        others: names that there are besides, such as those of bones: see `counterpart_of`.
    """
    missing = [name for name in _counterpart_names(weights.labels, others) if name not in weights.labels]
    if not missing:
        return weights
    values = csr_array(weights.values)
    values = csr_array(
        (values.data, values.indices, values.indptr), shape=(values.shape[0], values.shape[1] + len(missing))
    )
    return replace(weights, values=values, labels=(*weights.labels, *missing))


def flip_names(weights: Attribute) -> Attribute:
    """Weights whose groups have changed places with those of the other side, in the same order of names."""
    weights = with_counterparts(weights)
    column = {name: i for i, name in enumerate(weights.labels)}
    counterpart = _counterpart_names(weights.labels)
    columns = [column[counterpart[name]] for name in weights.labels]
    return replace(weights, values=csr_array(csr_array(weights.values)[:, columns]))


def _counterpart_names(labels: Sequence[str], others: Collection[str] = ()) -> dict[str, str]:
    """The counterparts of names, and of these counterparts; they may be among other names.

    The counterpart of a counterpart may be a third name: "arm right" is that of "arm lEFT", and has "arm left" itself.
    So the first of them is paired both ways.
    """
    names, counterpart = {*labels, *others}, dict[str, str]()
    for name in labels:
        other = counterpart.setdefault(name, counterpart_of(name, names))
        counterpart.setdefault(other, name)
    return counterpart


def _on_faces(surface: Surface) -> Booleans:
    """(n,) which vertices belong to a face."""
    found = np.zeros(len(surface.vertices), dtype=bool)
    found[surface.triangles] = True
    return found


def _along_line(symmetry: SelfMap) -> Booleans:
    """(e,) which edges lie along the symmetry line: both ends are nearer to it than half the edge's length."""
    surface = symmetry.surface
    start, end = surface.vertices[surface.edges].transpose(1, 0, 2)
    half = np.linalg.norm(end - start, axis=1) / 2
    return np.asarray(np.abs(symmetry.distance[surface.edges]).max(axis=1) < half)


def _mix_weights(
    own: Attribute, other: Attribute, own_share: Floats, surface: Surface, options: Mapping[str, Any]
) -> Attribute:
    """Two sets of weights mixed vertex by vertex, within the limit of groups a vertex that the first keeps."""
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
