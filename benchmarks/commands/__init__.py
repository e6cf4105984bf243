# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands of the benchmarks, one for each table, which are added when these modules are imported."""

from benchmarks.commands import maps, paper, timings, transfers  # noqa: F401
