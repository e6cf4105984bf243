# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the documentation: `make docs` writes it to `build/docs/html`, and warnings are errors.

Pages with code are executed; their notebooks, with results, are among the downloads and in
`build/docs/jupyter_execute`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / "build" / "docs"
OUTPUT = BUILD / "html"


def main() -> None:
    """Build the documentation; arguments are passed on to Sphinx."""
    beside = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}  # for `zoomout`
    command = [
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-b",
        "html",
        "-d",
        str(BUILD / "doctrees"),
        *sys.argv[1:],
        "docs",
        str(OUTPUT),
    ]
    status = subprocess.run([sys.executable, *command], cwd=ROOT, env=beside, check=False).returncode
    if status:
        sys.exit("The documentation has faults: see the warnings above.")
    if find_spec("bpy") is None:
        print("Without the reference of blender_addon.api: run `make setup` first to include it.")
    print(f"Open {(OUTPUT / 'index.html').relative_to(ROOT)} in a browser.")


if __name__ == "__main__":
    main()
