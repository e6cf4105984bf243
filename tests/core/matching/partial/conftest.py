# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures of partial matching: a piece of a creature and the creature, in one unit."""

from __future__ import annotations

import pytest
from pieces import PartAndWhole, analyse_piece, lower_half

from zoomout_core.matching.partial.incomplete_shape import IncompleteShape, at_scale


@pytest.fixture(scope="session")
def lower() -> PartAndWhole:
    part, whole = lower_half()
    shapes = analyse_piece(whole), analyse_piece(part)
    scale = shapes[1].proxy.full.scale / shapes[0].proxy.full.scale
    return PartAndWhole(part, whole, IncompleteShape(at_scale(shapes[1], scale)), IncompleteShape(shapes[0]))
