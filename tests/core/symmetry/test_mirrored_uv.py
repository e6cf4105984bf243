# SPDX-License-Identifier: GPL-3.0-or-later
"""UV maps copy the layout of one side to the other, beside it or over it."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import Creature

import zoomout_core as zo
from zoomout_core.symmetry.uv import symmetrise_uv


def left_layout(bent: Creature) -> np.ndarray:
    """(c, 2) UVs that project both sides onto each other, seen from the side."""
    corners = bent.directions[bent.surface.corner_vertex]
    return corners[:, 1:] / 10 + [0.25, 0.5]


def on_left(bent: Creature) -> np.ndarray:
    """(c,) whether a corner's face is on the left side."""
    return np.repeat(bent.directions[bent.surface.triangles, 0].mean(axis=1) > 0, 3)


def uv_map(values: np.ndarray) -> zo.Attribute:
    return zo.Attribute("UVMap", zo.Domain.CORNER, zo.Kind.UV, values)


def clear_of_the_line(bent: Creature) -> np.ndarray:
    return np.abs(bent.directions[bent.surface.corner_vertex, 0]) > 0.2


def test_each_side_keeps_its_place_in_the_atlas(reflection: zo.Symmetry, bent: Creature) -> None:
    layout = left_layout(bent)
    turn = np.array([[0, -0.5], [0.5, 0]])
    beside = (layout - [0.25, 0.5]) @ turn.T + [0.75, 0.5]
    left = on_left(bent)[:, None]
    warped = beside + 0.01 * np.sin(300 * beside[:, ::-1])
    found = symmetrise_uv(uv_map(np.where(left, layout, warped)), reflection).values
    off = np.linalg.norm(found - np.where(left, layout, beside), axis=1)[clear_of_the_line(bent)]
    assert np.median(off) < 0.004
    assert off.mean() < 0.3 * np.linalg.norm(warped - beside, axis=1)[~left[:, 0]].mean()


def test_both_sides_can_share_their_texels(reflection: zo.Symmetry, bent: Creature) -> None:
    layout = left_layout(bent)
    elsewhere = np.where(on_left(bent)[:, None], layout, 0.9)
    for given in ("over", "own"):  # a layout without extent has no position of its own
        found = symmetrise_uv(uv_map(elsewhere), reflection, layout=given).values
        assert np.median(np.linalg.norm(found - layout, axis=1)[clear_of_the_line(bent)]) < 0.003


def test_sides_exchange_their_layouts(reflection: zo.Symmetry, bent: Creature) -> None:
    left, clear = on_left(bent)[:, None], clear_of_the_line(bent)
    layout = left_layout(bent)
    small = 0.5 * layout + [0.5, 0]
    over = symmetrise_uv(uv_map(np.where(left, layout, small)), reflection, "exchange", "over").values
    assert np.median(np.linalg.norm(over - np.where(left, small, layout), axis=1)[clear]) < 0.003
    own = symmetrise_uv(uv_map(np.where(left, layout, small)), reflection, "exchange").values
    assert np.median(np.linalg.norm(own - np.where(left, layout, small), axis=1)[clear]) < 0.006


def test_an_island_across_the_line_stays_whole(reflection: zo.Symmetry, bent: Creature) -> None:
    corners = bent.directions[bent.surface.corner_vertex]
    plain = corners[:, ::2] / 4 + [0.5, 0.5]
    front = np.repeat(bent.directions[bent.surface.triangles, 1].mean(axis=1) < 0, 3)
    whole = np.where(front[:, None], plain, plain + np.array([0, 2]))
    bulge = np.where(corners[:, :1] < 0, 0.01 * np.sin(30 * corners[:, 2:]) * corners[:, :1], 0)
    found = symmetrise_uv(uv_map(whole + bulge), reflection).values
    losing = np.repeat(reflection.distance[bent.surface.triangles].mean(axis=1) < 0, 3)
    winning_vertices = np.zeros(len(bent.directions), dtype=bool)
    winning_vertices[bent.surface.corner_vertex[~losing & front]] = True
    shared = losing & front & winning_vertices[bent.surface.corner_vertex]
    assert shared.sum() > 20
    np.testing.assert_allclose(found[shared], (whole + bulge)[shared])
    off = np.linalg.norm(found - whole, axis=1)[losing & clear_of_the_line(bent)]
    assert np.median(off) < 0.006


@pytest.mark.parametrize(
    ("wish", "error", "message"),
    [
        ({"direction": "average"}, zo.MeshError, "cannot be averaged"),
        ({"layout": "under"}, ValueError, "layout"),
    ],
)
def test_invalid_direction_and_layout_are_refused(
    reflection: zo.Symmetry, bent: Creature, wish: dict, error: type, message: str
):
    with pytest.raises(error, match=message):
        symmetrise_uv(uv_map(left_layout(bent)), reflection, **wish)
