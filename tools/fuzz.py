# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged files for every reader: each must be read or refused in one sentence, within limits of time and memory.

    make fuzz ARGS="--count 100000"

A sample of each format (`fuzz_readers.py`) is damaged at random (`fuzz_damage.py`), and read in a process with limited
memory. A refusal is a MeshError, whose message a user sees. Anything else is a finding, and its file is kept. Bytes are
damaged in every format; in glTF also the structure: its JSON stays valid, but refers to what does not exist, in cycles,
or by values of another type.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from fuzz_readers import Reader, readers
from tqdm import tqdm

from zoomout_core.mesh.errors import MeshError

# Maximum processor seconds for a file of some kilobytes, since the machine may be busy, and bytes that reading
# may need.
MAX_SECONDS, MAX_MEMORY = 5.0, 4 << 30
# Words of Python and its libraries, which tell a user neither the problem nor the solution.
INTERNAL = re.compile(
    r"list index|index \d+ is out|object (is not|has no)|could not convert|invalid literal|values to unpack|"
    r"NoneType|not supported between|codec can't|Expecting |buffer (is smaller|size)|argument (must|should)|dtype|\b__|"
    r"'\w+' object|read \('?\w*'?\)"
)


def cases(name: str, reader: Reader, count: int, seed: int) -> Iterator[bytes]:
    """Damaged files for a reader, the same for the same seed."""
    for number in range(count):
        random = np.random.default_rng([seed, number, *name.encode()])
        yield reader.damage(reader.samples[number % len(reader.samples)], random)


def fault_of(reader: Reader, path: Path) -> tuple[str, str]:
    """A reader's result on a file: "read", "refused", or "finding" with a description."""
    begin = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader.read(path)
        end = "read", ""
    except MeshError as error:
        sentence = str(error)
        one = "\n" not in sentence and sentence.strip().endswith((".", "?"))
        end = ("refused", "") if one and not INTERNAL.search(sentence) else ("finding", f"is no sentence: {sentence!r}")
    except MemoryError:
        end = "finding", "MemoryError"
    except Exception as error:  # any other exception is a finding
        end = "finding", f"{type(error).__name__}: {error}"
    took = time.process_time() - begin
    return ("finding", f"{took:.1f} s") if took > MAX_SECONDS else end


def run(
    count: int, seed: int, keep: Path | None = None, names: list[str] | None = None
) -> tuple[Counter[str], list[str]]:
    """Read damaged files of all formats.

    Args:
        count: total number of files.
        seed: for the damages.
        keep: the folder for files with findings.
        names: names of readers; all if empty.

    Returns:
        The numbers of files read, refused, and with findings; and a line for each finding.
    """
    known = {name: reader for name, reader in readers().items() if names is None or name in names}
    ends: Counter[str] = Counter()
    findings = []
    share = -(-count // len(known))
    with tempfile.TemporaryDirectory() as folder, tqdm(total=share * len(known), disable=None) as bar:
        for name, reader in known.items():
            path = Path(folder) / f"broken{reader.ending}"
            for number, content in enumerate(cases(name, reader, share, seed)):
                path.write_bytes(content)
                end, what = fault_of(reader, path)
                ends[end] += 1
                bar.update()
                if end == "finding":
                    findings.append(f"{name} {number}: {what}")
                    if keep is not None:
                        keep.mkdir(parents=True, exist_ok=True)
                        (keep / f"{name.replace(' ', '_')}_{number}{reader.ending}").write_bytes(content)
    return ends, findings


def limit_memory() -> None:
    """Limit this process to the memory that reading a small file may need."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))


def main() -> None:
    """Read damaged files, and exit with 1 if one was neither read nor refused in a sentence."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20_000, help="files in all (default: 20000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("dist/fuzz"), help="folder for files with findings")
    parser.add_argument("--reader", action="append", help="one of the readers; may be repeated")
    arguments = parser.parse_args()
    limit_memory()
    ends, findings = run(arguments.count, arguments.seed, arguments.keep, arguments.reader)
    print(json.dumps(ends))
    for line in findings[:50]:
        print(line)
    sys.exit(bool(findings))


if __name__ == "__main__":
    main()
