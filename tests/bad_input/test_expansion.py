# SPDX-License-Identifier: GPL-3.0-or-later
"""Compressed files expand in bounds: archives of XML, stored arrays, and the blocks of VTK's format."""

from __future__ import annotations

import io
import zipfile
import zlib
from base64 import b64encode
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from test_bad_maps import SURFACE, WHOLE, stating

import zoomout_core as zo
from zoomout_core.mesh.errors import MeshError
from zoomout_core.runtime.array_files import ArrayFileError, read_arrays
from zoomout_core.runtime.input_files import ALWAYS_ALLOWED, ExpansionError, check_expansion, max_bytes

MODEL = '<model xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources><object id="1"><mesh>'
VERTEX, MEGABYTE = '<vertex x="0" y="0" z="0"/>', 1 << 20


def archive(method: int = zipfile.ZIP_DEFLATED, **members: bytes) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", method) as made:
        for name, member in members.items():
            made.writestr(name, member)
    return content.getvalue()


def stating_less(content: bytes) -> bytes:
    """An archive whose entries state a size of 100 bytes, whatever their content takes."""
    edited = bytearray(content)
    for mark, at in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        start = edited.find(mark)
        edited[start + at : start + at + 4] = (100).to_bytes(4, "little")
    return bytes(edited)


BOMBS = {
    "a model of vertices": lambda: archive(**{"3D/3dmodel.model": (MODEL + VERTEX * 700_000).encode()}),
    "a model of blanks": lambda: archive(**{"3D/3dmodel.model": MODEL.encode() + b" " * (20 * MEGABYTE)}),
    "a member beside the model": lambda: archive(**{"3D/3dmodel.model": b"<model/>", "other": bytes(20 * MEGABYTE)}),
    "many members": lambda: archive(**{f"{number}.model": bytes(MEGABYTE) for number in range(20)}),
    "another method": lambda: archive(zipfile.ZIP_BZIP2, **{"3D/3dmodel.model": bytes(20 * MEGABYTE)}),
    "a third method": lambda: archive(zipfile.ZIP_LZMA, **{"3D/3dmodel.model": bytes(10 * MEGABYTE)}),
    "a size that is not its own": lambda: stating_less(archive(**{"3D/3dmodel.model": bytes(20 * MEGABYTE)})),
    "no archive": lambda: b"PK\x03\x04",
}


@pytest.mark.parametrize("ending", [".3mf", ".zae", ".3dxml"])
@pytest.mark.parametrize("name", BOMBS)
def test_mesh_archive_bombs_are_refused(name: str, ending: str, tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    path = tmp_path / f"bomb{ending}"
    path.write_bytes(BOMBS[name]())
    start = process_time()
    with pytest.raises((MeshError, ImportError), match=r"bomb"):
        zo.read_surface(path)
    assert process_time() - start < 2


@pytest.mark.parametrize("ending", [".zip", ".gz", ".bz2", ".tar.gz", ".tar.bz2", ".kmz", ".xz", ".obj.gz", ".binvox"])
def test_archives_without_mesh_files_are_refused(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    path.write_bytes(archive(**{"a.obj": b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n"}))
    with pytest.raises(MeshError, match=r"format of .* is not supported: convert it"):
        zo.read_surface(path)


@pytest.mark.parametrize("copies", [1, 20])
def test_array_file_bombs_are_refused(copies: int, tmp_path: Path) -> None:
    """The header states the size that the array has."""
    zeros = stating(f"({40 * MEGABYTE // copies // 8},)", bytes(40 * MEGABYTE // copies))
    path = tmp_path / "map.npz"
    path.write_bytes(archive(**{f"array {number}.npy": zeros for number in range(copies)}))
    with pytest.raises(ArrayFileError, match=r"it would expand to .* are allowed for its size"):
        read_arrays(path)


def test_ordinary_maps_stay_within_the_bound(tmp_path: Path) -> None:
    for vertex in (np.zeros(MEGABYTE // 2), np.arange(MEGABYTE // 2) % 100):
        zo.SurfaceMap.from_vertices(vertex.astype(int), SURFACE).save(tmp_path / "map.npz")
        assert len(zo.SurfaceMap.load(tmp_path / "map.npz", SURFACE).triangle) == MEGABYTE // 2
    np.savez_compressed(tmp_path / "map.npz", **WHOLE)
    assert zo.SurfaceMap.load(tmp_path / "map.npz", SURFACE)


def test_expansion_bound_grows_with_archive_size(tmp_path: Path) -> None:
    assert max_bytes(0) == max_bytes(ALWAYS_ALLOWED // 100) == ALWAYS_ALLOWED
    assert max_bytes(MEGABYTE) == 100 * MEGABYTE
    assert max_bytes(1 << 40) == 1 << 31
    with zipfile.ZipFile(io.BytesIO(archive(a=bytes(MEGABYTE)))) as made:
        check_expansion(made)
        with pytest.raises(ExpansionError, match="it would expand to 1048576 bytes, and 1000 are allowed"):
            check_expansion(made, expansion=0, allowed=1000)


def vtu(points: bytes, compressor: str, packed: bytes) -> bytes:
    """A file of VTK's format with compressed points that state the size of `points`."""
    header = np.array([1, len(points), 0, len(packed)], "<u4").tobytes()
    data = (b64encode(header) + b64encode(packed)).decode()
    arrays = {"connectivity": ("Int64", "0 1 2"), "offsets": ("Int64", "3"), "types": ("UInt8", "5")}
    cells = "".join(
        f'<DataArray type="{kind}" Name="{name}" format="ascii">{text}</DataArray>'
        for name, (kind, text) in arrays.items()
    )
    return f"""<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" header_type="UInt32"
compressor="{compressor}"><UnstructuredGrid><Piece NumberOfPoints="3" NumberOfCells="1"><Points>
<DataArray type="Float64" NumberOfComponents="3" format="binary">{data}</DataArray></Points>
<Cells>{cells}</Cells></Piece></UnstructuredGrid></VTKFile>""".encode()


@pytest.mark.parametrize("name", ["zlib", "lzma"])
def test_vtk_block_bombs_are_refused(name: str, tmp_path: Path) -> None:
    pytest.importorskip("meshio")
    import lzma

    compress, word = {
        "zlib": (zlib.compress, "vtkZLibDataCompressor"),
        "lzma": (lzma.compress, "vtkLZMADataCompressor"),
    }[name]
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], "<f8").tobytes()
    path = tmp_path / "a.vtu"
    path.write_bytes(vtu(points, word, compress(points)))
    assert zo.read_surface(path).vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    for stated in (points, bytes(40 * MEGABYTE)):
        path.write_bytes(vtu(stated, word, compress(bytes(40 * MEGABYTE))))
        with pytest.raises(MeshError, match="its data would expand too far for its size"):
            zo.read_surface(path)
