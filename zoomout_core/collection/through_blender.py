# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a collection that Blender reads and writes: each is read once and stored as a surface.

Blender numbers vertices and triangles in its own way, so it must also read the files that it transfers data to. If it
transfers data, it reads all files of known formats; other files are read here and passed on to it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zoomout_core.assets.asset import COLOR, MATERIALS, NORMALS, SHAPE_KEYS, UV, WEIGHTS
from zoomout_core.collection.engine import Engine, Failure, InThisProcess, Task, run_tasks
from zoomout_core.collection.shapes import Item, content_key
from zoomout_core.collection.transfer_records import (
    PairTransfer,
    TransferOutcome,
    forget_outcome,
    read_outcome,
    write_outcome,
)
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.blender_files import (
    ENDINGS,
    IMPORTED,
    SOURCE,
    TARGET,
    run_blender,
    split_asset,
    write_surface,
)
from zoomout_core.mesh.formats.files import read_surface, write_shape
from zoomout_core.messages import Message, warning
from zoomout_core.runtime.outputs import make_folder
from zoomout_core.runtime.version import package_version

# Folder of the results: surfaces that Blender read.
SURFACES = "surfaces"
# The extension's names of the kinds of data.
DATA = {
    UV: "uv_maps",
    COLOR: "color_attributes",
    MATERIALS: "materials",
    SHAPE_KEYS: "shape_keys",
    WEIGHTS: "vertex_groups",
    NORMALS: "custom_normals",
}


def is_of_blender(path: Path) -> bool:
    """Whether only Blender can read a file."""
    return path.suffix.lower() in ENDINGS


def read_items(
    items: Mapping[str, Item], folder: Path, template: str | None, carries: bool, program: str | None, engine: Engine
) -> tuple[dict[str, Item], dict[str, str]]:
    """Read the files that need Blender, unless their surfaces are stored already in the folder of the results.

    Args:
        items: items by name.
        folder: folder of the results.
        template: the name of the shape with the data, which is read with its modifiers applied.
        carries: whether Blender will transfer data to all.
        program: Blender's program, see `blender_command`.
        engine: runs the tasks, if it has access to the files.

    Returns:
        The readable items, and why the others could not be read, by name.
    """
    chosen = [each for each in items.values() if (carries or is_of_blender(each.path)) and each.path.is_file()]
    found, tasks = dict(items), []
    for item in chosen:
        role = SOURCE if item.name == template else TARGET
        surface = _place_of_surface(item, role, folder)
        known = is_of_blender(item.path) or item.path.suffix.lower() in IMPORTED
        found[item.name] = Item(item.name, surface, item.path if known else surface)
        if not surface.is_file():
            tasks.append(Task(f"read {item.name}", read_item, (item.path.absolute(), role, surface, known, program)))
    if tasks:
        make_folder(folder / SURFACES)
    failures = {}
    sees = engine.sees([folder, *(item.path for item in chosen)]) if tasks else True
    readers = engine if sees else InThisProcess()
    for done in run_tasks(readers, tasks, lambda ended: f"Reading through Blender {ended} of {len(tasks)}"):
        if isinstance(done.result, Failure):
            name = done.key.removeprefix("read ")
            failures[name] = done.result.message
            del found[name]
    return found, failures


def read_item(path: Path, role: str, output: Path, known: bool, program: str | None) -> None:
    """Write the surface of a file, using Blender if it knows the format.

    Raises:
        MeshError: the file cannot be read, or Blender is missing.
    """
    if known:
        write_surface(path, output, role, program)
    else:
        write_shape(read_surface(path), output)


def transfer_pair_through_blender(transfer: PairTransfer, program: str | None) -> TransferOutcome:
    """Transfer a source's data to a target by Blender, unless this is on record.

    Args:
        transfer: the transfer; its map is between the surfaces that Blender read. With skin weights the target is bound
            to the armature, or to a copy whose bones move into the target.
        program: Blender's program, see `blender_command`.

    Raises:
        MeshError: there is nothing to transfer, or a file cannot be read or written.
    """
    source, target, map_file, output = transfer.source, transfer.target, transfer.map_file, transfer.output
    kinds, record, move_rig = transfer.kinds, transfer.record, transfer.move_rig
    contents = [content_key(path.read_bytes()) for path in (split_asset(source)[0], target, map_file)]
    key = content_key(repr((contents, source.name, kinds, move_rig, output.name, package_version())).encode())
    earlier = read_outcome(record, key) if output.is_file() else None
    if earlier is not None:
        return earlier
    forget_outcome(record)
    make_folder(output.parent)
    arguments = [
        "carry",
        str(source.absolute()),
        str(target.absolute()),
        "--map",
        str(map_file.absolute()),
        "--save",
        str(output.absolute()),
    ]
    arguments += ["--data", *(DATA[kind] for kind in kinds)]
    if WEIGHTS in kinds:
        arguments += ["--bind", "--replace-binding", *(["--move-rig"] if move_rig else [])]
    report = run_blender(arguments, program)["targets"]
    errors = {name: entry["error"] for name, entry in report.items() if "error" in entry}
    if len(errors) == len(report):
        raise MeshError(" ".join(dict.fromkeys(errors.values())))
    notes = [note for entry in report.values() for note in _read_notes(entry)]
    notes += [_as_warning(f"'{name}' received no data: {error}") for name, error in errors.items()]
    found = TransferOutcome(tuple(dict.fromkeys(notes)))
    write_outcome(record, key, found)
    return found


def _read_notes(entry: Mapping[str, Any]) -> list[str]:
    """The notes in an entry of Blender's report, some of them warnings."""
    warnings = entry.get("warnings", ())
    return [_as_warning(note) if note in warnings else note for note in entry.get("notes", ())]


def _as_warning(note: str) -> Message:
    return warning("{note}", note=note)


def _place_of_surface(item: Item, role: str, folder: Path) -> Path:
    """Path of a file's surface, by content; removes earlier surfaces of that name."""
    key = content_key(repr((content_key(item.path.read_bytes()), role, package_version())).encode())
    place = folder.absolute() / SURFACES / f"{item.name}-{key}.ply"
    for path in surfaces_of(item.name, folder.absolute()):
        if path != place:
            path.unlink()
    return place


def surfaces_of(name: str, folder: Path) -> list[Path]:
    """The surfaces of a shape that earlier runs wrote to a folder of results."""
    pattern = re.compile(re.escape(name) + "-[0-9a-f]{32}[.]ply")
    return [path for path in (folder / SURFACES).glob("*.ply") if pattern.fullmatch(path.name)]
