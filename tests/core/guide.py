# SPDX-License-Identifier: GPL-3.0-or-later
"""Follow CONTRIBUTING.md: insert a section's code blocks into a copy of the tree, and run the last block."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("zoomout_core", "meshlab_filter", "blender_addon")
NEW, TRY = "new", "# try it"


def follow(section: str, folder: Path) -> None:
    """Follow the steps of a section.

    Args:
        section: title of the section.
        folder: destination of the copy.

    Raises:
        AssertionError: a line that a block names is missing, a new file exists already, or the last block fails.
    """
    for package in PACKAGES:
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    body = re.split(r"(?m)^## ", text.split(f"\n## {section}\n", 1)[1])[0]
    blocks = re.findall(r"(?ms)^```python\n(.*?)^```$", body)
    assert blocks, f"{section} shows no code"
    for block in blocks[:-1]:
        head, code = block.split("\n", 1)
        place, _, anchor = head.removeprefix("# ").partition(", ")
        if anchor == NEW:
            assert not (folder / place).exists(), f"{place} is there already"
            (folder / place).write_text(code, encoding="utf-8")
        else:
            line = anchor.removeprefix("after: ")
            present = (folder / place).read_text(encoding="utf-8").split("\n")
            assert present.count(line) == 1, f"{place} has not one line {line!r}"
            at = present.index(line) + 1
            (folder / place).write_text(
                "\n".join([*present[:at], *code.split("\n")[:-1], *present[at:]]), encoding="utf-8"
            )
    head, script = blocks[-1].split("\n", 1)
    assert head == TRY
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", "ZOOMOUT_CACHE": "off"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
