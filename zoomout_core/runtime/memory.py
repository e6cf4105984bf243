# SPDX-License-Identifier: GPL-3.0-or-later
"""The memory that is still available to this process, if the system reports it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

# Memory limits and usage of containers, for both versions of control groups.
GROUPS = (
    ("sys/fs/cgroup/memory.max", "sys/fs/cgroup/memory.current"),
    ("sys/fs/cgroup/memory/memory.limit_in_bytes", "sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


def free_memory(root: str | os.PathLike[str] = "/") -> int | None:
    """Bytes that are still available to this process: the minimum of free memory and its limits; None if unknown.

    On macOS, which does not report free memory, all memory of the machine. Unknown on Windows, which moves used memory
    to disk. The root is the folder of the system's files.
    """
    return min((max(0, each) for each in _limits(Path(root))), default=None)


def _limits(root: Path) -> Iterator[int]:
    for most, taken in GROUPS:
        with suppress(OSError, ValueError):  # the group is missing or has no limit
            yield int((root / most).read_text()) - int((root / taken).read_text())
    with suppress(OSError, ValueError, StopIteration):
        lines = (root / "proc/meminfo").read_text().splitlines()
        yield 1024 * next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    with suppress(AttributeError, OSError, ValueError):  # the call or name is missing
        yield os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with suppress(ImportError, OSError, ValueError, IndexError):
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limit != resource.RLIM_INFINITY:
            yield limit - int((root / "proc/self/statm").read_text().split()[0]) * resource.getpagesize()
