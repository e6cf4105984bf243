# SPDX-License-Identifier: GPL-3.0-or-later
"""Figures show their data: corresponding colours, values, matrices and curves."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import zoomout_core as zo
from zoomout_core.colors import LONELY

pytest.importorskip("matplotlib")

GRID = np.stack(np.meshgrid(np.arange(4.0), np.arange(6.0), indexing="ij"), axis=-1).reshape(-1, 2)
SHEET = zo.Surface(
    np.column_stack([GRID[:, 0], np.zeros(24), GRID[:, 1]]), [[i, i + 6, i + 7, i + 1] for i in range(18) if i % 6 < 5]
)
TURNED = zo.SurfaceMap.from_vertices(np.arange(24)[::-1], SHEET)


class Found(NamedTuple):
    """The fields of a match that figures use."""

    surface_map: zo.SurfaceMap
    confidence: np.ndarray
    has_partner: np.ndarray


def triangle_colors(figure: zo.plotting.Figure, number: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Colours (m, 3) and centres (m, 2) of the triangles of a surface in a figure."""
    surface = figure.axes[0].collections[number]
    middles = [path.vertices[:3].mean(axis=0) for path in surface.get_paths()]
    return surface.get_facecolor()[:, :3], np.array(middles)


def test_corresponding_triangles_have_the_same_colour() -> None:
    figure = zo.plotting.plot_map(SHEET, SHEET, TURNED, sides=1)
    (source, here), (target, there) = triangle_colors(figure), triangle_colors(figure, 1)
    assert [text.get_text() for text in figure.axes[0].texts] == ["source", "target"]
    # The map rotates the sheet by 180 degrees: a target triangle has the colour of the opposite source triangle.
    opposite = 2 * there.mean(axis=0) - there - there.mean(axis=0) + here.mean(axis=0)
    nearest = np.linalg.norm(opposite[:, None] - here, axis=2).argmin(axis=1)
    assert np.abs(source[nearest] - target).max() < 0.1
    assert np.ptp(target, axis=0).max() > 0.5


def test_surface_is_shown_from_the_front_and_from_behind() -> None:
    values = np.column_stack([GRID[:, 0] / 3, np.zeros(24), GRID[:, 1] / 5])
    figure = zo.plotting.plot_values(SHEET, values)
    (front, here), (behind, there) = triangle_colors(figure), triangle_colors(figure, 1)
    assert np.corrcoef(front[:, 0], here[:, 0])[0, 1] > 0.99  # seen from the front, x points right
    assert np.corrcoef(front[:, 2], here[:, 1])[0, 1] > 0.99
    assert np.corrcoef(behind[:, 0], there[:, 0])[0, 1] < -0.99


def test_confidence_is_red_to_blue_and_violet_without_a_partner() -> None:
    result = Found(TURNED, GRID[:, 0] / 3, GRID[:, 1] < 2.5)
    colors, middles = triangle_colors(zo.plotting.plot_confidence(SHEET, result, sides=1))
    lower, upper = colors[middles[:, 1] < -0.2], colors[middles[:, 1] > 0.2]
    np.testing.assert_allclose(upper, np.tile(LONELY, (len(upper), 1)))
    order = middles[middles[:, 1] < -0.2, 0].argsort()
    assert lower[order[0], 0] > lower[order[0], 2]
    assert lower[order[-1], 0] < lower[order[-1], 2]


def test_values_have_a_scale_and_nan_is_grey() -> None:
    values = GRID[:, 1].copy()
    values[GRID[:, 1] < 1.5] = np.nan
    figure = zo.plotting.plot_values(SHEET, values, "metres", limits=(0, 5), sides=1)
    colors, middles = triangle_colors(figure)
    grey = np.ptp(colors, axis=1) < 1e-9
    np.testing.assert_array_equal(grey, middles[:, 1] < -0.3)
    assert figure.axes[1].get_ylabel() == "metres"
    assert figure.axes[1].get_ylim() == (0, 5)


def test_functional_map_colours_are_centred_on_zero() -> None:
    figure = zo.plotting.plot_functional_map(np.diag([1.0, -3.0]))
    image = figure.axes[0].images[0]
    assert image.get_clim() == (-3, 3)
    assert figure.axes[0].get_xlabel() == "eigenfunctions of the source"


def test_error_curves_show_the_share_below_each_threshold() -> None:
    figure = zo.plotting.plot_error_curves({"one": np.array([0.0, 0.1, np.nan, 0.3])}, max_error=0.2)
    (line,) = figure.axes[0].lines
    thresholds, share = line.get_data()
    assert line.get_label() == "one"
    assert share[0] == 25
    assert share[-1] == 50
    assert thresholds[(share == 50).argmax()] == pytest.approx(0.1)


def test_plots_use_a_given_figure_or_create_one_for_notebooks() -> None:
    from matplotlib.figure import Figure

    figure = Figure()
    left, right = figure.subfigures(1, 2)
    assert zo.plotting.plot_map(SHEET, SHEET, TURNED, figure=left) is figure
    zo.plotting.plot_functional_map(np.eye(3), right)
    assert len(left.axes) == 1
    assert len(right.axes) == 2
    new = zo.plotting.plot_functional_map(np.eye(2))
    assert isinstance(new, zo.plotting.NotebookFigure)
    assert new._repr_png_().startswith(b"\x89PNG")


def test_show_map_places_the_meshes_side_by_side(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    polyscope = pytest.importorskip("polyscope")
    monkeypatch.setattr(polyscope, "init", partial(polyscope.init, "openGL_mock"))
    zo.plotting.show_map(SHEET, SHEET, Found(TURNED, np.ones(24), np.ones(24, dtype=bool)), frames=2)
    source, target = (polyscope.get_surface_mesh(name) for name in ("source", "target"))
    assert (source.n_vertices(), target.n_faces()) == (24, len(SHEET.triangles))
    low, high = polyscope.get_bounding_box()
    assert high[0] - low[0] == pytest.approx(3 * (2 + zo.plotting.GAP))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "plot",
    [
        lambda found: zo.plotting.plot_map(SHEET, SHEET, found),
        lambda found: zo.plotting.plot_confidence(SHEET, found),
        lambda found: zo.plotting.plot_values(SHEET, found.confidence),
    ],
)
def test_result_of_another_mesh_is_refused(plot: Callable[[Found], object]) -> None:
    short = Found(zo.SurfaceMap(TURNED.triangle[:9], TURNED.barycentric[:9], SHEET.triangles), np.ones(9), np.ones(9))
    with pytest.raises(ValueError, match=r"There are 9 .* for 24 vertices"):
        plot(short)


def test_missing_matplotlib_error_names_the_extra() -> None:
    script = "import sys; sys.modules['matplotlib'] = None; import zoomout_core as zo; zo.plotting"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (
        "ImportError: Figures need matplotlib, which is missing: in the checkout, pip install '.[plots]'."
        in done.stderr
    )
