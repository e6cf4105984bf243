# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line of the benchmarks; `commands` has a function for each table."""

from __future__ import annotations

import benchmarks.commands  # noqa: F401
from benchmarks.command import main

if __name__ == "__main__":
    main()
