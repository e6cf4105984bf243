# SPDX-License-Identifier: GPL-3.0-or-later
"""Packages of the add-on import each other in one direction only, as documented in ARCHITECTURE.md."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import blender_addon

ADDON = Path(blender_addon.__file__).parent
# Each may import those that stand before it.
LAYERS = (
    "translations",
    "colors",
    "jobs",
    "mesh_data",
    "storage",
    "adapters",
    "properties",
    "scene",
    "viewport",
    "services",
    "operators",
    "presets",
    "ui",
    "cli",
)
# The same within `mesh_data`.
GROUPS = ("arrays", "matrices", "attributes", "textures", "surfaces", "keys", "rigs", "writing", "objects")
# Modules that start the add-on, or use it as a script does: no layer imports these.
OUTSIDE = ("__init__", "__main__", "api", "watch", "demo")


def layer(path: Path) -> str:
    """The package that a module belongs to."""
    return path.relative_to(ADDON).with_suffix("").parts[0]


def imported_layers(path: Path) -> Iterator[str]:
    """The packages that a module imports from, "" for the add-on itself."""
    package = path.relative_to(ADDON).parent.parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            module = node.module.split(".") if node.module else []
            start = [*package[: len(package) + 1 - node.level], *module]
            yield from start[:1] or (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "blender_addon":
            yield ""
        elif isinstance(node, ast.Import):
            yield from ("" for name in node.names if name.name.split(".")[0] == "blender_addon")


def test_each_module_belongs_to_a_layer() -> None:
    assert {layer(path) for path in ADDON.rglob("*.py")} == {*LAYERS, *OUTSIDE}


def test_layers_import_only_earlier_layers() -> None:
    wrong = [
        f"{path.relative_to(ADDON)} imports {other or 'blender_addon by its absolute name'}"
        for path in ADDON.rglob("*.py")
        if layer(path) in LAYERS
        for other in imported_layers(path)
        if other not in LAYERS[: LAYERS.index(layer(path)) + 1]
    ]
    assert not wrong


def test_groups_of_mesh_data_import_only_earlier_groups() -> None:
    wrong = []
    for path in (ADDON / "mesh_data").rglob("*.py"):
        _, group, *_ = path.relative_to(ADDON).with_suffix("").parts
        if group == "__init__":
            continue
        assert group in GROUPS, path
        depth = len(path.relative_to(ADDON / "mesh_data").parts)  # level of an import from `mesh_data`
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == depth and node.module:
                other = node.module.split(".")[0]
                if other not in GROUPS[: GROUPS.index(group) + 1]:
                    wrong.append(f"{path.relative_to(ADDON)} imports {other}")
    assert not wrong


def test_layer_order_matches_the_document() -> None:
    text = (ADDON.parent / "ARCHITECTURE.md").read_text(encoding="utf-8")
    places = [text.index(f"| `blender_addon/{name}") for name in LAYERS]
    assert places == sorted(places)
