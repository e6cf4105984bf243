# SPDX-License-Identifier: GPL-3.0-or-later
"""Figures of maps by colours, confidence, values on surfaces, functional maps and error curves.

Each function returns a matplotlib figure (extra `plots`), which a notebook shows and `savefig` writes. It can draw into
an existing `figure`, such as `pyplot.figure()`, or into a subfigure, whose figure it returns. `show_map` opens a window
(extra `window`).
"""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO

import numpy as np

from zoomout_core.runtime.extras import install_hint

try:
    from matplotlib import colormaps
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from matplotlib.figure import Figure, SubFigure
except ModuleNotFoundError as error:
    raise ImportError(f"Figures need {error.name}, which is missing: {install_hint('plots')}.") from error

from zoomout_core.arrays import Floats, Integers
from zoomout_core.colors import BAD_TO_GOOD, confidence_colors, place_colors
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.shapes import ShapeLike, as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_normals
from zoomout_core.runtime.option_names import suggest_names
from zoomout_core.transfer.rules import Match

# Sizes in a new figure in inches: the height of a surface, and a panel with axes.
HEIGHT = 3.5
PANEL = 5.0, 4.0
# Space between surfaces, relative to the longest extent of one.
GAP = 0.15
# Brightness of a face seen edge-on; a face towards the viewer has 1.
DARKEST = 0.35


class NotebookFigure(Figure):
    """A figure that notebooks show without pyplot."""

    def _repr_png_(self) -> bytes:
        image = BytesIO()
        self.savefig(image, format="png", bbox_inches="tight")
        return image.getvalue()


def plot_map(
    source: ShapeLike,
    target: ShapeLike,
    result: Match | SurfaceMap,
    sides: int = 2,
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw source and target side by side, with equal colours at corresponding places.

    Args:
        source: the shape that the map lands on, coloured by position.
        target: the shape that the map starts from.
        result: the match, or only its map.
        sides: 1 to see them from the front, 2 to see them from behind as well.
        figure: to draw into; a new one if not given.

    Raises:
        ValueError: the map does not start from this target.

    Example:
        >>> zo.plotting.plot_map(source, target, result).savefig(folder / "map.png")
    """
    surfaces, colors = _corresponding(source, target, result)
    return _whole(_row([*zip(surfaces, colors, ("source", "target"), strict=True)], sides, figure))


def show_map(source: ShapeLike, target: ShapeLike, result: Match | SurfaceMap, frames: int | None = None) -> None:
    """Open an interactive window with source and target side by side; equal colours correspond.

    Args:
        source: the shape that the map lands on.
        target: the shape that the map starts from; a match also shows its confidence as a second colouring.
        result: the match, or only its map.
        frames: close the window after this number of frames; None to leave it to the user.

    Raises:
        ImportError: polyscope, of the extra `window`, is not installed.
        ValueError: the map does not start from this target.
    """
    try:
        import polyscope
    except ModuleNotFoundError as error:
        raise ImportError(f"Windows need polyscope, which is missing: {install_hint('window')}.") from error
    (here, there), colors = _corresponding(source, target, result)
    if not polyscope.is_initialized():
        polyscope.set_use_prefs_file(False)  # otherwise it writes .polyscope.ini and imgui.ini to the current folder
        polyscope.init()
    polyscope.remove_all_structures()
    right = here.vertices[:, 0].max() + GAP * np.ptp(here.vertices[:, 0]) - there.vertices[:, 0].min()
    beside = there.vertices + np.array([right, 0, 0])
    for name, places, surface, color in (
        ("source", here.vertices, here, colors[0]),
        ("target", beside, there, colors[1]),
    ):
        mesh = polyscope.register_surface_mesh(name, np.nan_to_num(places), surface.triangles)
        mesh.add_color_quantity("place on the source", np.nan_to_num(color), enabled=True)
        if name == "target" and not isinstance(result, SurfaceMap):
            mesh.add_scalar_quantity("confidence", result.confidence, vminmax=(0, 1))
    polyscope.show(*(() if frames is None else (frames,)))


def plot_confidence(
    target: ShapeLike, result: Match, sides: int = 2, figure: Figure | SubFigure | None = None
) -> Figure:
    """Draw the target coloured by confidence, from red for none to blue; violet areas have no partner.

    Args:
        target: the shape that was matched.
        result: the match.
        sides: 1 to see it from the front, 2 to see it from behind as well.
        figure: to draw into; a new one if not given.

    Raises:
        ValueError: the match is not of this target.

    Example:
        >>> zo.plotting.plot_confidence(target, result).savefig(folder / "confidence.png")
    """
    surface = as_surface(target)
    _check_length(result.confidence, surface, "values")
    colors = confidence_colors(result.confidence, result.has_partner)
    drawn = _row([(surface, colors, "")], sides, figure)
    scale = LinearSegmentedColormap.from_list("confidence", BAD_TO_GOOD)
    drawn.colorbar(ScalarMappable(Normalize(0, 1), scale), ax=drawn.axes, label="confidence", shrink=0.7)
    return _whole(drawn)


def plot_values(
    shape: ShapeLike,
    values: Floats,
    label: str = "",
    limits: tuple[float, float] | None = None,
    colors: str = "viridis",
    sides: int = 2,
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw a shape coloured by values at its vertices, such as errors, a descriptor or an eigenfunction.

    Args:
        shape: the shape.
        values: (n,) numbers; or (n, 3) red, green and blue, 0 to 1. Values that are not finite are grey.
        label: the quantity and its unit.
        limits: the values at the ends of the colour map; the minimum and maximum if not given.
        colors: the name of a matplotlib colour map.
        sides: 1 to see it from the front, 2 to see it from behind as well.
        figure: to draw into; a new one if not given.

    Raises:
        ValueError: there is not one value for each vertex.

    Example:
        >>> zo.plotting.plot_values(source, source.vertices[:, 2], label="height").savefig(folder / "height.png")
    """
    surface, values = as_surface(shape), np.asarray(values, dtype=float)
    _check_length(values, surface, "values")
    if values.ndim == 2:
        return _whole(_row([(surface, values, "")], sides, figure))
    finite = values[np.isfinite(values)]
    scale = Normalize(*(limits or (finite.min(initial=np.inf), finite.max(initial=-np.inf)) if len(finite) else (0, 1)))
    painted = colormaps[colors](scale(np.nan_to_num(values)))[:, :3]
    painted[~np.isfinite(values)] = 0.6
    drawn = _row([(surface, painted, "")], sides, figure)
    drawn.colorbar(ScalarMappable(scale, colors), ax=drawn.axes, label=label, shrink=0.7)
    return _whole(drawn)


def plot_functional_map(functional_map: Floats, figure: Figure | SubFigure | None = None) -> Figure:
    """Draw the matrix of a functional map, which is nearly a diagonal of +-1 for nearly isometric shapes.

    Args:
        functional_map: (k_target, k_source).
        figure: to draw into; a new one if not given.

    Example:
        >>> zo.plotting.plot_functional_map(result.functional_map).savefig(folder / "functional_map.png")
    """
    drawn = figure or NotebookFigure(figsize=(PANEL[1] * 1.2, PANEL[1]), layout="constrained")
    axes = drawn.add_subplot()
    most = float(np.abs(functional_map).max())
    image = axes.imshow(functional_map, cmap="RdBu_r", vmin=-most, vmax=most, interpolation="nearest")
    axes.set(xlabel="eigenfunctions of the source", ylabel="eigenfunctions of the target")
    drawn.colorbar(image, ax=axes)
    return _whole(drawn)


@suggest_names
def plot_error_curves(
    errors: Mapping[str, Floats], max_error: float = 0.25, figure: Figure | SubFigure | None = None
) -> Figure:
    """Draw cumulative error curves: the share of places up to each error.

    Args:
        errors: errors (c,) by label, such as those of `geodesic_error`; NaN counts as above all.
        max_error: the largest error shown.
        figure: to draw into; a new one if not given.

    Example:
        >>> errors = zo.geodesic_error(result, source, np.arange(len(truth)), truth)
        >>> zo.plotting.plot_error_curves({"ours": errors}).savefig(folder / "errors.png")
    """
    drawn = figure or NotebookFigure(figsize=PANEL, layout="constrained")
    axes = drawn.add_subplot()
    thresholds = np.linspace(0, max_error, 201)
    for name, values in errors.items():
        axes.plot(thresholds, 100 * share_below(np.asarray(values), thresholds), label=name)
    set_error_axes(axes, max_error)
    axes.legend(loc="lower right")
    return _whole(drawn)


def share_below(errors: Floats, thresholds: Floats) -> Floats:
    """(t,) the share of errors (n,) up to each threshold (t,); NaN counts as above all."""
    return np.searchsorted(np.sort(errors), thresholds, side="right") / len(errors)


def set_error_axes(axes: Axes, max_error: float) -> None:
    """Label axes of cumulative error curves in percent, up to an error."""
    axes.set(xlabel="geodesic error, at unit area", ylabel="% of places", xlim=(0, max_error), ylim=(0, 100))
    axes.grid(alpha=0.3)


def draw_surface(axes: Axes, surface: Surface, color: Floats, left: float = 0.0, sides: int = 1) -> float:
    """Draw a surface from the front, and optionally beside it from behind; its longest extent is one.

    The view is along the axis of the smallest extent; of the other axes, the first points right, the second up.

    Args:
        axes: what to draw on.
        surface: the surface.
        color: (n, 3) red, green and blue of its vertices, 0 to 1.
        left: its left end on the axes.
        sides: 1 for the front, 2 for both.

    Returns:
        The right end of the drawing.
    """
    vertices = np.nan_to_num(surface.vertices)
    used = vertices[np.unique(surface.triangles)]
    depth = int(np.argmin(np.ptp(used, axis=0)))
    right, up = (axis for axis in range(3) if axis != depth)
    towards = -1.0 if depth == 1 else 1.0  # so that the picture is not mirrored
    low, high = used.min(axis=0), used.max(axis=0)
    points = (vertices - (low + high) / 2) / max(float((high - low).max()), 1e-300)
    points = points[:, [right, up, depth]] * [1, 1, towards]
    width = float(np.ptp(points[np.unique(surface.triangles), 0]))
    for seen in (points, points * [-1, 1, -1])[:sides]:
        draw_triangles(axes, seen, surface.triangles, color, left + width / 2)
        left += width + GAP
    return left - GAP


def draw_triangles(axes: Axes, points: Floats, triangles: Integers, color: Floats, left: float) -> None:
    """Draw triangles from back to front (painter's algorithm).

    Args:
        axes: what to draw on.
        points: (n, 3) coordinates of the vertices to the right, upwards and towards the viewer.
        triangles: (m, 3) vertex numbers.
        color: (n, 3) red, green and blue of the vertices.
        left: offset to the right.
    """
    order = np.argsort(points[triangles, 2].mean(axis=1))
    shade = DARKEST + (1 - DARKEST) * np.abs(triangle_normals(points, triangles)[:, 2])
    shaded = (color[triangles].mean(axis=1) * shade[:, None])[order]
    corners = (points[:, :2] + [left, 0])[triangles[order]]
    axes.add_collection(PolyCollection(list(corners), facecolors=shaded, edgecolors=shaded, linewidths=0.2))


def _corresponding(
    source: ShapeLike, target: ShapeLike, result: Match | SurfaceMap
) -> tuple[tuple[Surface, Surface], tuple[Floats, Floats]]:
    """Two surfaces, and colours (n_s, 3) and (n_t, 3) of their vertices, equal at corresponding places."""
    surfaces = as_surface(source), as_surface(target)
    found = result if isinstance(result, SurfaceMap) else result.surface_map
    _check_length(found.triangle, surfaces[1], "images")
    colors = place_colors(surfaces[0].vertices, surfaces[0].vertices)
    return surfaces, (colors, found.interpolate(colors))


def _row(drawn: list[tuple[Surface, Floats, str]], sides: int, figure: Figure | SubFigure | None) -> Figure | SubFigure:
    """Draw surfaces with their colours and captions side by side."""
    figure = figure or NotebookFigure(layout="constrained")
    axes = figure.add_subplot()
    right = -GAP
    for surface, color, caption in drawn:
        left = right + GAP
        right = draw_surface(axes, surface, color, left, sides)
        axes.text((left + right) / 2, 0.55, caption, ha="center")
    axes.set(xlim=(-GAP / 2, right + GAP / 2), ylim=(-0.55, 0.65), aspect="equal")
    axes.set_axis_off()
    if isinstance(figure, NotebookFigure):
        figure.set_size_inches(HEIGHT * max(right + GAP, 1.2), HEIGHT * 1.2)
    return figure


def _whole(figure: Figure | SubFigure) -> Figure:
    """The figure that a subfigure belongs to, or the figure itself."""
    return figure.figure


def _check_length(values: Floats | Integers, surface: Surface, what: str) -> None:
    if len(values) != len(surface.vertices):
        raise ValueError(
            f"There are {len(values)} {what} for {len(surface.vertices)} vertices: check that they belong to this mesh."
        )
