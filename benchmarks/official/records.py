# SPDX-License-Identifier: GPL-3.0-or-later
"""Records of measured pairs: one line of JSON each, appended as soon as the pair is measured.

A folder has two files for each set: `NAME.json` describes the list (`describe`), and `NAME.jsonl` has the records. A
record is one of a pair in a setting by a version of the code: an interrupted run is resumed, and records of other
code are not mixed with it. Pairs that failed are tried again.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import numpy as np
import scipy
from tqdm import tqdm

from benchmarks.official import measure as measure_module
from benchmarks.official.lists import OfficialList
from benchmarks.official.measure import Setting, measure
from benchmarks.stored import append, code_version, read
from benchmarks.tables import Record
from zoomout_core.collection.dask_engine import local_engine
from zoomout_core.collection.engine import Failure, Task


def run(lists: Sequence[OfficialList], setting: Setting, pairs: int | None, folder: Path, workers: int) -> list[str]:
    """Measure the pairs of lists that have no record yet, in several processes, and append their records.

    Args:
        lists: the lists.
        setting: how the shapes are placed.
        pairs: number of pairs of each list, see `OfficialList.sample`; all if not given.
        folder: of the records.
        workers: number of processes, each with one thread.

    Returns:
        Why pairs could not be measured.

    Raises:
        ValueError: the truth or the protocol of a list cannot be read.
        OSError: a record cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tasks, files, failures = [], {}, list[str]()
    code = code_version(Path(measure_module.__file__))
    for chosen in lists:
        (folder / f"{chosen.name}.json").write_text(json.dumps(describe(chosen), indent=1))
        path = folder / f"{chosen.name}.jsonl"
        there = {_key(record) for record in read(path) if "failed" not in record}
        # Pairs of one source follow each other, since its distances are kept.
        for target, source in sorted(chosen.sample(pairs), key=lambda pair: pair[::-1]):
            key: Record = {"code": code, "target": target, "source": source, "setting": setting.name}
            if _key(key) not in there:
                name = f"{chosen.name}/{target}/{source}"
                tasks.append(Task(name, measure, (chosen, target, source, setting)))
                files[name] = path, key
    if not tasks:
        return failures
    with local_engine(min(workers, len(tasks)), retries=0) as engine:
        for done in tqdm(engine.as_completed(tasks), total=len(tasks)):
            path, key = files[done.key]
            outcome = done.result
            if isinstance(done.result, Failure):
                failures.append(f"{done.key}: {done.result.message}")
                outcome = {"failed": done.result.message}
            append(path, key | outcome)
    return failures


def describe(chosen: OfficialList) -> Record:
    """The protocol of a list, its size, its kind of truth, and what its pairs are measured with."""
    return {
        "protocol": {key: value for key, value in chosen.protocol.items() if key in ("protocol", "published")},
        "pairs": len(chosen.pairs),
        "self-pairs": sum(target == source for target, source in chosen.pairs),
        "truth": chosen.truth_kind,
        "is far": chosen.is_far,
        "made with": f"{os.cpu_count()} cores, Python {platform.python_version()}, numpy {np.__version__}, "
        f"scipy {scipy.__version__}",
    }


def latest(records: Sequence[Record]) -> list[Record]:
    """The records by the code that measured last, one for each pair and setting."""
    return list({_key(record): record for record in records if record["code"] == records[-1]["code"]}.values())


def sets_in(folder: Path, names: Collection[str] = ()) -> Iterator[tuple[str, Record, list[Record]]]:
    """Name, description and latest records of each set that has records in a folder.

    Raises:
        ValueError: a set has no description.
    """
    for path in sorted(folder.glob("*.jsonl")):
        records = read(path)
        if records and (not names or path.stem in names):
            about = path.with_suffix(".json")
            if not about.is_file():
                raise ValueError(f"There is no {about} about the records beside it: measure the set again.")
            yield path.stem, json.loads(about.read_text()), latest(records)


def _key(record: Record) -> tuple[str, ...]:
    return record["code"], record["target"], record["source"], record["setting"]
