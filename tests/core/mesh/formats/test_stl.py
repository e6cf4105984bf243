# SPDX-License-Identifier: GPL-3.0-or-later
"""Incomplete STL files are refused with the reason, and what programs append to them is passed over."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

import zoomout_core as zo
from zoomout_core.mesh.errors import MeshError

CORNERS = struct.pack("<12f", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0) + b"\0\0"
LOOP = b"outer loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n"
TEXT = b"solid a\nfacet normal 0 0 1\n" + LOOP + b"endfacet\nendsolid a\n"


def binary(count: int, head: bytes = b"made by a test", stored: int = 2) -> bytes:
    return head.ljust(80, b"\0") + struct.pack("<I", count) + stored * CORNERS


@pytest.mark.parametrize(
    ("content", "triangles"),
    [
        (binary(2), 2),
        (binary(2) + b"appended", 2),
        (binary(2, b"solid of a program"), 2),
        (TEXT, 1),
        (TEXT.upper().replace(b"SOLID A", b"solid A", 1), 1),
    ],
)
def test_complete_files_are_read(content: bytes, triangles: int, tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(content)
    assert len(zo.read_surface(tmp_path / "a.stl").triangles) == triangles


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "it ends too early"),
        (binary(2)[:60], "it ends too early"),
        (binary(2)[:-1], "it ends after 183 of 184 bytes"),
        (binary(3), "it ends after 184 of 234 bytes"),
        (binary(2**32 - 1), "it ends after 184 of 214748364834 bytes"),
        (binary(0), "it declares no triangles"),
        (TEXT[:70], "it ends too early"),
        (TEXT.replace(b"endsolid a\n", b""), "it ends too early"),
    ],
)
def test_incomplete_files_are_refused_with_the_reason(content: bytes, why: str, tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(content)
    with pytest.raises(MeshError, match=rf"a\.stl could not be read \({why}\): check that the file is complete"):
        zo.read_surface(tmp_path / "a.stl")
