# SPDX-License-Identifier: GPL-3.0-or-later
"""Figures of tables: cumulative error curves, and one quantity against another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from zoomout_core import plotting
from zoomout_core.arrays import Floats

# Errors times 1000 at which cumulative curves are sampled.
THRESHOLDS = np.arange(0.0, 251, 5)
PANEL = 6.0, 5.0  # inches
# Letters of a legend per inch, and the width of a line's key in letters.
LETTERS, KEY = 13, 8


def share_below(errors: Floats) -> list[float]:
    """The share of errors (n,), times 1000, up to each of `THRESHOLDS`; NaN counts as infinite."""
    return plotting.share_below(errors, THRESHOLDS).tolist()


def draw_curves(path: Path, panels: Mapping[str, Mapping[str, Floats | Sequence[float]]]) -> None:
    """Write cumulative error curves to an image file.

    Args:
        path: the file.
        panels: for each panel's title and each method the shares of `share_below`. Methods of this project, whose
            names begin with `ZoomOut` or `zo.`, have thick lines; initial and published ones are dashed.
    """
    figure = Figure(figsize=(PANEL[0] * len(panels), PANEL[1]), layout="constrained")
    methods = list(dict.fromkeys(method for curves in panels.values() for method in curves))
    for number, (title, curves) in enumerate(panels.items(), start=1):
        axes = figure.add_subplot(1, len(panels), number)
        for method, curve in curves.items():
            axes.plot(
                THRESHOLDS / 1000,
                100 * np.asarray(curve),
                color=colormaps["tab20"](methods.index(method)),
                linestyle="--" if method.endswith("published") or method == "initial" else "-",
                linewidth=2.5 if method.startswith(("ZoomOut", "zo.")) else 1.4,
                label=method,
            )
        axes.set_title(title)
        plotting.set_error_axes(axes, THRESHOLDS[-1] / 1000)
    _finish(figure, path)


def draw_lines(
    path: Path, lines: Mapping[str, tuple[Sequence[float], Sequence[float]]], xlabel: str, ylabel: str
) -> None:
    """Write one panel of lines to an image file.

    Args:
        path: the file.
        lines: x and y of each line, by name.
        xlabel: label of the x axis.
        ylabel: label of the y axis, which begins at zero.
    """
    figure = Figure(figsize=PANEL, layout="constrained")
    axes = figure.add_subplot()
    for name, (x, y) in lines.items():
        axes.plot(x, y, marker="o", markersize=3, label=name)
    axes.set(xlabel=xlabel, ylabel=ylabel)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    _finish(figure, path)


def _finish(figure: Figure, path: Path) -> None:
    """Add one legend for all panels, whose colours go by name, and write the file."""
    handles = {
        label: line for axes in figure.axes for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    columns = max(1, int(figure.get_figwidth() * LETTERS / (max(map(len, handles)) + KEY)))
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns, fontsize="small")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
