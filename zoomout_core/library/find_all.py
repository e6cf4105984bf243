# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the source of each of many targets, and transfer from it; an interrupted run resumes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from zoomout_core.assets.asset import Asset, Skin
from zoomout_core.assets.files import READERS, check_avatar, inputs_of, read_asset, write_asset
from zoomout_core.assets.transfer_asset import KINDS, base_of, transfer_asset
from zoomout_core.collection.shapes import content_key
from zoomout_core.collection.through_blender import carry_pair, read_item
from zoomout_core.colors import place_colors
from zoomout_core.drawing import encode_png
from zoomout_core.library.library import NOT_PREPARED, Library
from zoomout_core.library.parts import FoundPart
from zoomout_core.library.pictures import draw_bound, draw_colored, draw_pair
from zoomout_core.library.search import FoundSources, LibraryAsset, search
from zoomout_core.matching.pipeline import match
from zoomout_core.matching.report.verdict import RED, Verdict, check_verdict
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.formats.blender_files import ENDINGS as OF_BLENDER
from zoomout_core.mesh.formats.blender_files import IMPORTED, SOURCE, TARGET, split_asset
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.formats.opening import existing, file_bytes
from zoomout_core.mesh.surface import MeshError, Surface
from zoomout_core.messages import NO_MEMORY, from_json, message, to_json, warning
from zoomout_core.runtime.outputs import write_whole
from zoomout_core.runtime.progress import portion, renaming
from zoomout_core.runtime.version import package_version

# Folders of the results: targets with the data of their sources, pictures, and records of both.
MADE, PICTURES, RECORDS = "targets", "pictures", "records"
NOT_USED = "{file} was not used for the joint {joint}, because its match is probably wrong."
# Fraction of the progress at the end of the search, and of the match with the source.
SEARCHED, MATCHED = 0.4, 0.85
# The format of written targets, unless Blender writes them.
GLB = ".glb"
# Kinds of data to transfer.
TRANSFERRED = KINDS[:-1]


class Carry(StrEnum):
    """The use of a source that was found."""

    NOTHING = "nothing"  # only name it
    DATA = "data"  # transfer its data
    RIG = "rig"  # also move its joints into the target


@dataclass(frozen=True)
class TargetRecord:
    """The source of a target, in values that JSON can store.

    Attributes:
        key: a hash of the target, the libraries, what is carried and the version of this package.
        target: the target's file.
        source: the file of the source; empty if nothing fits.
        ranked: for each asset that was matched its `file`, `fit` and `certainty`, the best first.
        output: the written file, relative to the folder of the results; empty if none was written.
        level: level of the verdict on the match with the source.
        sentence: its reason.
        advice: what to do.
        notes: sentences for the user.
    """

    key: str
    target: str
    source: str
    ranked: tuple[Mapping[str, Any], ...]
    output: str
    level: str
    sentence: str
    advice: str
    notes: tuple[str, ...]

    @property
    def verdict(self) -> Verdict:
        """The verdict on the match with the source."""
        return Verdict(self.level, self.sentence, self.advice)


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
    carry: Carry = Carry.NOTHING,
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
        carry: what to transfer.
        compare: number of nearest assets to match, see `search`.
        parts: also use the other source that is proposed for a part of a target, see `find_part`.
        force: transfer even if the match is probably wrong.
        resume: keep results of an earlier run on the same files.

    Raises:
        MeshError: a library is not prepared.
        OutputError: a record or picture cannot be written.
    """
    assets: dict[Path, LibraryAsset] = {}
    for library in libraries:
        found = {asset.path: asset for asset in library.assets()}
        if not found:
            raise MeshError(NOT_PREPARED, folder=library.folder)
        assets |= found
    prepared = sorted(f"{library.folder} {library.content()}" for library in libraries)
    result = FoundForAll(folder, {}, {}, 0)
    new = 0
    for number, (name, path) in enumerate(targets.items()):
        place = f"{number + 1}/{len(targets)} "
        with portion(number / len(targets), (number + 1) / len(targets)), renaming(place.__add__):
            try:
                contents = [content_key(file_bytes(existing(each))) for each in inputs_of(path)]
                key = content_key(repr((contents, prepared, carry, compare, parts, force, package_version())).encode())
                record = _read_record(folder, name, key) if resume else None
                if record is None:
                    record = _find(name, path, key, list(assets.values()), folder, carry, compare, parts, force)
                    new += 1
                result.records[name] = record
            except (ValueError, OSError, ImportError) as error:
                result.failures[name] = str(error)
            except MemoryError:
                result.failures[name] = NO_MEMORY
    return FoundForAll(folder, result.records, result.failures, new)


def place_of_picture(folder: Path, name: str) -> Path:
    """The picture of a target beside its source."""
    return folder / PICTURES / f"{name}.png"


def _find(
    name: str,
    path: Path,
    key: str,
    assets: Sequence[LibraryAsset],
    folder: Path,
    carry: Carry,
    compare: int | None,
    parts: bool,
    force: bool,
) -> TargetRecord:
    """Find the source of a target, transfer from it, and write the results; the record last."""
    target = read_asset(path)
    with portion(0, SEARCHED):
        found = search(target.surface, assets, compare)
    result = found.ranked[0].match if found.ranked else None
    output, notes = "", list[str]()
    skin: Skin | None = None
    if found.best is None:
        verdict = Verdict(RED, str(found.refusal), "")
    elif carry is Carry.NOTHING:
        assert result is not None
        verdict = result.verdict
    else:
        ending = split_asset(found.best.path)[0].suffix.lower()
        if ending in OF_BLENDER:
            output = f"{MADE}/{name}{ending}"
            result, skin, notes = _transfer_through_blender(found.best.path, path, folder / output, carry, force)
        else:
            output = f"{MADE}/{name}{GLB}"
            result, skin, notes = _transfer(found.best.path, target, path, folder / output, carry, force)
        verdict = result.verdict
    if found.part is not None:
        if parts and output.endswith(GLB) and found.part.path.suffix.lower() in READERS:
            made, of_part = _transfer_part(found.part, path, folder / output, carry, force)
            skin, notes = made or skin, [*notes, *of_part]
        else:
            notes.append(found.part.sentence)
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
    if result is None:
        alone = target.surface
        pictures = [draw_colored(alone, place_colors(alone.vertices, alone.vertices))]
    else:
        pictures = [*draw_pair(result), *([draw_bound(result, skin)] if skin is not None else [])]
    write_whole(place_of_picture(folder, name), encode_png(np.concatenate(pictures, axis=1)))
    write_whole(folder / RECORDS / f"{name}.json", json.dumps(to_json(asdict(record)), indent=1).encode())
    return record


def _transfer(
    source_path: Path, target: Asset, path: Path, output: Path, carry: Carry, force: bool
) -> tuple[MatchResult, Skin | None, list[str]]:
    """Transfer from a source to a target, and write it.

    Returns:
        The match, the skin of the written target, and sentences for the user.

    Raises:
        MeshError: a file cannot be read, the source has no joints to move, or the match is probably wrong.
        OutputError: the target cannot be written.
    """
    source = read_asset(source_path)
    if carry is Carry.RIG and source.skin is None:
        raise MeshError(f"The best source, {source_path}, has no joints to move: leave out --move-rig, or rig it.")
    with portion(SEARCHED, MATCHED):
        result = match(source.surface, target.surface)
    check_verdict(result.verdict, force)
    with portion(MATCHED, 1):
        made = transfer_asset(source, target, result, TRANSFERRED, move_rig=carry is Carry.RIG)
    output.parent.mkdir(parents=True, exist_ok=True)
    check_avatar(base_of(source, target, TRANSFERRED), output)
    left_out = write_asset(made.asset, output, inputs_of(path, source_path))
    return result, made.asset.skin, [*source.notes, *target.notes, *result.notes, *made.notes, *left_out]


def _transfer_part(
    part: FoundPart, path: Path, output: Path, carry: Carry, force: bool
) -> tuple[Skin | None, list[str]]:
    """Transfer from the source of a part to this part of a written target, and write it again.

    A match that is probably wrong is not used.

    Returns:
        The skin of the written target, None if it is unchanged, and sentences for the user.

    Raises:
        MeshError: a file cannot be read.
        OutputError: the target cannot be written.
    """
    source, target = read_asset(part.path), read_asset(output)
    assert target.skin is not None  # parts are those of its joints
    with portion(1, 1):
        result = match(source.surface, target.surface)
    if result.verdict.level == RED and not force:
        return None, [part.sentence, warning(NOT_USED, file=part.path, joint=part.joint)]
    mask = np.clip(target.skin.weights @ np.isin(target.skin.names, part.joints).astype(float), 0, 1)
    moves = carry is Carry.RIG and source.skin is not None
    made = transfer_asset(source, target, result, TRANSFERRED, move_rig=moves, mask=mask)
    left_out = write_asset(made.asset, output, inputs_of(path, part.path))
    used = message("The joint {joint} and all below it have the data of {file}.", joint=part.joint, file=part.path)
    return made.asset.skin, [used, *source.notes, *made.notes, *left_out]


def _transfer_through_blender(
    source: Path, target: Path, output: Path, carry: Carry, force: bool
) -> tuple[MatchResult, None, list[str]]:
    """The same for a source that only Blender reads; it writes the target.

    Raises:
        MeshError: Blender is missing or cannot read a file, or the match is probably wrong.
        OutputError: the target cannot be written.
    """
    with TemporaryDirectory(prefix="zoomout-") as folder:
        of_source, of_target = (Path(folder, f"{role}.ply") for role in (SOURCE, TARGET))
        read_item(source, SOURCE, of_source, True, None)
        known = target.suffix.lower() in (*OF_BLENDER, *IMPORTED)
        read_item(target, TARGET, of_target, known, None)
        with portion(SEARCHED, MATCHED):
            result = match(*(_stand_up(read_surface(each)) for each in (of_source, of_target)))
        check_verdict(result.verdict, force)
        map_file, record = Path(folder, "map.npz"), Path(folder, "record.json")
        partners = {"has_partner": result.has_partner, "source_has_partner": result.source_has_partner}
        result.surface_map.save(map_file, confidence=result.confidence, **partners)
        kinds, moves = tuple(TRANSFERRED), carry is Carry.RIG
        with portion(MATCHED, 1):
            found = carry_pair(source, target if known else of_target, map_file, output, kinds, record, None, moves)
    return result, None, [*result.notes, *found.notes]


def _stand_up(surface: Surface) -> Surface:
    """Rotate a surface whose z axis is up, as in Blender, so that its y axis is up, as in pictures."""
    return surface.with_vertices(surface.vertices[:, [0, 2, 1]] * [1, 1, -1])


def _rows(found: FoundSources) -> list[dict[str, Any]]:
    return [
        {"file": str(each.path), "fit": 1 - each.misfit, "certainty": each.certainty, "fits": each.fits}
        for each in found.ranked
    ]


def _read_record(folder: Path, name: str, key: str) -> TargetRecord | None:
    """The record of an earlier run on the same files; None if it is missing, or its output files are."""
    try:
        held: dict[str, Any] = from_json(json.loads((folder / RECORDS / f"{name}.json").read_bytes()))
        record = TargetRecord(**{**held, "ranked": tuple(held["ranked"]), "notes": tuple(held["notes"])})
    except (OSError, ValueError, KeyError, TypeError):
        return None
    written = [place_of_picture(folder, name), *([folder / record.output] if record.output else [])]
    return record if record.key == key and all(each.is_file() for each in written) else None
