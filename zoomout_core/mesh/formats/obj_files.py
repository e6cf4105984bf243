# SPDX-License-Identifier: GPL-3.0-or-later
"""OBJ files: one pass over the lines of a file collects its polygons and the data that assets need."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.formats.text_tables import decode, flatten, number_table, real_number, whole_number
from zoomout_core.runtime.input_files import FormatError


@dataclass(frozen=True, eq=False)
class ObjFile:
    """The lines of an OBJ file by keyword; methods parse their numbers, so unused broken lines do no harm.

    Attributes:
        position_lines: `v x y z`, with colours if there are any.
        coordinate_lines: `vt u v`.
        face_lines: `f` and `v/vt/vn` of each corner.
        positions_above: for each face the number of positions above it, from which corners may count backwards.
        coordinates_above: for each face the number of texture coordinates above it.
        face_materials: for each face an index into the materials, -1 for none.
        materials: names of the materials that are used, each once.
        libraries: names of .mtl files.
        loose_lines: lines of points and polylines.
    """

    position_lines: list[str] = field(default_factory=list)
    coordinate_lines: list[str] = field(default_factory=list)
    face_lines: list[str] = field(default_factory=list)
    positions_above: list[int] = field(default_factory=list)
    coordinates_above: list[int] = field(default_factory=list)
    face_materials: list[int] = field(default_factory=list)
    materials: list[str] = field(default_factory=list)
    libraries: list[str] = field(default_factory=list)
    loose_lines: list[str] = field(default_factory=list)

    def polygons(self) -> tuple[Floats, Integers, Integers]:
        """(n, 3) positions, (c,) the vertex of each corner, and (f + 1,) the first corner of each face.

        Raises:
            FormatError: a number is missing or malformed, or a face names vertex 0.
        """
        polygons = [
            [_vertex(corner, known) for corner in line.split()[1:]]
            for line, known in zip(self.face_lines, self.positions_above, strict=True)
        ]
        return number_table(self.position_lines, [1, 2, 3]), *flatten(polygons)

    def coordinates(self) -> list[list[float]]:
        """(t, 2) texture coordinates; missing components are zero."""
        words = (line.split()[1:3] for line in self.coordinate_lines)
        return [[real_number(word) for word in pair] + [0.0] * (2 - len(pair)) for pair in words]

    def corner_coordinates(self) -> list[int]:
        """(c,) the texture coordinate of each corner, -1 for none."""
        faces = zip(self.face_lines, self.coordinates_above, strict=True)
        return [_coordinate(corner, known) for line, known in faces for corner in line.split()[1:]]

    def colors(self) -> list[list[float]]:
        """(k, 3) colours of the vertices that have one."""
        words = (line.split()[1:7] for line in self.position_lines)
        return [[real_number(word) for word in each[3:]] for each in words if len(each) == 6]


def parse_obj(content: bytes) -> ObjFile:
    """Sort the lines of an OBJ file by keyword."""
    found, numbers, material = ObjFile(), dict[str, int](), -1
    for keyword, line in statements(content):
        if keyword == "v":
            found.position_lines.append(line)
        elif keyword == "f":
            found.face_lines.append(line)
            found.positions_above.append(len(found.position_lines))
            found.coordinates_above.append(len(found.coordinate_lines))
            found.face_materials.append(material)
        elif keyword == "vt":
            found.coordinate_lines.append(line)
        elif keyword == "usemtl":
            material = numbers.setdefault(" ".join(line.split()[1:]), len(numbers))
        elif keyword in ("p", "l"):
            found.loose_lines.append(line)
        elif keyword == "mtllib":
            found.libraries.append(" ".join(line.split()[1:]))
    found.materials.extend(numbers)
    return found


def statements(content: bytes) -> Iterator[tuple[str, str]]:
    """The keyword of each line of an OBJ or .mtl file, and the line without comments; skips lines without one."""
    for line in decode(content).replace("\\\n", " ").split("\n"):
        line = line.partition("#")[0]
        words = line.split(None, 1)
        if words:
            yield words[0], line


def _vertex(corner: str, known: int) -> int:
    """The vertex of a face corner `v/vt/vn`: counted from 1, or backwards from the last one so far."""
    number = whole_number(corner.partition("/")[0])
    if number == 0:
        raise FormatError("a face refers to vertex 0, but vertices are numbered from 1")
    return number - 1 if number > 0 else known + number


def _coordinate(corner: str, known: int) -> int:
    """The texture coordinate of a face corner `v/vt/vn`, -1 for none."""
    written = corner.split("/")[1:2]
    if not written or not written[0]:
        return -1
    number = whole_number(written[0])
    return number - 1 if number > 0 else known + number
