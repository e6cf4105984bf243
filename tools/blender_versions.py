# SPDX-License-Identifier: GPL-3.0-or-later
"""Install the extension into several versions of Blender, and run `tests/extension` in each.

`make test-blender-versions` tests all of `VERSIONS`, or those given as arguments. Each has its own environment,
in `.venv-blender/`, with only that version's Blender, the numpy that it ships, and pytest, so that all else that a
test needs must come from the zip.
"""

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import extension

ENVIRONMENTS = extension.ROOT / ".venv-blender"


class Version(NamedTuple):
    """A version of Blender, with its Python and numpy; the `bpy` wheel does not pin numpy."""

    python: str
    numpy: str


# All long-term releases, and the last release with Python 3.11.
VERSIONS = {
    "4.2.23": Version("3.11", "1.24.3"),
    "4.5.15": Version("3.11", "1.26.4"),
    "5.0.1": Version("3.11", "1.26.4"),
    "5.2.3": Version("3.13", "2.3.4"),
}
PYTEST = "pytest>=8"


def main() -> None:
    parser = argparse.ArgumentParser(description="Test the installed extension in several versions of Blender.")
    parser.add_argument("versions", nargs="*", metavar="VERSION", help=f"of {', '.join(VERSIONS)} (default: all)")
    parser.add_argument("--ends", action="store_true", help="the oldest and the newest, as far as Python is there")
    parser.add_argument("--prepare", action="store_true", help="only set up their environments, for later tests")
    arguments = parser.parse_args()
    if unknown := set(arguments.versions).difference(VERSIONS):
        sys.exit(f"There is no Blender {', '.join(sorted(unknown))} here: choose from {', '.join(VERSIONS)}.")
    names = list(VERSIONS)
    chosen = list(filter(has_python, [names[0], names[-1]])) if arguments.ends else arguments.versions or names
    if arguments.prepare:
        for name in chosen:
            environment(name)
        return
    (archive,) = extension.build([extension.this_platform()])
    failed = [name for name in chosen if not passes(name, archive)]
    if failed:
        sys.exit(f"The installed extension failed in Blender {', '.join(failed)}.")


def has_python(name: str) -> bool:
    """Whether a version's Python is installed; if not, print that the version is skipped."""
    try:
        interpreter(VERSIONS[name].python)
    except ValueError as error:
        print(f"Blender {name} is left out. {error}")
        return False
    return True


def passes(name: str, archive: Path) -> bool:
    """Run the tests in one version, and print their output."""
    python = environment(name)
    print(f"Blender {name}:", flush=True)
    # -P keeps this folder, which has the core's source, off the path; the scenes come from the other tests.
    options = ["-p", "no:cacheprovider", "-o", "pythonpath=tests/blender"]
    # Keep compiled modules even if the environment says not to: pip has not compiled any.
    kept = {"PYTHONDONTWRITEBYTECODE": ""}
    variables = {**os.environ, **kept, "ZOOMOUT_EXTENSION": str(archive), "OPENBLAS_NUM_THREADS": "1"}
    variables.pop("PYTHONPATH", None)
    run = [str(python), "-P", "-m", "pytest", *options, "tests/extension"]
    return subprocess.run(run, cwd=extension.ROOT, env=variables).returncode == 0


def environment(name: str) -> Path:
    """The Python of a version's environment, which is created if it is missing or unfinished."""
    folder = ENVIRONMENTS / name
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    wanted = f"bpy=={name} numpy=={VERSIONS[name].numpy} {PYTEST}"
    stamp = folder / "finished"
    if stamp.exists() and stamp.read_text() == f"{folder}: {wanted}":
        return python
    print(f"Blender {name}: setting up {folder.relative_to(extension.ROOT)} (375 MB to download, 1 GB on disk)")
    if folder.exists():
        shutil.rmtree(folder)
    # The pip of this environment serves: one more takes 6 s to set up.
    subprocess.run([interpreter(VERSIONS[name].python), "-m", "venv", "--without-pip", folder], check=True)
    install = [sys.executable, "-m", "pip", "--python", str(python), "install"]
    subprocess.run([*install, "--quiet", "--no-compile", "--prefer-binary", *wanted.split()], check=True)
    stamp.write_text(f"{folder}: {wanted}")
    return python


def interpreter(version: str) -> str:
    """The command of a Python.

    Raises:
        ValueError: there is none.
    """
    probe = f"import sys; sys.exit('%d.%d' % sys.version_info[:2] != '{version}')"
    for command in candidates(version):
        if subprocess.run([command, "-c", probe], capture_output=True).returncode == 0:
            return command
    raise ValueError(
        f"There is no Python {version} here, which this Blender needs: install it, with pyenv or otherwise."
    )


def candidates(version: str) -> Iterator[str]:
    """Commands that may be a Python: the running one, those on the path, and those of pyenv."""
    yield sys.executable
    if found := shutil.which(f"python{version}"):
        yield found
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    yield from map(str, sorted(pyenv.glob(f"versions/{version}.*/bin/python"), reverse=True))


if __name__ == "__main__":
    try:
        main()
    except (OSError, ValueError, subprocess.CalledProcessError) as error:
        sys.exit(f"The extension was not tested: {error}")
