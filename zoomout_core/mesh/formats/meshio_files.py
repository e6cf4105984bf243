# SPDX-License-Identifier: GPL-3.0-or-later
"""Formats of simulations, read by meshio, which the extra `formats` installs."""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.opening import existing, file_bytes, outside
from zoomout_core.mesh.formats.polygons import Polygons, concatenate, starts
from zoomout_core.mesh.formats.text_tables import text_lines
from zoomout_core.runtime.input_files import ExpansionError, OutsideError, beside, max_bytes

ENDINGS = (".bdf", ".inp", ".mesh", ".meshb", ".msh", ".nas", ".su2", ".ugrid", ".vol", ".vtk", ".vtu", ".xdmf")
# Meshio's cell types that are faces, and their numbers of corners; cells of higher order list their corners first.
CELLS = {"triangle": 3, "triangle6": 3, "triangle7": 3, "quad": 4, "quad8": 4, "quad9": 4}


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
        # It prints its complaints, which would spoil a command's output, and then exits like its own command.
        with _bounded_decompression(path), redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            mesh = meshio.read(path)
    except SystemExit as error:
        raise ValueError("meshio could not read it") from error
    return faces_of_meshio(mesh)


def faces_of_meshio(mesh: Any) -> Polygons:
    """The faces of a `meshio.Mesh`, without those of solid cells."""
    points = np.asarray(mesh.points, dtype=np.float64)
    positions = np.column_stack([points, np.zeros((len(points), 3 - points.shape[1]))])
    faces = [block.data[:, : CELLS[block.type]] for block in mesh.cells if block.type in CELLS]
    sizes = [np.full(len(each), each.shape[1]) for each in faces]
    polygons = [face for block in mesh.cells if block.type.startswith("polygon") for face in block.data]
    corners = [*(each.ravel() for each in faces), *map(np.asarray, polygons)]
    return positions, concatenate(corners), starts([*sizes, np.array([len(face) for face in polygons])])


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
        self._decompressor, self._left = decompressor, max_bytes(path.stat().st_size)

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
