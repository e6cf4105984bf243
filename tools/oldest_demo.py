# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the demo in the oldest Blender that the extension supports, so that its demo.blend opens there as well.

Files saved by Blender 5 open in 4.5 and newer only. The environment is that of
`tools/blender_versions.py`; the core's other dependencies are the wheels of the extension's zip, which are
unpacked into `build/oldest_demo`.
"""

import argparse
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import blender_versions
import extension

OLDEST = next(iter(blender_versions.VERSIONS))
LIBRARIES = extension.ROOT / "build" / "oldest_demo"
RUN = """
import os
import sys
from pathlib import Path
from blender_addon.demo import run, summary
print(*summary(run(Path(sys.argv[1]))), sep="\\n", file=sys.stderr, flush=True)
os._exit(0)  # that of 4.2 crashes at its exit once classes were registered
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=f"Run the demo in Blender {OLDEST}.")
    parser.add_argument("-o", "--output", type=Path, default=Path("demo"), help="folder to write to (default: demo)")
    output = parser.parse_args().output.resolve()
    python = blender_versions.environment(OLDEST)
    unpack(blender_versions.VERSIONS[OLDEST].python)
    path = os.pathsep.join(map(str, (extension.ROOT, LIBRARIES)))
    variables = {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"}
    run = [str(python), "-P", "-c", RUN, str(output)]
    done = subprocess.run(run, env=variables, stdout=subprocess.DEVNULL)  # to which Blender prints each sample
    sys.exit(done.returncode)


def unpack(version: str) -> None:
    """Unpack the wheels of this platform's zip for a Python, such as 3.11, replacing earlier ones."""
    shutil.rmtree(LIBRARIES, ignore_errors=True)
    for wheel in extension.locked_wheels(f"cp{version.replace('.', '')}", extension.this_platform()):
        with zipfile.ZipFile(wheel) as opened:
            opened.extractall(LIBRARIES)


if __name__ == "__main__":
    try:
        main()
    except (OSError, ValueError, subprocess.CalledProcessError) as error:
        sys.exit(f"The demo was not run: {error}")
