# SPDX-License-Identifier: GPL-3.0-or-later
"""Records of the transfers to meshes of a collection, so that a repeated run transfers to none of them twice."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zoomout_core.messages import from_json, to_json
from zoomout_core.runtime.outputs import write_whole

# Folder of the records in the results.
TRANSFER_RECORDS = "carried"


@dataclass(frozen=True)
class PairTransfer:
    """A transfer from one file to another, with a record of it.

    Attributes:
        source: the file with the data; for Blender also an asset in a .blend file, see `split_asset`.
        target: the file that receives it.
        map_file: a map between both.
        output: the file to write.
        kinds: kinds of data, from `assets.transfer_asset.KINDS`.
        record: the file with the record.
        move_rig: move the source's joints into the target, which keeps its size.
    """

    source: Path
    target: Path
    map_file: Path
    output: Path
    kinds: tuple[str, ...]
    record: Path
    move_rig: bool = False


@dataclass(frozen=True)
class TransferOutcome:
    """The outcome of a transfer to one mesh.

    Attributes:
        notes: sentences for the user.
        motions: how each animation differs from the source's, if joints were moved; see `MotionCheck`.
    """

    notes: tuple[str, ...]
    motions: tuple[Mapping[str, Any], ...] = ()


def read_outcome(record: Path, key: str) -> TransferOutcome | None:
    """The outcome of an earlier transfer of the same contents; None if there was none."""
    try:
        stored = from_json(json.loads(record.read_bytes()))
        if stored["key"] != key:
            return None
        return TransferOutcome(tuple(map(str, stored["notes"])), tuple(stored["motions"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def forget_outcome(record: Path) -> None:
    """Remove a record before its output is replaced, or an interrupted run would leave it beside another output."""
    record.unlink(missing_ok=True)


def write_outcome(record: Path, key: str, outcome: TransferOutcome) -> None:
    """Record the outcome of a transfer.

    Raises:
        OutputError: it cannot be written.
    """
    stored = {"key": key, "notes": outcome.notes, "motions": outcome.motions}
    write_whole(record, json.dumps(to_json(stored), indent=1).encode())
