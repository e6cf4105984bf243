# SPDX-License-Identifier: GPL-3.0-or-later
"""USD stages, read by usd-core, which the extra `formats` installs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.gltf_structure import MAX_ELEMENTS
from zoomout_core.mesh.formats.opening import existing, outside
from zoomout_core.mesh.formats.polygons import Faces, Polygons, join, reverse_winding
from zoomout_core.runtime.input_files import OutsideError, beside

ENDINGS = (".usd", ".usda", ".usdc", ".usdz")
# Elements that each prim of an instance counts for, whatever it contains: that number takes a millisecond.
PRIM = 2000


def read_usd(path: Path) -> Polygons:
    """All meshes of a USD stage at its first time, one after the other, with their transforms applied.

    Raises:
        MeshError: it cannot be opened, it refers to files outside its folder, or instances multiply its meshes.
        ImportError: usd-core is not installed.
    """
    from pxr import Tf, Usd

    _check_layers(path)
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise MeshError(f"{path} could not be opened as USD: check that the file is complete.") from error
    for layer in stage.GetUsedLayers():  # also those that the search path led to
        place = layer.realPath.partition("[")[0]
        if place and not Path(os.path.realpath(place)).is_relative_to(os.path.realpath(path.parent)):
            raise outside(path, place)
    return join(_meshes(stage, path))


def _meshes(stage: Any, path: Path) -> Iterator[Faces]:
    """The visible meshes of a stage in world space, each with its outer side outwards.

    Raises:
        MeshError: instances multiply them.
    """
    from pxr import Usd, UsdGeom

    time = Usd.TimeCode(stage.GetStartTimeCode()) if stage.HasAuthoredTimeCodeRange() else Usd.TimeCode.Default()
    placed = UsdGeom.XformCache(time)
    max_elements, elements = max(MAX_ELEMENTS, path.stat().st_size), 0
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        elements += PRIM * prim.IsInstanceProxy()
        if elements > max_elements:
            raise MeshError(
                f"The instances of {path} have more than {max_elements} points in all: give it without them."
            )
        if not prim.IsA(UsdGeom.Mesh) or UsdGeom.Imageable(prim).ComputeVisibility(time) == "invisible":
            continue
        mesh = UsdGeom.Mesh(prim)
        points, corners, sizes = (
            np.array(attribute.Get(time) if attribute.Get(time) is not None else ())
            for attribute in (mesh.GetPointsAttr(), mesh.GetFaceVertexIndicesAttr(), mesh.GetFaceVertexCountsAttr())
        )
        elements += len(points) + len(corners)
        transform = np.array(placed.GetLocalToWorldTransform(prim))
        # Points are rows, so the transform is multiplied from the right.
        positions = points.reshape(-1, 3).astype(np.float64) @ transform[:3, :3] + transform[3, :3]
        turned = (np.linalg.det(transform[:3, :3]) < 0) != (mesh.GetOrientationAttr().Get(time) == "leftHanded")
        yield positions, reverse_winding(corners, sizes) if turned else corners, sizes


def _check_layers(path: Path) -> None:
    """Check that the layers of a stage are files in its folder, before they are opened."""
    from pxr import Sdf, Tf

    waiting, checked = [path], set()
    while waiting:
        layer = waiting.pop()
        if layer in checked or not layer.exists():
            continue
        checked.add(layer)
        try:
            opened = Sdf.Layer.FindOrOpen(str(existing(layer)))
        except Tf.ErrorException:
            continue  # it is reported when the stage is opened
        # A reference within the layer has no name.
        for name in filter(None, opened.GetCompositionAssetDependencies() if opened is not None else ()):
            try:
                waiting.append(beside(name, layer.parent))
            except OutsideError as error:
                raise outside(path, name) from error
