# SPDX-License-Identifier: GPL-3.0-or-later
"""Read the rest pose, bones, weights and animation of sources with armatures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bpy.types import Context
from scipy.sparse import csc_array, csr_array

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.transfer import Attribute

from ... import mesh_data
from ...mesh_data import Bones, ObjectPair
from ...scene.pair import evaluated_sources, find_mesh


@dataclass(frozen=True, eq=False)
class Rigged:
    """Sources that armatures deform.

    Attributes:
        rest: their surface at rest, in world space.
        bones: bones of the first source's armatures.
        weights: (n_s, b) weights of these bones.
        poses: (f, b, 3, 4) transforms of these bones in frames of the armatures' animation.
        preserves_volume: whether the armatures preserve volume.
    """

    rest: zo.Surface
    bones: Bones
    weights: csr_array
    poses: Floats
    preserves_volume: bool


def read_rigged(context: Context, pair: ObjectPair) -> Rigged:
    """The sources at rest, with the weights of the first one's bones."""
    rest, bones, weights = read_rest(context, pair)
    source = find_mesh(context, pair.source_name)
    return Rigged(rest, bones, weights, mesh_data.read_animation(source), mesh_data.preserves_volume(source))


def read_rest(context: Context, pair: ObjectPair) -> tuple[zo.Surface, Bones, csr_array]:
    """The sources at rest, the bones of the first one's armatures, and their (n_s, b) weights.

    Raises:
        MeshError: the undeformed vertices cannot be read.
    """
    with evaluated_sources(context, pair) as sources:
        weights, _ = mesh_data.read_joined_weights(sources)
    bones = mesh_data.read_bones(find_mesh(context, pair.source_name))
    rest = pair.source.with_vertices(read_sources_at_rest(context, pair))
    return rest, bones, weights_of_bones([weights], bones)


def read_sources_at_rest(context: Context, pair: ObjectPair) -> Floats:
    """(n_s, 3) undeformed vertices of the sources, in world space.

    Raises:
        MeshError: the undeformed vertices cannot be read.
    """
    with evaluated_sources(context, pair) as sources:
        faces = [mesh_data.read_faces(source.mesh) for source in sources]
    rest = []
    for name, each in zip(pair.source_names, faces, strict=True):
        source = find_mesh(context, name)
        positions = mesh_data.read_undeformed_positions(source, each)
        if positions is None:
            raise zo.MeshError(
                "Modifiers of '{name}' change its faces when the armature is off, so its rest pose "
                "cannot be read: disable those that add or remove vertices, and match again.",
                name=name,
            )
        rest.append(mesh_data.positions_in_world(source, positions))
    return np.concatenate(rest)


def weights_of_target(context: Context, pair: ObjectPair, bones: Bones, weights: Attribute) -> csr_array:
    """(n_t, b) bone weights that the target will have: transferred ones, or otherwise its own."""
    target = find_mesh(context, pair.target_name)
    return weights_of_bones([weights, mesh_data.read_weights(target, target.data)], bones)


def weights_of_bones(groups: list[Attribute], bones: Bones) -> csr_array:
    """(n, b) weights of bones, each from the first attribute with a group of its name."""
    count = groups[0].values.shape[0]
    entries: list[tuple[Floats, np.ndarray, np.ndarray]] = []
    for number, name in enumerate(bones.names):
        having = next((each for each in groups if name in each.labels), None)
        if having is not None:
            column = csc_array(having.values[:, [having.labels.index(name)]])
            entries.append((column.data.astype(np.float64), column.indices, np.full(column.nnz, number)))
    data, row, column_number = (np.concatenate(part) for part in zip(*entries, strict=True))
    return csr_array((data, (row, column_number)), shape=(count, len(bones.names)))
