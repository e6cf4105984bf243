# SPDX-License-Identifier: GPL-3.0-or-later
"""A match file is accepted only for the surfaces that it was computed for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from creatures import creature

import zoomout_core as zo
from zoomout_core.maps.known_match import KnownMatch

SOURCE, TARGET = creature(120, seed=1).surface, creature(100, seed=2).surface
TRUSTED = np.linspace(0, 1, 100)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A match file."""
    vertex = np.arange(100) % 90
    surface_map = zo.SurfaceMap.from_vertices(vertex, SOURCE)
    surface_map.save(tmp_path / "map.npz", confidence=TRUSTED, has_partner=TRUSTED > 0.2)
    return tmp_path / "map.npz"


def test_load_restores_stored_values_and_defaults_missing_ones(path: Path) -> None:
    match = KnownMatch.load(path, SOURCE, TARGET)
    np.testing.assert_array_equal(match.surface_map.vertex, np.arange(100) % 90)
    np.testing.assert_array_equal(match.confidence, TRUSTED)
    np.testing.assert_array_equal(match.has_partner, TRUSTED > 0.2)
    assert match.source_has_partner.dtype == bool
    assert match.source_has_partner.all()
    assert len(match.source_has_partner) == 120


def test_another_target_is_refused(path: Path) -> None:
    with pytest.raises(zo.MeshError, match=r"of 100 vertices between other surfaces, but this target has 80"):
        KnownMatch.load(path, SOURCE, creature(80, seed=2).surface)


def test_reordered_source_triangles_are_refused(path: Path) -> None:
    turned = zo.Surface(SOURCE.vertices, SOURCE.triangles[::-1])
    with pytest.raises(zo.MeshError, match="onto another source than this one of 120 vertices"):
        KnownMatch.load(path, turned, TARGET)


def test_source_values_of_wrong_length_are_refused(path: Path) -> None:
    zo.SurfaceMap.from_vertices(np.arange(100) % 90, SOURCE).save(path, source_has_partner=np.ones(7))
    with pytest.raises(zo.MeshError, match="onto another source"):
        KnownMatch.load(path, SOURCE, TARGET)
