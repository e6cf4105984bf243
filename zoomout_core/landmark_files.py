# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of landmarks: CSV, and the two formats of 3D Slicer, `.mrk.json` and `.fcsv`.

Slicer's formats name the coordinate system of their points, LPS or RAS, which differ in the signs of x and y.
"""

from __future__ import annotations

import copy
import csv
import io
import json
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.opening import existing, file_bytes
from zoomout_core.mesh.formats.text_tables import decode
from zoomout_core.runtime.outputs import atomic_write

LPS, RAS = "LPS", "RAS"
# Old files number them.
SYSTEMS = {"0": RAS, "1": LPS, RAS: RAS, LPS: LPS}
COLUMNS = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"


@dataclass(frozen=True, eq=False)
class LandmarkSet:
    """The landmarks of a shape.

    Attributes:
        names: (q) their names; empty strings where a file has none.
        points: (q, 3) positions, as the file has them; not a number if `vertices` is given.
        vertices: (q,) vertex numbers instead of positions, or None.
        system: the coordinate system that the file names, LPS or RAS; empty if it names none.
        confidence: (q,) in [0, 1], or None.
        document: the content of a .mrk.json file, whose other entries are kept.
    """

    names: tuple[str, ...]
    points: Floats
    vertices: Integers | None = None
    system: str = ""
    confidence: Floats | None = None
    document: dict[str, Any] = field(default_factory=dict)

    def move(self, points: Floats, confidence: Floats, vertices: Integers) -> LandmarkSet:
        """The same landmarks at positions (q, 3), or at vertices (q,) if these are vertices, with a confidence (q,)."""
        return replace(
            self,
            points=points,
            confidence=confidence,
            vertices=None if self.vertices is None else vertices,
        )


def landmark_ending(path: str | PathLike[str]) -> str:
    """The extension of a file of landmarks.

    Raises:
        MeshError: it is not supported.
    """
    name = Path(path).name.lower()
    for ending in FORMATS:
        if name.endswith(ending):
            return ending
    raise MeshError(f"{path} is not a file of landmarks: use {', '.join(FORMATS)}.")


def read_landmark_file(path: str | PathLike[str]) -> LandmarkSet:
    """Read a file of landmarks.

    A line of a CSV file is `name,x,y,z`, `x,y,z`, `name,vertex` or `vertex`. A heading with `x`, `y` and `z`, or with
    `vertex`, may give another order. Lines that begin with # are skipped.

    Raises:
        MeshError: the file is missing, not of a supported format, or has no landmarks.
    """
    ending = landmark_ending(path)
    try:
        found = FORMATS[ending][0](decode(file_bytes(existing(path))))
        FORMATS[ending][1](found)  # the data that it keeps of a document can be written
    except MeshError:
        raise
    except (ValueError, csv.Error, RecursionError) as error:
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else " ".join(str(error).split())
        raise MeshError(f"{path} could not be read as landmarks ({reason}): check its format.") from error
    if not found.names:
        raise MeshError(f"{path} contains no landmarks: add some.")
    if found.vertices is None and not np.isfinite(found.points).all():
        raise MeshError(f"{path} has landmarks whose coordinates are not finite: correct or remove them.")
    return found


def write_landmark_file(landmarks: LandmarkSet, path: str | PathLike[str]) -> None:
    """Write landmarks in the format of the file's extension, with their confidence.

    The confidence is a column of CSV, and the description of a landmark in Slicer's formats.

    Raises:
        MeshError: the format is not supported.
        OutputError: the file cannot be written; the earlier one is unchanged.
    """
    text = FORMATS[landmark_ending(path)][1](landmarks)
    with atomic_write(path) as part:
        part.write_bytes(text.encode("utf-8", "replace"))  # JSON may have half a character


# --- CSV ------------------------------------------------------------------------------------------------------


def _read_csv(text: str) -> LandmarkSet:
    rows = [[cell.strip() for cell in row] for row in _rows(text)]
    heading = []
    if rows and not any(map(_is_number, rows[0])):
        heading, *rows = rows
        heading = [cell.lower() for cell in heading]
    widths = sorted({len(row) for row in rows})
    if not rows:
        return LandmarkSet((), np.zeros((0, 3)))
    if len(widths) > 1 or (heading and len(heading) != widths[0]):
        raise ValueError(f"its lines have {' and '.join(map(str, sorted({*widths, len(heading)} - {0})))} entries")
    columns = _columns(heading, widths[0])
    named = [number for number in range(widths[0]) if number not in columns and heading[number:] != ["confidence"]]
    if len(columns) == 1 and any(mark in row[columns[0]] for row in rows for mark in ";\t"):
        raise ValueError("separate entries by commas, and write decimals with a point")
    names = tuple(row[named[0]] if named else "" for row in rows)
    if len(columns) == 1:
        vertices = np.array([_vertex(row[columns[0]]) for row in rows], dtype=np.int64)
        return LandmarkSet(names, np.full((len(rows), 3), np.nan), vertices)
    return LandmarkSet(names, np.array([[_number(row[column]) for column in columns] for row in rows]))


def _columns(heading: list[str], width: int) -> list[int]:
    """The columns of the coordinates, or of the vertex: those that the heading names, otherwise the last ones."""
    for names in (["x", "y", "z"], ["vertex"]):
        if all(heading.count(name) == 1 for name in names):
            return [heading.index(name) for name in names]
    if width > 4:
        raise ValueError(f"its lines have {width} entries, and no heading with x, y and z")
    return list(range(width))[-3:] if width > 2 else [width - 1]


def _rows(text: str) -> list[list[str]]:
    """The rows of CSV without empty lines and comments; cells in quotes may contain line breaks."""
    quoted = False

    def lines() -> Iterator[str]:
        nonlocal quoted
        for line in text.split("\n"):
            if quoted or (line.strip() and not line.startswith("#")):
                quoted ^= bool(line.count('"') % 2)
                yield f"{line}\n"

    rows = list(csv.reader(lines()))
    if quoted:
        raise ValueError("a quotation mark is not closed")
    return rows


def _number(word: str) -> float:
    if "_" in word or not _is_number(word):  # Python would read 1_0 as 10
        raise ValueError(f"{word!r:.40} is not a number")
    return float(word)


def _vertex(word: str) -> int:
    if not re.fullmatch(r"-?[0-9]{1,18}", word):
        raise ValueError(f"{word!r:.40} is not the number of a vertex")
    return int(word)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _write_csv(landmarks: LandmarkSet) -> str:
    columns: dict[str, list[str]] = {}
    if any(landmarks.names):
        columns["name"] = [_cell(name) for name in landmarks.names]
    if landmarks.vertices is not None:
        columns["vertex"] = [repr(vertex) for vertex in landmarks.vertices.tolist()]
    else:
        for axis, values in zip("xyz", landmarks.points.T.tolist(), strict=True):
            columns[axis] = [repr(value) for value in values]
    if landmarks.confidence is not None:
        columns["confidence"] = [f"{value:.3f}" for value in landmarks.confidence]
    lines = [tuple(columns), *zip(*columns.values(), strict=True)]
    return "".join(f"{','.join(line)}\n" for line in lines)


def _cell(text: str) -> str:
    """A cell of CSV, in quotes if it needs them: `csv` does not quote what would be a comment."""
    return f'"{text.replace(chr(34), chr(34) * 2)}"' if re.search(r'[,"#\r\n]', text) else text


# --- 3D Slicer: .mrk.json ---------------------------------------------------------------------------------------


def _control_points(document: Any) -> list[dict[str, Any]]:
    """The defined control points of all markups, in order."""
    return [
        point
        for markup in _objects(document, "markups")
        for point in _objects(markup, "controlPoints")
        if point.get("positionStatus", "defined") not in ("undefined", "missing")
    ]


def _objects(part: Any, name: str) -> list[dict[str, Any]]:
    """A list of objects in an object, which may lack it."""
    found = part.get(name, []) if isinstance(part, dict) else None
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise ValueError(f"its {name} are not a list of objects")
    return found


def _read_markups(text: str) -> LandmarkSet:
    document = json.loads(text)
    points = _control_points(document)
    systems = {_system(str(markup.get("coordinateSystem", LPS))) for markup in _objects(document, "markups")}
    if len(systems) > 1:
        raise ValueError("its markups are in both LPS and RAS coordinates")
    return LandmarkSet(
        tuple(str(point.get("label", "")) for point in points),
        np.array([_position(point) for point in points]).reshape(-1, 3),
        system=systems.pop() if systems else LPS,
        document=document,
    )


def _position(point: dict[str, Any]) -> list[float]:
    position = point.get("position")
    if isinstance(position, list) and len(position) == 3 and all(type(each) in (int, float) for each in position):
        with suppress(OverflowError):  # an integer of hundreds of digits
            return list(map(float, position))
    raise ValueError(f"the position of {point.get('label', 'a landmark')!r:.40} is not a list of three numbers")


def _system(name: str) -> str:
    if name not in SYSTEMS:
        raise ValueError(f"its coordinate system is {name!r:.40}, not LPS or RAS")
    return SYSTEMS[name]


def _write_markups(landmarks: LandmarkSet) -> str:
    document = copy.deepcopy(landmarks.document) or _new_markups(landmarks)
    points = _control_points(document)
    for number, (point, position) in enumerate(zip(points, landmarks.points.tolist(), strict=True)):
        point["position"] = position
        if landmarks.confidence is not None:
            point["description"] = _description(landmarks, number)
    return f"{json.dumps(document, indent=1, ensure_ascii=False)}\n"


def _new_markups(landmarks: LandmarkSet) -> dict[str, Any]:
    points = [
        {"id": str(number), "label": name, "description": "", "position": [0.0, 0.0, 0.0], "positionStatus": "defined"}
        for number, name in enumerate(_labels(landmarks), start=1)
    ]
    schema = "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    markup = {"type": "Fiducial", "coordinateSystem": landmarks.system or LPS, "controlPoints": points}
    return {"@schema": f"{schema}markups-schema-v1.0.3.json#", "markups": [markup]}


def _labels(landmarks: LandmarkSet) -> list[str]:
    return [name or f"F-{number}" for number, name in enumerate(landmarks.names, start=1)]


def _description(landmarks: LandmarkSet, number: int) -> str:
    return "" if landmarks.confidence is None else f"confidence {landmarks.confidence[number]:.3f}"


# --- 3D Slicer: .fcsv -------------------------------------------------------------------------------------------


def _read_fcsv(text: str) -> LandmarkSet:
    system, columns = RAS, COLUMNS.split(",")
    for line in text.split("\n"):
        key, _, value = line.removeprefix("#").partition("=")
        if line.startswith("#") and key.strip() == "CoordinateSystem":
            system = _system(value.strip().upper())
        elif line.startswith("#") and key.strip() == "columns":
            columns = [name.strip() for name in value.split(",")]
    lacking = [name for name in ("x", "y", "z", "label") if name not in columns]
    if lacking:
        raise ValueError(f"it has no column {' and '.join(lacking)}")
    x, y, z, label = (columns.index(name) for name in ("x", "y", "z", "label"))
    rows = _rows(text)
    short = next((row for row in rows if len(row) <= max(x, y, z, label)), None)
    if short is not None:
        raise ValueError(f"a line has {len(short)} entries instead of {len(columns)}")
    return LandmarkSet(
        tuple(row[label] for row in rows),
        np.array([[_number(row[at]) for at in (x, y, z)] for row in rows]).reshape(-1, 3),
        system=system,
    )


def _write_fcsv(landmarks: LandmarkSet) -> str:
    out = io.StringIO()
    out.write("# Markups fiducial file version = 4.11\n")
    out.write(f"# CoordinateSystem = {landmarks.system or LPS}\n# columns = {COLUMNS}\n")
    writer = csv.writer(out, lineterminator="\n")
    for number, (name, position) in enumerate(zip(_labels(landmarks), landmarks.points.tolist(), strict=True)):
        turn, flags = (0, 0, 0, 1), (1, 1, 0)
        writer.writerow([number + 1, *map(repr, position), *turn, *flags, name, _description(landmarks, number), ""])
    return out.getvalue()


FORMATS: dict[str, tuple[Callable[[str], LandmarkSet], Callable[[LandmarkSet], str]]] = {
    ".csv": (_read_csv, _write_csv),
    ".mrk.json": (_read_markups, _write_markups),
    ".fcsv": (_read_fcsv, _write_fcsv),
}
