# SPDX-License-Identifier: GPL-3.0-or-later
"""Things with several symmetries: are all of them found and ranked first?"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import zoomout_core as zo
from benchmarks.pictures import Picture, draw
from zoomout_core.arrays import Floats
from zoomout_core.mesh.surface import Surface

# Symmetries of these things are rigid; maps with a larger distance, relative to the root of the area, are wrong.
RIGID = 0.015


def object_rows() -> list[dict[str, Any]]:
    """A row for each thing: its number n of symmetries, and how many of the first n found are right and distinct.

    Also the maximum distance of those from a rigid motion, and the mean distance of vertices from their images after
    a whole cycle, both in thousandths of the square root of the area.
    """
    rows = []
    for name, surface, count in things():
        found = zo.detect_symmetry(surface, max_count=count)
        motions: list[Floats] = []
        off = 0.0
        for symmetry in found:
            motion, distance = rigid_motion(surface, symmetry.surface_map)
            if distance < RIGID and all(np.linalg.norm(motion - other) > 0.5 for other in motions):
                motions.append(motion)
                off = max(off, distance)
        rows.append(
            {
                "thing": name,
                "vertices": len(surface.vertices),
                "symmetries": count,
                "right among the first": len(motions),
                "off a rigid motion": 1000 * off,
                "return error": 1000 * float(np.mean([symmetry.return_error for symmetry in found])),
            }
        )
    return rows


def rigid_motion(surface: Surface, surface_map: zo.SurfaceMap) -> tuple[Floats, float]:
    """The orthogonal matrix (3, 3) closest to a map of a surface onto itself, and the mean distance at unit area."""
    here = surface.vertices
    there = surface_map.interpolate(here)
    here, there = here - here.mean(axis=0), there - there.mean(axis=0)
    U, _, Vt = np.linalg.svd(there.T @ here)
    motion = U @ Vt
    off = np.linalg.norm(here @ motion.T - there, axis=1).mean()
    return motion, float(off / np.sqrt(surface.area))


def draw_symmetries(path: Path, surface: Surface, max_count: int) -> None:
    """Draw a coloured surface, and the colours transferred by each of its first symmetries."""
    pictures = [
        Picture(f"{number}. {_name(symmetry)}", surface, surface, symmetry.surface_map)
        for number, symmetry in enumerate(zo.detect_symmetry(surface, max_count=max_count), start=1)
    ]
    draw(path, pictures)


def things() -> Iterator[tuple[str, Surface, int]]:
    """Name, surface and number of symmetries of each thing."""
    from benchmarks.generate.things import THINGS, thing  # only if Blender is installed to build them

    for name, (_, count) in THINGS.items():
        yield name, thing(name), count


def _name(symmetry: zo.Symmetry) -> str:
    kind = "reflection" if symmetry.reverses_orientation else f"rotation of order {symmetry.order}"
    return f"{kind}, {symmetry.certainty:.0%} certain"
