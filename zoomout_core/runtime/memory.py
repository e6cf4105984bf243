# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory that is still available to this process, if the system reports it, and memory that objects take."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import scipy

# Memory limits and usage of containers, for both versions of control groups.
GROUPS = (
    ("sys/fs/cgroup/memory.max", "sys/fs/cgroup/memory.current"),
    ("sys/fs/cgroup/memory/memory.limit_in_bytes", "sys/fs/cgroup/memory/memory.usage_in_bytes"),
)
# Bytes of a node of scipy's search trees, which have about one node for every four points.
TREE_NODE = 72


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


def bytes_of(*values: object) -> int:
    """Bytes that objects take with all that they refer to, arrays above all; each is counted once."""
    total, seen, ahead = 0, set[int](), list(values)
    while ahead:
        value = ahead.pop()
        if id(value) in seen or isinstance(value, type):
            continue
        seen.add(id(value))
        if isinstance(value, np.ndarray):
            total += value.nbytes if value.base is None else 0
            ahead.append(value.base)
        elif isinstance(value, scipy.spatial.cKDTree):
            total += TREE_NODE * value.size
            ahead += [value.data, value.indices]
        else:
            total += sys.getsizeof(value)
            ahead += value.values() if isinstance(value, dict) else ()
            ahead += value if isinstance(value, tuple | list) else ()
            ahead += vars(value).values() if hasattr(value, "__dict__") and not callable(value) else ()
    return total
