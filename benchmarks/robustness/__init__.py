# SPDX-License-Identifier: GPL-3.0-or-later
"""Behaviour of tools on malformed files and hard meshes, each in a child process with limits of time and memory."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import trimesh

from benchmarks.robustness.cases import Mesh, clean, hard_meshes, malformed_files
from benchmarks.tables import Record, Tables

TOOLS = ("zoomout_core", "pyFMaps", "Data Transfer", "MeshLab")
# The extensions that each tool can read.
READS = {
    "zoomout_core": (".obj", ".off", ".ply", ".stl"),
    "pyFMaps": (".obj", ".off"),
    "Data Transfer": (".obj", ".ply", ".stl"),
    "MeshLab": (".obj", ".off", ".ply", ".stl"),
}
# Limits of a case: seconds, and bytes of address space.
SECONDS, MEMORY = 60, 8 << 30
# Number of cases that run at the same time.
AT_ONCE = 2
# A transfer is right if the median error of positions, relative to the square root of the area, is smaller than this.
RIGHT = 0.03
REFUSED, CRASH, HANG, TRACEBACK = "refused", "crash", "hang", "traceback"
RIGHT_ONE, WARNED, SILENT, NO_READER = "right", "warned", "silently wrong", "-"
VERDICTS = RIGHT_ONE, REFUSED, WARNED, TRACEBACK, CRASH, HANG, SILENT, NO_READER


def run(pairs: int | None) -> Tables:
    """Two tables, of files and of meshes, with a row of the tools' verdicts for each case; and the sums of both."""
    files = dict(list(malformed_files().items())[:pairs])
    hard = dict(list(hard_meshes().items())[:pairs])
    with TemporaryDirectory() as folder, ThreadPoolExecutor(AT_ONCE) as pool:
        cases = [("file", name, partial(_read, name, content, Path(folder))) for name, content in files.items()]
        cases += [
            ("mesh", name, partial(_use, harden, Path(folder), str(n))) for n, (name, harden) in enumerate(hard.items())
        ]
        verdicts = [[pool.submit(verdict, tool) for tool in TOOLS] for _, _, verdict in cases]
        rows = [
            {sort: name, **{tool: one.result() for tool, one in zip(TOOLS, each, strict=True)}}
            for (sort, name, _), each in zip(cases, verdicts, strict=True)
        ]
    return {
        "files": [row for row in rows if "file" in row],
        "meshes": [row for row in rows if "mesh" in row],
        "sums": [_sums(tool, rows) for tool in TOOLS],
    }


def _sums(tool: str, rows: list[Record]) -> Record:
    verdicts = Counter(row[tool] for row in rows)
    return {"tool": tool} | {name: verdicts[name] for name in VERDICTS}


def _read(name: str, content: bytes, folder: Path, tool: str) -> str:
    """Have a tool read a malformed file: refusing it is right, and so is finding nothing in it."""
    if Path(name).suffix not in READS[tool]:
        return NO_READER
    path = folder / tool / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    answer = _answer(tool, path)
    if isinstance(answer, str):
        return answer
    return SILENT if answer.get("read") else REFUSED if "said" in answer else WARNED


def _use(harden: Callable[[Mesh], Mesh], folder: Path, number: str, tool: str) -> str:
    """Have a tool use a hard mesh."""
    source, target = clean()
    place = folder / f"{number} {tool}"
    place.mkdir()
    paths = place / "source.obj", place / "target.obj"
    hard = harden(target)
    for path, mesh in zip(paths, (source, hard), strict=True):
        _write(path, mesh)
    return _verdict(_answer(tool, paths[1], paths[0]), hard, source)


def _write(path: Path, mesh: Mesh) -> None:
    """Write a mesh as OBJ in full precision, without any checks."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh[0]]
    path.write_text("\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh[1]), ""]))


def _verdict(answer: Record | str, mesh: Mesh, source: Mesh) -> str:
    """Whether the data transferred to vertices of faces is right, or the tool reported that it may not be."""
    if isinstance(answer, str):
        return answer
    if "said" in answer:
        return REFUSED
    carried = np.array(answer.get("carried", []), dtype=float)
    doubts = WARNED if answer.get("doubts") else SILENT
    vertices, faces = mesh
    used = np.unique(faces) if len(faces) else np.arange(len(vertices))
    if len(carried) == len(vertices):
        carried = carried[used]
    if len(carried) != len(used):  # readers may drop unused vertices
        return doubts
    off = np.linalg.norm(carried - vertices[used], axis=1)
    scale = np.sqrt(trimesh.Trimesh(*source, process=False).area)
    return RIGHT_ONE if np.nanmedian(off) < RIGHT * scale else doubts


def _answer(tool: str, *paths: Path) -> Record | str:
    """A tool's answer to a case, or the way its process ended."""
    command = [sys.executable, "-m", "benchmarks.robustness.worker", tool, *map(str, paths)]
    try:
        ran = subprocess.run(command, capture_output=True, timeout=SECONDS, preexec_fn=_limit, check=False)
    except subprocess.TimeoutExpired:
        return HANG
    if ran.returncode < 0:
        return CRASH
    if ran.returncode:
        return TRACEBACK
    answer: Record = json.loads(ran.stdout.decode(errors="replace").splitlines()[-1])
    return answer


def _limit() -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
