# SPDX-License-Identifier: GPL-3.0-or-later
"""Map files that are damaged, of another kind, or malicious: one sentence, at once, in little memory."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from creatures import creature
from interfaces import assert_refused, run

import zoomout_core as zo
from zoomout_core.cli import main
from zoomout_core.maps.known_match import KnownMatch
from zoomout_core.maps.surface_map import read_vertex_map
from zoomout_core.mesh.errors import MeshError
from zoomout_core.runtime.array_files import ArrayFileError, read_arrays
from zoomout_core.runtime.object_files import CHECKSUM

SURFACE = creature(100).surface
COUNT = len(SURFACE.triangles)
WHOLE = {
    "triangle": np.arange(100) % COUNT,
    "barycentric": np.tile([0.5, 0.25, 0.25], (100, 1)),
    "vertex": np.arange(100),
}


def of(**changed: np.ndarray) -> bytes:
    """The content of a file with some arrays changed."""
    content = io.BytesIO()
    np.savez(content, **(WHOLE | changed))
    return content.getvalue()


def packed(**members: bytes) -> bytes:
    """The content of a file with the given members."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, member in members.items():
            archive.writestr(f"{name}.npy", member)
    return content.getvalue()


def stating(shape: str, data: bytes = b"", kind: str = "<i8") -> bytes:
    """An array file whose header has the given shape."""
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + data


def flipped(every: int) -> bytes:
    content = bytearray(of())
    for place in range(40, len(content), every):
        content[place] ^= 0x5A
    return bytes(content)


HOSTILE: dict[str, Callable[[], bytes]] = {
    "nothing": lambda: b"",
    "no zip": lambda: b"these are no arrays",
    "cut off": lambda: of()[:700],
    "bits flipped here and there": lambda: flipped(97),
    "bits flipped everywhere": lambda: flipped(3),
    "petabytes stated": lambda: packed(triangle=stating("(99999999999999,)"), barycentric=b"", vertex=b""),
    "petabytes stated of both": lambda: packed(**dict.fromkeys(WHOLE, stating("(999999999999, 3)"))),
    "a negative size": lambda: packed(**dict.fromkeys(WHOLE, stating("(-5,)", b"x" * 40))),
    "a header that is code": lambda: packed(**dict.fromkeys(WHOLE, stating("__import__('os').getcwd()"))),
    "nested brackets": lambda: packed(**dict.fromkeys(WHOLE, stating("(" * 3000 + ")" * 3000))),
    "objects": lambda: packed(**dict.fromkeys(WHOLE, stating("(1,)", b"cos\nsystem\n.", "|O"))),
    "an unknown version": lambda: packed(**dict.fromkeys(WHOLE, b"\x93NUMPY\x09\x00")),
    "members that are no arrays": lambda: packed(**dict.fromkeys(WHOLE, b"hello")),
    "no members": lambda: packed(),
    "other arrays": lambda: packed(side=stating("(0,)")),
}
WRONG: dict[str, Callable[[], bytes]] = {
    "negative triangles": lambda: of(triangle=WHOLE["triangle"] - 1, vertex=WHOLE["vertex"] - 1),
    "triangles of a larger mesh": lambda: of(triangle=WHOLE["triangle"] + COUNT, vertex=WHOLE["vertex"].astype(str)),
    "fractions": lambda: of(triangle=WHOLE["triangle"] + 0.5, vertex=WHOLE["vertex"] + 0.5),
    "one number": lambda: of(triangle=np.array(3), vertex=np.array(3)),
    "a table": lambda: of(triangle=np.zeros((4, 4), dtype=int), vertex=np.zeros((4, 4), dtype=int)),
    "a functional map in place of vertices": lambda: of(triangle=np.eye(9), vertex=np.eye(9)),
    "coordinates that are not numbers": lambda: of(barycentric=np.full((100, 3), np.nan), vertex=np.zeros(100)),
    "coordinates of other points": lambda: of(barycentric=np.ones((7, 3)) / 3, vertex=np.zeros(0)),
}


@pytest.mark.parametrize("name", [*HOSTILE, *WRONG])
def test_damaged_map_is_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    path = tmp_path / "map.npz"
    path.write_bytes((HOSTILE | WRONG)[name]())
    for read in (lambda: zo.SurfaceMap.load(path, SURFACE), lambda: read_vertex_map(path)):
        start = process_time()
        with pytest.raises(MeshError, match=r"map\.npz .*\.$"):
            read()
        assert process_time() - start < 10


@pytest.mark.slow
def test_decompression_bomb_takes_no_memory(tmp_path: Path) -> None:
    """A megabyte that decompresses to a gigabyte, and a small file above the limit."""
    path = tmp_path / "map.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("triangle.npy", "w") as member:
        member.write(stating("(5,)"))
        for _ in range(64):
            member.write(bytes(1 << 24))
    tracemalloc.start()
    with pytest.raises(MeshError, match="would expand to 1073741892 bytes"):
        zo.SurfaceMap.load(path, SURFACE)
    assert tracemalloc.get_traced_memory()[1] < 1 << 22
    tracemalloc.stop()
    with pytest.raises(ArrayFileError, match="its arrays take"):
        read_arrays(path, max_bytes=1 << 20)


def test_commands_refuse_damaged_maps(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    for name in ("petabytes stated of both", "bits flipped everywhere", "negative triangles"):
        path.write_bytes((HOSTILE | WRONG)[name]())
        for option in ("--initial", "--earlier-map"):
            assert_refused(
                run(main, "match", *meshes, "-o", tmp_path / "out.npz", option, path), "bad.npz contains no map"
            )
        assert_refused(run(main, "evaluate", path, *meshes), "bad.npz")
    assert not (tmp_path / "out.npz").exists()


def test_map_is_read_in_any_memory_order(tmp_path: Path) -> None:
    path = tmp_path / "map.npz"
    np.savez(path, triangle=WHOLE["triangle"].astype(">i4"), barycentric=np.asfortranarray(WHOLE["barycentric"]))
    loaded = zo.SurfaceMap.load(path, SURFACE)
    np.testing.assert_array_equal(loaded.triangle, WHOLE["triangle"])
    np.testing.assert_array_equal(loaded.barycentric, WHOLE["barycentric"])


@pytest.mark.parametrize("name", ["confidence", "has_partner", "source_has_partner"])
@pytest.mark.parametrize("kind", ["U1", "S1", "M8[s]", "c16", "O"])
def test_non_numeric_match_values_are_refused(name: str, kind: str, tmp_path: Path) -> None:
    whole = {each: np.ones(100) for each in ("confidence", "has_partner", "source_has_partner")}
    whole[name] = np.full(100, 1).astype(kind)
    whole["vertex"] = SURFACE.triangles[WHOLE["triangle"], 0]
    (tmp_path / "map.npz").write_bytes(of(**whole))
    with pytest.raises(
        MeshError, match=r"map\.npz contains no (match|map)[^\n]*: (match again|choose another file)\.$"
    ):
        KnownMatch.load(tmp_path / "map.npz", SURFACE, SURFACE)


def test_a_result_that_was_changed_is_refused(tmp_path: Path) -> None:
    result = zo.match(SURFACE, SURFACE, k_final=10, samples=30, initial="proximity")
    path = tmp_path / "result.npz"
    result.save(path)
    assert zo.load_result(path).certainty == result.certainty
    whole = read_arrays(path)
    assert len(whole) > 20
    for name in sorted(whole.keys() - {CHECKSUM})[::8]:  # of another type, the checksum is the same
        array = whole[name]
        for changed in (np.append(array, array.flat[:1]), array.reshape(-1, 1, 1), array.astype("f4"), array * 0 + 7):
            np.savez(path, **(whole | {name: changed}))
            with pytest.raises(MeshError, match=r"result\.npz is not a saved result \([^\n]*\): save one with"):
                zo.load_result(path)


@pytest.mark.parametrize("fault", ["triangle", "below zero", "nan", "sum", "shape"])
def test_invalid_map_in_memory_is_refused(fault: str) -> None:
    count = len(SURFACE.vertices)
    triangle, barycentric = np.zeros(count, dtype=int), np.tile([1.0, 0, 0], (count, 1))
    match fault:
        case "triangle":
            triangle[3] = 10**6
        case "below zero":
            triangle[3] = -1
        case "nan":
            barycentric[3] = np.nan
        case "sum":
            barycentric[3] = 1
        case "shape":
            barycentric = barycentric[:-1]
    heights = zo.Attribute("height", zo.Domain.POINT, zo.Kind.SCALAR, SURFACE.vertices[:, 2])
    with pytest.raises(MeshError, match=r"The map cannot be used, because it.*: match these two surfaces again"):
        zo.transfer(heights, zo.SurfaceMap(triangle, barycentric, SURFACE.triangles), SURFACE, SURFACE)
