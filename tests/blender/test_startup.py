# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender starts without waiting for what computes: see *Start* in ARCHITECTURE.md."""

from __future__ import annotations

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import blender_addon
from blender_addon.mesh_data.attributes.layers import STORAGE
from zoomout_core.transfer import RULES

ROOT = Path(blender_addon.__file__).parents[1]
# Packages whose names are imported on first use.
FACADES = ("zoomout_core.transfer", "blender_addon.mesh_data", "blender_addon.adapters")

STARTED = """
import sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=False)
before = set(sys.modules)
import blender_addon
blender_addon.register()
DRAW
print(*sorted(set(sys.modules) - before))
"""
# The first draw: two meshes are selected, and none of them is matched.
DRAWN = """
sys.path.insert(0, "tests/blender")
from types import SimpleNamespace
from drawing import Context, Layout
from blender_addon.ui import panels
bpy.ops.mesh.primitive_uv_sphere_add()
bpy.data.objects["Cube"].select_set(True)
bpy.context.view_layer.update()
context = Context()
for panel in (each for each in panels.CLASSES if issubclass(each, bpy.types.Panel)):
    if not hasattr(panel, "poll") or panel.poll(context):
        options = lambda *given, panel=panel: panel.draw_options(None, *given)
        panel.draw(SimpleNamespace(layout=Layout([]), draw_options=options), context)
"""
HEAVY = ("blender_addon.cli.", "scipy.sparse", "scipy.spatial", "scipy.linalg")


def modules_after(draw: str) -> set[str]:
    ended = subprocess.run(
        [sys.executable, "-c", STARTED.replace("DRAW", draw)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    return set(ended.stdout.splitlines()[-1].split())


def test_enabling_imports_neither_services_nor_what_they_compute_with():
    imported = modules_after("")
    assert "blender_addon.operators.matching.match" in imported
    assert [name for name in sorted(imported) if name.startswith(("blender_addon.services.", *HEAVY))] == []


def test_the_first_draw_of_the_panels_imports_nothing_that_computes():
    imported = modules_after(DRAWN)
    assert "blender_addon.services.preflight" in imported
    assert [name for name in sorted(imported) if name.startswith(HEAVY)] == []


def imports_for_type_checkers(package: str) -> dict[str, str]:
    """The module of each name that a package imports for type checkers."""
    path = Path(str(import_module(package).__file__))
    statements = ast.parse(path.read_text("utf-8")).body
    block = next(each for each in statements if isinstance(each, ast.If) and ast.unparse(each.test) == "TYPE_CHECKING")
    found = (node for node in block.body if isinstance(node, ast.ImportFrom))
    return {name.name: (node.module or "").removeprefix(f"{package}.") for node in found for name in node.names}


@pytest.mark.parametrize("package", FACADES)
def test_names_come_from_the_modules_that_type_checkers_see(package):
    module = import_module(package)
    homes = imports_for_type_checkers(package)
    assert homes
    for name, home in homes.items():
        assert getattr(module, name) is getattr(import_module(f"{package}.{home}"), name)


def test_the_core_lists_its_names_as_type_checkers_see_them():
    module = import_module("zoomout_core.transfer")  # the attribute of this name is a function
    homes = {name: home for home, names in module._HOMES.items() for name in names}
    assert homes == imports_for_type_checkers("zoomout_core.transfer")
    assert sorted(homes) == sorted(module.__all__)


def test_attributes_are_read_where_the_core_can_transfer_them():
    for storage in STORAGE.values():
        assert set(storage.domains) == set(RULES[storage.kind].domains)
