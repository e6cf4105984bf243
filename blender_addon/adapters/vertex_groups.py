# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertex groups: deforming ones share each vertex among them, and locked ones stay unchanged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from bpy.types import Object
from scipy.sparse import csr_array, diags_array

from zoomout_core.arrays import Booleans
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import message, warning
from zoomout_core.transfer import Attribute
from zoomout_core.transfer.rigging.stretch import smooth_weights
from zoomout_core.transfer.rigging.weights import limit_weights, rename_groups, sum_to_one

from .. import mesh_data
from .adapter import Adapter, Remarks, TransferJob, TransferRequest


@dataclass
class WeightAdapter:
    """Vertex groups.

    Attributes:
        weights: their weights.
        sharing: options for groups that share a vertex among them and with locked groups, see `weights.mix_weights`.
        deforming: names of the groups that share a vertex, on the source and the target.
        present: the target's own weights, if they are needed for locked groups, blending or sources without weights.
        lacking: numbers of the sources that have no weights.
    """

    weights: Attribute
    sharing: dict[str, Any]
    deforming: set[str]
    present: Attribute | None
    lacking: tuple[int, ...]
    kind: str = "vertex_groups"

    @property
    def names(self) -> list[str]:
        return list(self.weights.labels)

    def transfer(self, job: TransferJob) -> None:
        transferred = job.transfer(self.weights, message("vertex groups"), **self.sharing)
        self.weights = job.blend_values(transferred, self.present, self.deforming, self.lacking)
        if self.weights is not transferred and job.settings.limit:
            limit_weights(self.weights.values, job.pair.target, self.sharing["normalised"], job.settings.limit)

    def smooth(self, target: Surface, chosen: Booleans, limit: int) -> None:
        """Fill in the weights of groups that share a vertex at some vertices (n,) from the others."""
        shared = np.asarray(self.sharing["normalised"], dtype=bool)
        columns = np.flatnonzero(shared)
        values = csr_array(self.weights.values)
        filled = smooth_weights(csr_array(values[:, columns]), target, chosen)
        if limit:
            limit_weights(filled, target, np.ones(len(columns), dtype=bool), limit)
        places = csr_array(
            (np.ones(len(columns)), (np.arange(len(columns)), columns)), shape=(len(columns), len(shared))
        )
        kept = values @ diags_array((~shared).astype(float))
        self.weights = replace(self.weights, values=csr_array(kept + filled @ places))

    def write(self, target: Object) -> None:
        mesh_data.write_weights(target, self.weights)


def collect(request: TransferRequest, remarks: Remarks) -> list[Adapter]:
    """The source's groups that are not locked on the target."""
    if "vertex_groups" not in request.data:
        return []
    target, settings = request.target, request.settings
    weights, lacking = mesh_data.read_joined_weights(request.sources)
    locked = mesh_data.locked_groups(target)
    names = {*weights.labels, *_bones_of_sources(request)}
    weights = rename_groups(weights, {name: settings.new_name(name, names) for name in weights.labels})
    open_columns = [i for i, name in enumerate(weights.labels) if name not in locked]
    closed = [name for name in weights.labels if name in locked]
    remarks.skipped |= dict.fromkeys(closed, "the target's vertex group is locked")
    if not open_columns:
        return []
    labels = tuple(weights.labels[i] for i in open_columns)
    _warn_of_names(request, weights, labels, remarks)
    deforming = _deforming_groups(weights, lacking, request, remarks)
    _warn_of_foreign_groups(request, deforming.intersection(labels), remarks)
    columns = [i for i, name in enumerate(weights.labels) if name in deforming]
    sharing = {
        "normalised": np.array([name in deforming for name in labels]),
        "sums": weights.values[:, columns].sum(axis=1),
    }
    if settings.limit:
        sharing["limit"] = settings.limit
    locked_deforming = locked & deforming
    present = None
    if locked_deforming or lacking or not request.replaces:
        present = mesh_data.read_weights(target, target.data)
    if locked_deforming and present:
        columns = [i for i, name in enumerate(present.labels) if name in locked_deforming]
        sharing["room"] = np.clip(1 - present.values[:, columns].sum(axis=1), 0, 1)
    chosen = replace(weights, values=weights.values[:, open_columns], labels=labels)
    return [WeightAdapter(chosen, sharing, deforming, present, lacking)]


def _warn_of_names(request: TransferRequest, weights: Attribute, labels: tuple[str, ...], remarks: Remarks) -> None:
    """Warn if groups have no weights, or the names of attributes of the target."""
    target = request.target
    if weights.values.nnz == 0:
        remarks.notes.append(
            warning(
                "After its modifiers, '{source}' has no weights, so its vertex groups are transferred empty.",
                source=request.source.name,
            )
        )
    hidden = [name for name in labels if name in target.data.attributes]
    if hidden:
        remarks.notes.append(
            warning(
                "'{target}' has attributes with the same names as vertex groups ({names}): rename them, "
                "because modifiers may confuse the two.",
                target=target.name,
                names=", ".join(hidden),
            )
        )


def _warn_of_foreign_groups(request: TransferRequest, deforming: set[str], remarks: Remarks) -> None:
    """Warn if a part of the target receives groups of bones that its armature lacks."""
    own_bones = mesh_data.deforming_bones(request.target)
    foreign = sorted(deforming - own_bones) if request.settings.mask_group and own_bones else []
    if foreign:
        remarks.notes.append(
            warning(
                "The armature of '{target}' has no bones for {count} vertex groups, such as '{group}', so they will "
                "not move within the mask: rename them with Rename Groups, or transfer without Vertex Groups.",
                target=request.target.name,
                count=len(foreign),
                group=foreign[0],
            )
        )


def _deforming_groups(
    weights: Attribute, lacking: tuple[int, ...], request: TransferRequest, remarks: Remarks
) -> set[str]:
    """The groups that share a vertex among them: those of bones, or of a skin without bones.

    Groups that no armature uses may be independent masks; but masks seldom sum to one on every vertex.
    """
    bones = _bones_of_sources(request)
    bones = {request.settings.new_name(name, bones) for name in bones}
    bones |= mesh_data.deforming_bones(request.target)
    if bones.intersection(weights.labels) or weights.values.nnz == 0:
        return bones
    weighted = [number not in lacking for number in range(len(request.sources))]
    rows = np.repeat(weighted, [len(source.mesh.vertices) for source in request.sources])
    skin = sum_to_one(weights.values[rows])
    name = request.source.name
    remarks.notes.append(
        warning(
            "No armature has bones named like the vertex groups of '{name}': they sum to one on "
            "every vertex, and were treated as bone weights.",
            name=name,
        )
        if skin
        else message(
            "No armature has bones named like the vertex groups of '{name}': they were treated as masks.", name=name
        )
    )
    return set(weights.labels) if skin else set()


def _bones_of_sources(request: TransferRequest) -> set[str]:
    """Names of the bones that deform the sources."""
    return set().union(*(mesh_data.deforming_bones(source.original) for source in request.sources))
