# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirror skin weights of a posed character to a side with more edges: ours compared with Blender's methods."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csr_array, hstack
from scipy.spatial import cKDTree

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.symmetry.mirror import flip_names, symmetrise
from zoomout_core.transfer import Attribute

POSES = 3


def weight_rows() -> list[dict[str, Any]]:
    """A row for each method to mirror weights from the left side to the right one, which has none.

    Error: the part of a vertex's weight in wrong groups, over all vertices of the right side; mean and 95th
    percentile over all poses, and the share of vertices with an error of a tenth or more.
    """
    from benchmarks.generate.lopsided import lopsided_characters  # only if Blender is installed to build them

    errors: dict[str, list[Floats]] = {}
    for character in lopsided_characters(POSES, seed=0):
        right = character.right
        truth = character.truth.values.toarray()[right]
        ways = {
            "zo.symmetrised": ours(character.surface, character.broken),
            "nearest to the mirrored position": by_position(character.surface, character.broken),
            "Blender, mirror by topology": character.by_topology,
            "Blender, mirror by position": character.by_position,
            "as they were": character.broken,
        }
        for name, weights in ways.items():
            values = in_order_of(character.truth.labels, weights).toarray()[right]
            errors.setdefault(name, []).append(np.abs(values - truth).sum(axis=1) / 2)
    return [
        {
            "weights mirrored by": name,
            "poses": len(found),
            "mean error": float(np.mean(np.concatenate(found))),
            "95th percentile": float(np.percentile(np.concatenate(found), 95)),
            "off by a tenth %": float(100 * (np.concatenate(found) > 0.1).mean()),
        }
        for name, found in errors.items()
    ]


def ours(surface: zo.Surface, weights: Attribute) -> Attribute:
    """Mirror the left side's weights by the surface's intrinsic symmetry."""
    return symmetrise(weights, zo.detect_symmetry(surface)[0], "left_to_right")


def by_position(surface: zo.Surface, weights: Attribute) -> Attribute:
    """Each vertex of the right side takes the weights of the vertex nearest to its mirrored position."""
    flipped = flip_names(weights)
    nearest = cKDTree(surface.vertices).query(surface.vertices * [-1, 1, 1])[1]
    right = surface.vertices[:, 0] < 0
    own, other = csr_array(in_order_of(flipped.labels, weights)).toarray(), flipped.values.toarray()[nearest]
    return Attribute(
        weights.name,
        weights.domain,
        weights.kind,
        csr_array(np.where(right[:, None], other, own)),
        flipped.labels,
    )


def in_order_of(labels: tuple[str, ...], weights: Attribute) -> csr_array:
    """The columns of weights in the order of labels; missing ones are zero."""
    column = {name: i for i, name in enumerate(weights.labels)}
    found = [csr_array(weights.values)[:, [column[name]]] if name in column else None for name in labels]
    empty = csr_array((weights.values.shape[0], 1))

    return csr_array(hstack([empty if part is None else part for part in found], format="csr"))
