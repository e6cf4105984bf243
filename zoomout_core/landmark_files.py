# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of landmarks: CSV, and the two formats of 3D Slicer, `.mrk.json` and `.fcsv`.

Slicer's formats name the coordinate system of their points, LPS or RAS, which differ in the signs of x and y.
"""

from __future__ import annotations

import copy
import csv
import io
import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.opening import existing, file_bytes
from zoomout_core.mesh.surface import MeshError
from zoomout_core.mesh.text_tables import decode
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

    A line of a CSV file is `name,x,y,z`, `x,y,z`, `name,vertex` or `vertex`; a heading and lines that begin with # are
    skipped.

    Raises:
        MeshError: the file is missing, not of a supported format, or has no landmarks.
    """
    ending = landmark_ending(path)
    try:
        found = FORMATS[ending][0](decode(file_bytes(existing(path))))
    except MeshError:
        raise
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, csv.Error) as error:
        reason = " ".join(str(error).split())
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
        part.write_text(text, encoding="utf-8", newline="\n")


# --- CSV ------------------------------------------------------------------------------------------------------


def _read_csv(text: str) -> LandmarkSet:
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines)]
    if rows and not _is_number(rows[0][-1]):
        heading, *rows = rows
        if heading[-1].lower() == "confidence":  # a file of `write_landmark_file`
            rows = [row[:-1] for row in rows]
    widths = sorted({len(row) for row in rows})
    if not rows:
        return LandmarkSet((), np.zeros((0, 3)))
    if len(widths) > 1 or widths[0] > 4:
        raise ValueError(f"its lines have {' and '.join(map(str, widths))} entries; name,x,y,z are expected")
    named = widths[0] in (2, 4)
    names = tuple(row[0] if named else "" for row in rows)
    numbers = [row[1:] if named else row for row in rows]
    if len(numbers[0]) == 1:
        vertices = np.array([int(row[0]) for row in numbers], dtype=np.int64)
        return LandmarkSet(names, np.full((len(rows), 3), np.nan), vertices)
    return LandmarkSet(names, np.array(numbers, dtype=np.float64))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _write_csv(landmarks: LandmarkSet) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    named = any(landmarks.names)
    at = ["x", "y", "z"] if landmarks.vertices is None else ["vertex"]
    rows = landmarks.points if landmarks.vertices is None else landmarks.vertices[:, None]
    sure = landmarks.confidence
    writer.writerow([*(["name"] if named else []), *at, *([] if sure is None else ["confidence"])])
    for number, (name, row) in enumerate(zip(landmarks.names, rows.tolist(), strict=True)):
        confidence = [] if sure is None else [f"{sure[number]:.3f}"]
        writer.writerow([*([name] if named else []), *map(repr, row), *confidence])
    return out.getvalue()


# --- 3D Slicer: .mrk.json ---------------------------------------------------------------------------------------


def _control_points(document: dict[str, Any]) -> list[dict[str, Any]]:
    """The defined control points of all markups, in order."""
    return [
        point
        for markup in document["markups"]
        for point in markup.get("controlPoints", ())
        if point.get("positionStatus", "defined") != "undefined"
    ]


def _read_markups(text: str) -> LandmarkSet:
    document = json.loads(text)
    points = _control_points(document)
    systems = {SYSTEMS[str(markup.get("coordinateSystem", LPS))] for markup in document["markups"]}
    if len(systems) > 1:
        raise ValueError("its markups are in both LPS and RAS coordinates")
    return LandmarkSet(
        tuple(str(point.get("label", "")) for point in points),
        np.array([point["position"] for point in points], dtype=np.float64).reshape(-1, 3),
        system=systems.pop() if systems else LPS,
        document=document,
    )


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
    for line in text.splitlines():
        key, _, value = line.removeprefix("#").partition("=")
        if line.startswith("#") and key.strip() == "CoordinateSystem":
            system = SYSTEMS[value.strip().upper()]
        elif line.startswith("#") and key.strip() == "columns":
            columns = [name.strip() for name in value.split(",")]
    rows = list(csv.reader(line for line in text.splitlines() if line.strip() and not line.startswith("#")))
    x, label = columns.index("x"), columns.index("label")
    return LandmarkSet(
        tuple(row[label] for row in rows),
        np.array([row[x : x + 3] for row in rows], dtype=np.float64).reshape(-1, 3),
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
