# SPDX-License-Identifier: GPL-3.0-or-later
"""The report lists the parts of the source that provide something, and those that do not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from zoomout_core.matching.part_report import notes_on_parts, without_shares


def test_the_report_lists_the_parts_that_arrive_and_those_that_do_not() -> None:
    shares, arrived = np.array([0.7, 0.2, 0.06, 0.04]), np.array([0.25, 0.75, 0.0, 0.0])
    result: Any = SimpleNamespace(pair=SimpleNamespace(shares=shares), arrived=arrived, silent=np.array([2, 3]))
    notes = notes_on_parts(result, ["Skin", "Hair", "Hair", "Glasses"])
    assert notes == (
        "Share of the target's area by part of the source: 'Hair' 75.0%, 'Skin' 25.0%.",
        "Nothing arrives from 'Glasses'.",  # some of the hair does
    )
    # A report on a transfer repeats only the warning.
    assert without_shares(notes) == list(notes[1:])
    assert notes_on_parts(result, ["Skin"]) == ()  # matched as a single part
    result.silent = np.array([], dtype=int)
    assert notes_on_parts(result, ["Skin", "Hair", "Hair", "Glasses"]) == ()
