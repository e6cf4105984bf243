# SPDX-License-Identifier: GPL-3.0-or-later
"""Formats of other programs: USD by usd-core, simulation formats by meshio; the extra `formats` installs both."""

from __future__ import annotations

import lzma
import os
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.formats.gltf_structure import MAX_ELEMENTS
from zoomout_core.mesh.formats.opening import existing, file_bytes, outside
from zoomout_core.mesh.formats.text_tables import text_lines
from zoomout_core.mesh.surface import MeshError
from zoomout_core.runtime.input_files import ExpansionError, OutsideError, beside, most_bytes

# Positions (n, 3), the vertex of each corner (c,), and the number of corners of each face (f,).
Faces = tuple[Floats, Integers, Integers]
# The same with the first corner of each face, and the number of corners (f + 1,).
Polygons = tuple[Floats, Integers, Integers]
# Meshio's cell types that are faces, and their numbers of corners; cells of higher order list their corners first.
CELLS = {"triangle": 3, "triangle6": 3, "triangle7": 3, "quad": 4, "quad8": 4, "quad9": 4}

# Elements that each prim of an instance counts for, whatever it contains: that number takes a millisecond.
PRIM = 2000


def read_usd(path: Path) -> Polygons:
    """All meshes of a USD stage at its first time, one after the other, with their transforms applied.

    Raises:
        MeshError: it cannot be opened, it refers to files outside its folder, or instances multiply its meshes.
        ImportError: usd-core is not installed.
    """
    from pxr import Tf, Usd, UsdGeom

    _check_layers(path)
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise MeshError(f"{path} could not be opened as USD: check that the file is complete.") from error
    time = Usd.TimeCode(stage.GetStartTimeCode()) if stage.HasAuthoredTimeCodeRange() else Usd.TimeCode.Default()
    placed = UsdGeom.XformCache(time)

    for layer in stage.GetUsedLayers():  # also those that the search path led to
        place = layer.realPath.partition("[")[0]
        if place and not Path(os.path.realpath(place)).is_relative_to(os.path.realpath(path.parent)):
            raise outside(path, place)
    most = max(MAX_ELEMENTS, path.stat().st_size)

    def parts() -> Iterator[Faces]:
        seen = 0
        for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
            seen += PRIM * prim.IsInstanceProxy()
            if seen > most:
                raise MeshError(f"The instances of {path} have more than {most} points in all: give it without them.")
            if not prim.IsA(UsdGeom.Mesh) or UsdGeom.Imageable(prim).ComputeVisibility(time) == "invisible":
                continue
            mesh = UsdGeom.Mesh(prim)
            points, corners, sizes = (
                np.array(attribute.Get(time) if attribute.Get(time) is not None else ())
                for attribute in (mesh.GetPointsAttr(), mesh.GetFaceVertexIndicesAttr(), mesh.GetFaceVertexCountsAttr())
            )
            seen += len(points) + len(corners)
            transform = np.array(placed.GetLocalToWorldTransform(prim))
            # Points are rows, so the transform is multiplied from the right.
            positions = points.reshape(-1, 3).astype(np.float64) @ transform[:3, :3] + transform[3, :3]
            turned = (np.linalg.det(transform[:3, :3]) < 0) != (mesh.GetOrientationAttr().Get(time) == "leftHanded")
            yield positions, _reverse_winding(corners, sizes) if turned else corners, sizes

    return join(parts())


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


def read_with_meshio(path: Path) -> Polygons:
    """The faces of a file that meshio reads; surfaces of solid cells are not extracted.

    Raises:
        ValueError: it is damaged.
        MeshError: it refers to files outside its folder.
        ImportError: meshio is not installed.
    """
    import meshio

    _check_files(path)
    try:
        # It prints what it misses, which would spoil the output of a command, and exits as if from its own one.
        with _bounded_decompression(path), redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            mesh = meshio.read(path)
    except SystemExit as error:
        raise ValueError("meshio could not read it") from error
    return faces_of_meshio(mesh)


def faces_of_meshio(mesh: Any) -> Faces:
    """The faces of a `meshio.Mesh`, without those of solid cells."""
    points = np.asarray(mesh.points, dtype=np.float64)
    positions = np.column_stack([points, np.zeros((len(points), 3 - points.shape[1]))])
    faces = [block.data[:, : CELLS[block.type]] for block in mesh.cells if block.type in CELLS]
    sizes = [np.full(len(each), each.shape[1]) for each in faces]
    polygons = [face for block in mesh.cells if block.type.startswith("polygon") for face in block.data]
    corners = [*(each.ravel() for each in faces), *map(np.asarray, polygons)]
    return positions, _flat(corners), _starts([*sizes, np.array([len(face) for face in polygons])])


@contextmanager
def _bounded_decompression(path: Path) -> Iterator[None]:
    """Limit the decompression of meshio, which has no limit itself, while it reads a file."""
    from meshio.vtu import _vtu

    before = _vtu.zlib, _vtu.lzma
    _vtu.zlib, _vtu.lzma = _Bounded(zlib.decompressobj, path), _Bounded(lzma.LZMADecompressor, path)
    try:
        yield
    finally:
        _vtu.zlib, _vtu.lzma = before


class _Bounded:
    """Replaces a compression module of meshio: decompresses no more than a file of some size may contain.

    Args:
        decompressor: makes an object that decompresses up to a number of bytes.
        path: the file.
    """

    def __init__(self, decompressor: Callable[[], Any], path: Path) -> None:
        self._decompressor, self._left = decompressor, most_bytes(path.stat().st_size)

    def decompress(self, content: bytes) -> bytes:
        found = bytes(self._decompressor().decompress(content, self._left + 1))
        self._left -= len(found)
        if self._left < 0:
            raise ExpansionError("its data would expand too far for its size")
        return found


def _check_files(path: Path) -> None:
    """Check the files that an Abaqus or XDMF file names, which meshio would open anywhere."""
    ending = path.suffix.lower()
    if ending == ".inp":
        words = (line.partition(",")[0].strip().replace("*", "").upper() for line in text_lines(file_bytes(path)))
        if "INCLUDE" in words:
            raise MeshError(f"{path} includes other files, which are not read: merge them into one file.")
    elif ending == ".xdmf":
        for item in ElementTree.fromstring(file_bytes(path)).iter("DataItem"):
            if item.get("Format") == "Binary":
                raise MeshError(f"{path} has its data in binary files, which are not read: export it as HDF or XML.")
            if item.get("Format") == "HDF":
                name = (item.text or "").strip().partition(":")[0]
                try:
                    file_bytes(existing(beside(name, path.parent)))
                except OutsideError as error:
                    raise outside(path, name) from error


READERS: dict[str, Callable[[Path], Polygons]] = {
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), read_usd),
    **dict.fromkeys(
        (".bdf", ".inp", ".mesh", ".meshb", ".msh", ".nas", ".su2", ".ugrid", ".vol", ".vtk", ".vtu", ".xdmf"),
        read_with_meshio,
    ),
}


def _reverse_winding(corners: Integers, sizes: Integers) -> Integers:
    """The corners of faces in reverse order."""
    start = np.cumsum(sizes) - sizes
    place = np.arange(len(corners)) - np.repeat(start, sizes)
    return np.asarray(corners[np.repeat(start + sizes - 1, sizes) - place])


def join(parts: Iterator[Faces]) -> Polygons:
    """Join meshes into one."""
    found = list(parts)
    count = np.cumsum([0, *(len(points) for points, _, _ in found)])
    corners = [each + first for (_, each, _), first in zip(found, count, strict=False)]
    points = np.concatenate([np.zeros((0, 3)), *(each for each, _, _ in found)])
    return points, _flat(corners), _starts([sizes for _, _, sizes in found])


def _starts(sizes: list[Any]) -> Integers:
    return np.concatenate([[0], np.cumsum(_flat(sizes))])


def _flat(arrays: list[Any]) -> Integers:
    return np.concatenate([np.zeros(0, dtype=np.int64), *arrays]).astype(np.int64)
