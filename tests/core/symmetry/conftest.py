# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures of the symmetry tests: the symmetry of a posed creature, detected once."""

from __future__ import annotations

import pytest
from creatures import Creature

import zoomout_core as zo


@pytest.fixture(scope="session")
def reflection(bent: Creature) -> zo.Symmetry:
    """The left-right symmetry of the posed creature."""
    return zo.detect_symmetry(bent.surface)[0]
