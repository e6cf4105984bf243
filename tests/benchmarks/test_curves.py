# SPDX-License-Identifier: GPL-3.0-or-later
"""The figures of the tables: cumulative errors, colours of errors, and valid images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from benchmarks.curves import THRESHOLDS, draw_curves, draw_lines, share_below
from benchmarks.pictures import View, draw_views, heat, spread
from zoomout_core.mesh.surface import Surface


def test_shares_count_errors_up_to_each_threshold_except_nan() -> None:
    shares = share_below(np.array([0.0, 5.0, 250.0, np.nan]))
    assert (shares[0], shares[1], shares[-1]) == (0.25, 0.5, 0.75)


def test_figures_are_written_to_new_folders(tmp_path: Path) -> None:
    steps = np.linspace(0, 1, len(THRESHOLDS))
    draw_curves(tmp_path / "a" / "curves.png", {"one": {"ICP": steps}, "two": {"ICP": steps, "ZoomOut": steps**2}})
    draw_lines(tmp_path / "b" / "lines.png", {"ZoomOut": ([1, 2], [30.0, 20.0])}, "step", "error")
    surface = Surface(np.eye(3), np.array([[0, 1, 2]]))
    draw_views(tmp_path / "c" / "views.png", [[View("one", surface, np.ones((3, 3)))]])
    for name in ("a/curves.png", "b/lines.png", "c/views.png"):
        assert imread(tmp_path / name).std() > 0


def test_the_legend_has_the_lines_of_all_panels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[list[str]] = []

    def legend(_figure: Figure, _handles: object, labels: list[str], **_how: object) -> None:
        drawn.append(list(labels))

    monkeypatch.setattr(Figure, "legend", legend)
    steps = np.linspace(0, 1, len(THRESHOLDS))
    draw_curves(tmp_path / "curves.png", {"one": {"a": steps, "b": steps}, "two": {"c": steps, "a": steps}})
    assert drawn == [["a", "b", "c"]]


def test_heat_runs_from_white_to_black_with_nan_as_worst() -> None:
    colours = heat(np.array([0.0, 50, 100, 200, np.nan]), 100)
    brightness = colours.sum(axis=1)
    assert brightness[0] > 2.9
    assert brightness[1] < brightness[0]
    assert np.allclose(colours[3:], colours[2])
    assert brightness[2] < 0.1


def test_values_spread_to_nearest_vertices() -> None:
    surface = Surface(np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [3, 1, 0]]), np.array([[0, 1, 3], [1, 2, 3]]))
    assert list(spread(np.array([7.0, 9.0]), np.array([0, 3]), surface)) == [7, 7, 9, 9]
