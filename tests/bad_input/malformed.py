# SPDX-License-Identifier: GPL-3.0-or-later
"""Malformed mesh files by name and extension, generated on each use."""

from __future__ import annotations

import struct

TRIANGLE = "0 0 0\n1 0 0\n1 1 0\n"
OBJ = "".join(f"v {line}\n" for line in TRIANGLE.splitlines())
PLY = (
    b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    b"element face 1\nproperty list uint int vertex_indices\nend_header\n"
)
POINTS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 1, 1, 0)


def face(*numbers: int) -> bytes:
    return struct.pack(f"<{len(numbers)}I", *numbers)


MALFORMED: dict[str, bytes] = {
    "empty.obj": b"",
    "empty.off": b"",
    "empty.ply": b"",
    "empty.stl": b"",
    "random.obj": bytes(range(256)) * 9,
    "random.off": bytes(range(256)) * 9,
    "random.ply": bytes(range(256)) * 9,
    "random.stl": bytes(range(256)) * 9,
    "vertex_zero.obj": f"{OBJ}f 0 1 2\n".encode(),
    "vertex_beyond.obj": f"{OBJ}f 1 2 9\n".encode(),
    "before_the_first.obj": f"{OBJ}f -1 -2 -9\n".encode(),
    "fractions.obj": f"{OBJ}f 1.5 2 3\n".encode(),
    "a_line_cut_off.obj": b"v 0 0\nv 1 0 0\nf 1 2 3\n",
    "short_face.off": f"OFF\n3 1 0\n{TRIANGLE}3 0 1\n".encode(),
    "a_face_of_billions.off": f"OFF\n3 1 0\n{TRIANGLE}2000000000 0 1 2\n".encode(),
    "a_face_of_less_than_none.off": f"OFF\n3 1 0\n{TRIANGLE}-3 0 1 2\n".encode(),
    "vertex_beyond.off": f"OFF\n3 1 0\n{TRIANGLE}3 0 1 77777\n".encode(),
    "a_billion_vertices.off": f"OFF\n999999999 1 0\n{TRIANGLE}3 0 1 2\n".encode(),
    "fewer_faces.off": f"OFF\n3 99 0\n{TRIANGLE}3 0 1 2\n".encode(),
    "fractions.off": f"OFF\n3 1 0\n{TRIANGLE}3 0 1.5 2\n".encode(),
    "a_list_of_billions.ply": PLY + POINTS + face(2**31, 0, 1, 2),
    "vertex_beyond.ply": PLY + POINTS + face(3, 0, 1, 99999999),
    "billions_of_vertices.ply": PLY.replace(b"vertex 3", b"vertex 99999999999") + POINTS,
    "less_than_no_vertices.ply": PLY.replace(b"vertex 3", b"vertex -3") + POINTS + face(3, 0, 1, 2),
    "an_unknown_type.ply": PLY.replace(b"float x", b"quaternion x") + POINTS + face(3, 0, 1, 2),
    "no_coordinates.ply": PLY.replace(b"float x", b"float w") + POINTS + face(3, 0, 1, 2),
    "no_end_of_header.ply": PLY.replace(b"end_header\n", b"") + POINTS,
    "billions_of_triangles.stl": bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(50),
    "cut_off.stl": bytes(80) + struct.pack("<I", 5) + bytes(120),
}

# MeshLab reads some of these as something else.
ODD_NUMBERS: dict[str, bytes] = {
    "less_than_no_corners.ply": PLY.replace(b"list uint", b"list char") + POINTS + b"\xff" + face(0, 1, 2),
    "a_fraction_of_corners.ply": PLY.replace(b"list uint", b"list float") + POINTS + struct.pack("<f3i", 2.5, 0, 1, 2),
    "a_fraction_of_a_vertex.ply": PLY.replace(b"uint int", b"uint float") + POINTS + struct.pack("<I3f", 3, 0, 1.5, 2),
    "no_number_of_a_vertex.ply": PLY.replace(b"uint int", b"uint float")
    + POINTS
    + struct.pack("<I3f", 3, 0, float("nan"), 2),
    "no_format.ply": PLY.replace(b"format binary_little_endian 1.0\n", b"") + POINTS + face(3, 0, 1, 2),
    "beyond_all_numbers.obj": f"{OBJ}f 1 2 {10**30}\n".encode(),
    "beyond_all_numbers.off": f"OFF\n3 2 0\n{TRIANGLE}3 0 1 2\n4 0 1 2 {10**30}\n".encode(),
}
