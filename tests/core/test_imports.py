# SPDX-License-Identifier: GPL-3.0-or-later
"""The package imports quickly, and its names are in the modules that it lists."""

from __future__ import annotations

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import zoomout_core as zo


def python(script: str) -> str:
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout


def test_import_loads_no_heavy_packages() -> None:
    heavy = {"numpy", "scipy", "robust_laplacian", "fast_simplification", "trimesh", "matplotlib"}
    loaded = set(python("import sys, zoomout_core; print(*sys.modules)").split())
    assert not heavy & loaded


def test_rarely_needed_packages_are_loaded_lazily() -> None:
    uses = "zo.match; zo.transfer; zo.transfer_asset; import zoomout_core.transfer.uv.bake"
    loaded = set(python(f"import sys, zoomout_core as zo; {uses}; print(*sys.modules)").split())
    assert "scipy.sparse" in loaded
    assert not {"scipy.optimize", "scipy.ndimage", "scipy.cluster", "matplotlib"} & loaded


def test_subpackage_does_not_hide_the_function_of_its_name() -> None:
    script = "import zoomout_core as zo; import zoomout_core.transfer.uv.chart; print(type(zo.transfer).__name__)"
    assert python(script).strip() == "function"


def test_public_names_are_those_that_type_checkers_see() -> None:
    tree = ast.parse(Path(zo.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If) and isinstance(node.test, ast.Name))
    told = {name.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for name in node.names}
    assert [name for name, module in told.items() if module == "zoomout_core"] == ["plotting", "samples"]
    told = {name: module for name, module in told.items() if module != "zoomout_core"}
    assert set(told) == set(zo.__all__)
    for name, module in told.items():
        assert getattr(zo, name) is getattr(import_module(str(module)), name)
    public = {name for name in dir(zo) if not name.startswith("_")}
    assert public == {*zo.__all__, "plotting", "samples"}
