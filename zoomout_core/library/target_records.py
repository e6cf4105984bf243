# SPDX-License-Identifier: GPL-3.0-or-later
"""Records of targets whose sources were searched for, from which an interrupted run resumes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from zoomout_core.matching.report.verdict import Verdict
from zoomout_core.messages import from_json, to_json
from zoomout_core.runtime.outputs import write_whole

# Folders of the results: targets with the data of their sources, pictures, and records of both.
MADE, PICTURES, RECORDS = "targets", "pictures", "records"


@dataclass(frozen=True)
class TargetRecord:
    """The source of a target, in values that JSON can store.

    Attributes:
        key: a hash of the target, the libraries, what is transferred and the version of this package.
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


def place_of_picture(folder: Path, name: str) -> Path:
    """The picture of a target beside its source."""
    return folder / PICTURES / f"{name}.png"


def write_record(folder: Path, name: str, record: TargetRecord) -> None:
    """Write the record of a target.

    Raises:
        OutputError: it cannot be written.
    """
    write_whole(_place_of_record(folder, name), json.dumps(to_json(asdict(record)), indent=1).encode())


def read_record(folder: Path, name: str, key: str) -> TargetRecord | None:
    """The record of an earlier run on the same files; None if it is missing, or its output files are."""
    try:
        held: dict[str, Any] = from_json(json.loads(_place_of_record(folder, name).read_bytes()))
        record = TargetRecord(**{**held, "ranked": tuple(held["ranked"]), "notes": tuple(held["notes"])})
    except (OSError, ValueError, KeyError, TypeError):
        return None
    written = [place_of_picture(folder, name), *([folder / record.output] if record.output else [])]
    return record if record.key == key and all(each.is_file() for each in written) else None


def forget_record(folder: Path, name: str) -> None:
    """Remove a record before its files are replaced, or an interrupted run would leave it beside other files."""
    _place_of_record(folder, name).unlink(missing_ok=True)


def _place_of_record(folder: Path, name: str) -> Path:
    return folder / RECORDS / f"{name}.json"
