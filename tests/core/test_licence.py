# SPDX-License-Identifier: GPL-3.0-or-later
"""Every Python file names its licence in its first line."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("zoomout_core", "blender_addon", "meshlab_filter", "benchmarks", "tools", "tests", "docs")
HEADER = "# SPDX-License-Identifier: GPL-3.0-or-later"


def has_header(path: Path) -> bool:
    """Whether the first line, or the one below a shebang, is the header."""
    with path.open(encoding="utf-8") as file:
        line = file.readline()
        if line.startswith("#!"):
            line = file.readline()
    return line.rstrip("\n") == HEADER


def test_every_python_file_begins_with_its_licence() -> None:
    files = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
    assert len(files) > 100
    assert [str(path.relative_to(ROOT)) for path in files if not has_header(path)] == []
