# SPDX-License-Identifier: GPL-3.0-or-later
"""Custom normals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from bpy.types import Object

import zoomout_core as zo
from zoomout_core.messages import message
from zoomout_core.transfer import Attribute

from .. import mesh_data
from .adapter import Adapter, Remarks, TransferJob, TransferRequest

# Number of target vertices per face of the source above which the source's facets would show as streaks. A closed
# triangle mesh has half as many vertices as faces, so there are eight target faces per source face. The angles between
# facets shrink with the square root of the number of faces, so those of the target itself are about a third of the
# source's.
MUCH_FINER = 4


@dataclass
class NormalAdapter:
    """Custom normals of face corners.

    Attributes:
        normals: the source's in world space, after the transfer the target's in the space of its mesh.
        target: surface of the target's own mesh, at rest, for which normals are stored.
        present: the normals that it shows.
        custom: whether these are custom ones.
        alone: whether nothing else was requested, so that they are transferred to any target.
    """

    normals: Attribute
    target: zo.Surface
    present: Attribute
    custom: bool
    alone: bool
    omitted: bool = False
    kind: str = "custom_normals"

    @property
    def names(self) -> list[str]:
        return [] if self.omitted else [self.normals.name]

    def transfer(self, job: TransferJob) -> None:
        triangle = job.match.surface_map.triangle
        if not self.alone and len(triangle) >= MUCH_FINER * len(np.unique(triangle)):
            self.omitted = True
            job.remarks.skipped[message("custom normals")] = (
                "the target is much finer, and the source's facets would show as streaks; transfer only Custom "
                "Normals to get them anyway"
            )
            return
        if job.blend.mode == "missing":
            if self.custom:
                self.omitted = True
                job.remarks.skipped[message("custom normals")] = "the target has its own"
                return
            job = replace(job, blend=replace(job.blend, mode="mix"))
        transferred = job.transfer(self.normals, message("custom normals"), target=self.target)
        self.normals = job.blend_values(transferred, self.present)

    def write(self, target: Object) -> None:
        if not self.omitted:
            mesh_data.write_custom_normals(target.data, self.normals)


def collect(request: TransferRequest, remarks: Remarks) -> list[Adapter]:
    """The source's custom normals, if it has any and they are requested."""
    if "custom_normals" not in request.data:
        return []
    flat = [source.name for source, *_ in request.sources if mesh_data.is_flat(source)]
    if flat:
        remarks.skipped[message("custom normals")] = message(
            "'{name}' has a scale of zero, so its normals have no direction", name=flat[0]
        )
        return []
    normals = mesh_data.read_joined_normals(request.sources)
    if normals is None:
        return []
    mesh = request.target.data
    present, custom = mesh_data.read_own_normals(mesh), mesh.has_custom_normals
    alone = set(request.data) == {"custom_normals"}
    return [NormalAdapter(normals, mesh_data.read_surface_at_rest(request.target), present, custom, alone)]
