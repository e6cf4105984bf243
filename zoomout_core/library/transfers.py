# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer from a source that was found in a library to the file of a target."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from zoomout_core.assets.asset import Asset, Skin
from zoomout_core.assets.files import check_avatar, inputs_of, read_asset, write_asset
from zoomout_core.assets.transfer_asset import KINDS, base_of, transfer_asset
from zoomout_core.collection.through_blender import read_item, transfer_pair_through_blender
from zoomout_core.collection.transfer_records import PairTransfer
from zoomout_core.library.found import FoundPart
from zoomout_core.matching.pipeline import match
from zoomout_core.matching.report.verdict import check_verdict
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.blender_files import ENDINGS as OF_BLENDER
from zoomout_core.mesh.formats.blender_files import IMPORTED, SOURCE, TARGET
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import message, warning
from zoomout_core.runtime.outputs import make_folder
from zoomout_core.runtime.progress import portion

NOT_USED = "{file} was not used for the joint {joint}, because its match is probably wrong."
# Fraction of the progress at the end of the search, and of the match with the source.
SEARCHED, MATCHED = 0.4, 0.85
# Kinds of data to transfer.
TRANSFERRED = KINDS[:-1]


class TransferMode(StrEnum):
    """The use of a source that was found."""

    NOTHING = "nothing"  # only name it
    DATA = "data"  # transfer its data
    RIG = "rig"  # also move its joints into the target


class Transferred(NamedTuple):
    """A target that has the data of its source."""

    match: MatchResult
    skin: Skin | None  # of the written target, unless Blender wrote it
    notes: list[str]  # sentences for the user


def transfer(
    source_path: Path, target: Asset, path: Path, output: Path, mode: TransferMode, force: bool
) -> Transferred:
    """Match a source with a target, transfer from it, and write the target.

    Args:
        source_path: file of the source.
        target: the target.
        path: its file.
        output: the file to write.
        mode: what to do with the source that is found.
        force: transfer even if the match is probably wrong.

    Raises:
        MeshError: a file cannot be read, the source has no joints to move, or the match is probably wrong.
        OutputError: the target cannot be written.
    """
    source = read_asset(source_path)
    if mode is TransferMode.RIG and source.skin is None:
        raise MeshError(f"The best source, {source_path}, has no joints to move: leave out --move-rig, or rig it.")
    with portion(SEARCHED, MATCHED):
        result = match(source.surface, target.surface)
    check_verdict(result.verdict, force)
    with portion(MATCHED, 1):
        made = transfer_asset(source, target, result, TRANSFERRED, move_rig=mode is TransferMode.RIG)
    make_folder(output.parent)
    check_avatar(base_of(source, target, TRANSFERRED), output)
    left_out = write_asset(made.asset, output, inputs_of(path, source_path))
    notes = [*source.notes, *target.notes, *result.notes, *made.notes, *left_out]
    return Transferred(result, made.asset.skin, notes)


def transfer_part(
    part: FoundPart, path: Path, output: Path, mode: TransferMode, force: bool
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
    if result.verdict.is_wrong and not force:
        return None, [part.sentence, warning(NOT_USED, file=part.path, joint=part.joint)]
    mask = np.clip(target.skin.weights @ np.isin(target.skin.names, part.joints).astype(float), 0, 1)
    moves = mode is TransferMode.RIG and source.skin is not None
    made = transfer_asset(source, target, result, TRANSFERRED, move_rig=moves, mask=mask)
    left_out = write_asset(made.asset, output, inputs_of(path, part.path))
    used = message("The joint {joint} and all below it have the data of {file}.", joint=part.joint, file=part.path)
    return made.asset.skin, [used, *source.notes, *made.notes, *left_out]


def transfer_through_blender(source: Path, target: Path, output: Path, mode: TransferMode, force: bool) -> Transferred:
    """Do as `transfer` for a source that only Blender reads, which then writes the target.

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
        kinds, moves = tuple(TRANSFERRED), mode is TransferMode.RIG
        with portion(MATCHED, 1):
            readable = target if known else of_target
            found = transfer_pair_through_blender(
                PairTransfer(source, readable, map_file, output, kinds, record, moves), None
            )
    return Transferred(result, None, [*result.notes, *found.notes])


def _stand_up(surface: Surface) -> Surface:
    """Rotate a surface whose z axis is up, as in Blender, so that its y axis is up, as in pictures."""
    return surface.with_vertices(surface.vertices[:, [0, 2, 1]] * [1, 1, -1])
