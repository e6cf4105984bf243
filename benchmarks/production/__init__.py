# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparisons for production: live links with the operator, levels of detail with Blender's, bakes with Cycles.

Files are also opened in other programs.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from benchmarks.production.bakes import bake_both
from benchmarks.production.files import compress, open_elsewhere
from benchmarks.production.levels import levels_beside_blender
from benchmarks.production.links import link_each_kind

Row = dict[str, Any]

# Edge length of the linked character and voxel size of the target, in metres, and number of the target's vertices.
CELL, VOXEL, VERTICES = 0.0095, 0.006, 50_000
# Edge length of the character whose levels are made, in metres, and their shares of the vertices.
DETAILED, RATIOS = 0.019, (0.5, 0.25, 0.1)
# Voxel size and number of vertices of the targets of bakes.
BAKE_VOXEL, BAKE_VERTICES = 0.0125, 12_000

TABLES = ("links", "levels", "bakes", "compression", "loaders")


def run(
    tables: Collection[str] = TABLES,
    pictures: Path | None = None,
    node_modules: Path | None = None,
    panda: Path | None = None,
    godot: Path | None = None,
) -> dict[str, list[Row]]:
    """Make tables of the demo's character, see the modules.

    Args:
        tables: which of `TABLES` to make.
        pictures: a folder for pictures of the bakes.
        node_modules: a folder of packages for Node.js with further programs that read files.
        panda: a Python program with panda3d.
        godot: the program of Godot 3 with its editor.
    """
    makers: dict[str, Callable[[], list[Row]]] = {
        "links": lambda: link_each_kind(CELL, VOXEL, VERTICES),
        "levels": lambda: levels_beside_blender(DETAILED, RATIOS),
        "bakes": lambda: bake_both(DETAILED, BAKE_VOXEL, BAKE_VERTICES, pictures),
        "compression": lambda: compress(DETAILED),
        "loaders": lambda: open_elsewhere(DETAILED, node_modules, panda, godot),
    }
    return {name: makers[name]() for name in TABLES if name in tables}
