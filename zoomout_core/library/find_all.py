# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the source of each of many targets, and transfer from it; an interrupted run resumes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from zoomout_core.arrays import Bytes
from zoomout_core.assets.asset import Asset, Skin
from zoomout_core.assets.files import READERS, inputs_of, read_asset
from zoomout_core.collection.shapes import content_key
from zoomout_core.colors import place_colors
from zoomout_core.drawing import encode_png
from zoomout_core.library.bodies import LibraryAsset
from zoomout_core.library.found import FoundSources
from zoomout_core.library.library import Library, prepared_assets
from zoomout_core.library.pictures import draw_bound, draw_colored, draw_pair
from zoomout_core.library.search import search
from zoomout_core.library.target_records import (
    MADE,
    TargetRecord,
    forget_record,
    place_of_picture,
    read_record,
    write_record,
)
from zoomout_core.library.transfers import (
    SEARCHED,
    TransferMode,
    Transferred,
    transfer,
    transfer_part,
    transfer_through_blender,
)
from zoomout_core.matching.report.verdict import RED, Verdict
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.formats.blender_files import ENDINGS as OF_BLENDER
from zoomout_core.mesh.formats.blender_files import split_asset
from zoomout_core.mesh.formats.opening import existing, file_bytes
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import NO_MEMORY, message_of
from zoomout_core.runtime.outputs import write_whole
from zoomout_core.runtime.progress import portion, renaming
from zoomout_core.runtime.version import package_version

# The format of written targets, unless Blender writes them.
GLB = ".glb"


class Options(NamedTuple):
    """Options of `find_all` that the result for each target depends on."""

    mode: TransferMode
    compare: int | None
    parts: bool
    force: bool


@dataclass(frozen=True, eq=False)
class FoundForAll:
    """The sources of many targets.

    Attributes:
        folder: folder of the results.
        records: the outcome for each target, by its name.
        failures: what failed and why, by the name of a target.
        new: the number of targets that were searched for in this run.
    """

    folder: Path
    records: dict[str, TargetRecord]
    failures: dict[str, str]
    new: int


def find_all(
    targets: Mapping[str, Path],
    libraries: Sequence[Library],
    folder: Path,
    mode: TransferMode = TransferMode.NOTHING,
    *,
    compare: int | None = None,
    parts: bool = False,
    force: bool = False,
    resume: bool = True,
) -> FoundForAll:
    """Find the source of each target, and write the target with its data to `targets/NAME.glb` in a folder.

    Blender transfers from a source that only Blender reads, and writes the target in the format of that source.

    Args:
        targets: files of meshes, by a name for the results.
        libraries: where the sources are.
        folder: folder of the results, created if missing.
        mode: what to do with the source that is found.
        compare: number of nearest assets to match, see `search`.
        parts: also use the other source that is proposed for a part of a target, see `find_part`.
        force: transfer even if the match is probably wrong.
        resume: keep results of an earlier run on the same files.

    Raises:
        MeshError: a library is not prepared.
        OutputError: a record or picture cannot be written.
    """
    assets, options = prepared_assets(libraries), Options(mode, compare, parts, force)
    prepared = sorted(f"{library.folder} {library.content()}" for library in libraries)
    result = FoundForAll(folder, {}, {}, 0)
    new = 0
    for number, (name, path) in enumerate(targets.items()):
        place = f"{number + 1}/{len(targets)} "
        with portion(number / len(targets), (number + 1) / len(targets)), renaming(place.__add__):
            try:
                contents = [content_key(file_bytes(existing(each))) for each in inputs_of(path)]
                key = content_key(repr((contents, prepared, *options, package_version())).encode())
                record = read_record(folder, name, key) if resume else None
                if record is None:
                    forget_record(folder, name)
                    record = _find(name, path, key, assets, folder, options)
                    new += 1
                result.records[name] = record
            except (ValueError, OSError, ImportError) as error:
                result.failures[name] = message_of(error)
            except MemoryError:
                result.failures[name] = NO_MEMORY
    return FoundForAll(folder, result.records, result.failures, new)


def _find(
    name: str, path: Path, key: str, assets: Sequence[LibraryAsset], folder: Path, options: Options
) -> TargetRecord:
    """Find the source of a target, transfer from it, and write the results; the record last."""
    target = read_asset(path)
    with portion(0, SEARCHED):
        found = search(target.surface, assets, options.compare)
    result = found.ranked[0].match if found.ranked else None
    output, skin, notes = "", None, list[str]()
    if found.best is not None and options.mode is not TransferMode.NOTHING:
        output, (result, skin, notes) = _transfer_best(found.best.path, target, path, folder, name, options)
    if found.part is not None:
        if options.parts and output.endswith(GLB) and found.part.path.suffix.lower() in READERS:
            made, of_part = transfer_part(found.part, path, folder / output, options.mode, options.force)
            skin, notes = made or skin, [*notes, *of_part]
        else:
            notes.append(found.part.sentence)
    notes += [found.note] if found.note else []
    verdict = Verdict(RED, str(found.refusal), "") if found.best is None or result is None else result.verdict
    record = TargetRecord(
        key,
        str(path),
        "" if found.best is None else str(found.best.path),
        tuple(_rows(found)),
        output,
        verdict.level,
        str(verdict.sentence),
        str(verdict.advice),
        tuple(dict.fromkeys(notes)),
    )
    write_whole(place_of_picture(folder, name), encode_png(_draw(target.surface, result, skin)))
    write_record(folder, name, record)
    return record


def _transfer_best(
    source: Path, target: Asset, path: Path, folder: Path, name: str, options: Options
) -> tuple[str, Transferred]:
    """Transfer from the best source, through Blender if only that reads it; returns also the name of the output."""
    ending = split_asset(source)[0].suffix.lower()
    if ending in OF_BLENDER:
        output = f"{MADE}/{name}{ending}"
        return output, transfer_through_blender(source, path, folder / output, options.mode, options.force)
    output = f"{MADE}/{name}{GLB}"
    return output, transfer(source, target, path, folder / output, options.mode, options.force)


def _draw(target: Surface, result: MatchResult | None, skin: Skin | None) -> Bytes:
    """(h, w, 3) a picture of a target: alone, or beside its source, and in a pose if it has a skin."""
    if result is None:
        return draw_colored(target, place_colors(target.vertices, target.vertices))
    bound = [] if skin is None else [draw_bound(result, skin)]
    return np.concatenate([*draw_pair(result), *bound], axis=1)


def _rows(found: FoundSources) -> list[dict[str, Any]]:
    return [
        {"file": str(each.path), "fit": 1 - each.misfit, "certainty": each.certainty, "fits": each.fits}
        for each in found.ranked
    ]
