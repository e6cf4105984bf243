# SPDX-License-Identifier: GPL-3.0-or-later
"""The filters use the core as a library."""

import ast
from pathlib import Path

import meshlab_filter


def test_no_filter_imports_the_command_line_of_the_core() -> None:
    for path in Path(meshlab_filter.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [f"{node.module}.{name.name}" for name in node.names] if isinstance(node, ast.ImportFrom) else []
            names += [name.name for name in node.names] if isinstance(node, ast.Import) else []
            assert not any(name == "zoomout_core.cli" or name.startswith("zoomout_core.cli.") for name in names), path
