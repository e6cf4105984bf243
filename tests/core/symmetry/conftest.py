# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests of symmetries share: a posed creature, detected once."""

from __future__ import annotations

import pytest
from creatures import Creature

import zoomout_core as zo


@pytest.fixture(scope="session")
def reflection(bent: Creature) -> zo.Symmetry:
    """The posed creature's left and right."""
    return zo.detect_symmetry(bent.surface)[0]
