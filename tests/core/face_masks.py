# SPDX-License-Identifier: GPL-3.0-or-later
"""A face with expression keys, whose landmarks are known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import zoomout_core as zo
from zoomout_core.samples.grids import grid, grid_faces, triangles_of

COLUMNS, ROWS, STEP = 50, 54, 0.05
LEFT, BOTTOM = -1.25, -1.5
# The two ends of each slit, as columns, and its row; left is at positive x.
MOUTH, LEFT_EYE, RIGHT_EYE = (17, 33, 20), (31, 39, 40), (11, 19, 40)
GAP = 0.01
NOSE, CHIN = (0.0, 0.1), (0.0, -0.9)
ARKIT = ("eyeBlinkLeft", "eyeBlinkRight", "jawOpen", "browDownLeft")


class Face(NamedTuple):
    """A mask with a mouth, two eyes, nose and chin, and its keys."""

    surface: zo.Surface
    keys: zo.Attribute
    corners: list[int]  # of mouth and eyes, in the order of the landmarks
    opens: np.ndarray  # (3, n) how far vertices are inside the slits


def number(column: int, row: int, places: np.ndarray) -> int:
    """The vertex of the flat grid in a column and a row."""
    wanted = np.array([LEFT + STEP * column, BOTTOM + STEP * row])
    return int(np.linalg.norm(places[:, :2] - wanted, axis=1).argmin())


def make_face(names: tuple[str, ...] = ARKIT, joined: bool = False) -> Face:
    """The mask; its lips may be joined."""
    flat = grid(LEFT + STEP * np.arange(COLUMNS + 1), BOTTOM + STEP * np.arange(ROWS + 1)).vertices
    triangles = triangles_of(grid_faces(COLUMNS, ROWS)).copy()
    above = flat[triangles].mean(axis=1)[:, 1]
    places, corners = flat.copy(), []
    for first, last, row in (MOUTH, LEFT_EYE, RIGHT_EYE):
        rim = [number(column, row, flat) for column in range(first + 1, last)]
        corners += [number(last, row, flat), number(first, row, flat)]
        if joined and row == MOUTH[2]:
            continue
        copies = np.arange(len(places), len(places) + len(rim))
        renamed = np.arange(len(places) + len(rim))
        renamed[rim] = copies
        over = above > BOTTOM + STEP * row
        triangles[over] = renamed[triangles[over]]
        places = np.vstack([places, places[rim] + [0, GAP, 0]])
    x, y = places[:, 0], places[:, 1]

    def inside(slit: tuple[int, int, int]) -> np.ndarray:
        """How far vertices are from the ends of a slit, from 0 to 1."""
        first, last = LEFT + STEP * slit[0], LEFT + STEP * slit[1]
        return np.sqrt(np.clip(1 - ((2 * x - first - last) / (last - first)) ** 2, 0, 1))

    opens = np.array([inside(slit) for slit in (MOUTH, LEFT_EYE, RIGHT_EYE)])
    lids = []
    for slit, share in zip((LEFT_EYE, RIGHT_EYE), opens[1:], strict=True):
        beyond = y - BOTTOM - STEP * slit[2]
        lids.append(np.where(beyond > GAP / 2, 0.12 * share * np.clip(1 - beyond / 0.4, 0, 1), 0))
    below = y < BOTTOM + STEP * MOUTH[2] + GAP / 2
    jaw = np.where(below, 0.16 * opens[0], 0) * [[0], [1], [0]]
    bump = sum(
        height * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / width**2)
        for at, height, width in ((NOSE, 0.5, 0.15), (CHIN, 0.4, 0.15))
    )
    neck = 2 * np.maximum(-1 - y, 0)  # behind the chin
    rest = np.column_stack([x, y + sum(lids), bump - 0.3 * x**2 - neck])
    up = np.array([0.0, 1, 0])
    brow = np.zeros_like(rest)
    brow[y > 0.8] = [0, -0.02, 0]
    offsets = np.stack([-lids[0][:, None] * up, -lids[1][:, None] * up, -jaw.T, brow], axis=1)
    keys = zo.Attribute("keys", zo.Domain.POINT, zo.Kind.OFFSET, offsets, names)
    # Left before right in the mouth, and outer before inner in the eyes.
    return Face(zo.Surface(rest, triangles), keys, [*corners[:4], corners[5], corners[4]], opens)
