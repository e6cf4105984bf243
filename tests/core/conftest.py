# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures of the core's tests."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest
from creatures import Creature, creature

from zoomout_core.matching.preparation.proxy import PROXY
from zoomout_core.tuning import retune

# Tests write nothing to the user's cache.
os.environ["ZOOMOUT_CACHE"] = "off"


@pytest.fixture(scope="session", autouse=True)
def coarse_meshes() -> Iterator[None]:
    """Meshes of a few hundred vertices are analysed as they are: `preparation/test_proxy.py` tests subdivided ones."""
    with retune(PROXY, fewest=12):
        yield


@pytest.fixture(scope="session")
def resting() -> Creature:
    return creature(4000, seed=0, bend=0.0)


@pytest.fixture(scope="session")
def bent() -> Creature:
    """The same creature in another pose, with another topology and fewer vertices."""
    return creature(2500, seed=1, bend=0.9)
