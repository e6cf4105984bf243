# SPDX-License-Identifier: GPL-3.0-or-later
"""Install the extension into several versions of Blender, and run `tests/extension` in each.

`make test-blender-versions` takes all of `VERSIONS`, or those that are named. Each has an environment of its own,
stored in `.venv-blender/`, with that version's Blender and pytest alone, so that whatever else a test needs can only
come from the zip, and with the numpy that this version of Blender ships.
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
    """What a version of Blender brings along; the `bpy` wheel leaves the choice of numpy open."""

    python: str
    numpy: str


# Every long-term release, and the last one with Python 3.11.
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
    arguments = parser.parse_args()
    if unknown := set(arguments.versions).difference(VERSIONS):
        sys.exit(f"There is no Blender {', '.join(sorted(unknown))} here: choose from {', '.join(VERSIONS)}.")
    names = list(VERSIONS)
    chosen = list(filter(has_python, [names[0], names[-1]])) if arguments.ends else arguments.versions or names
    (archive,) = extension.build([this_platform()])
    failed = [name for name in chosen if not passes(name, archive)]
    if failed:
        sys.exit(f"The installed extension failed in Blender {', '.join(failed)}.")


def has_python(name: str) -> bool:
    """Whether the Python of a version is here; if not, says that the version is left out."""
    try:
        interpreter(VERSIONS[name].python)
    except ValueError as error:
        print(f"Blender {name} is left out. {error}")
        return False
    return True


def this_platform() -> str:
    systems = {"linux": "linux-x64", "win32": "windows-x64", "darwin": f"macos-{_mac_machine()}"}
    return systems[sys.platform]


def _mac_machine() -> str:
    return "arm64" if os.uname().machine == "arm64" else "x64"


def passes(name: str, archive: Path) -> bool:
    """Run the tests in one version; what they find is printed."""
    python = environment(name)
    print(f"Blender {name}:", flush=True)
    # -P keeps this folder, which has the core's source, off the path; scenes to test on are the other tests'.
    options = ["-p", "no:cacheprovider", "-o", "pythonpath=tests/blender"]
    variables = {**os.environ, "ZOOMOUT_EXTENSION": str(archive), "OPENBLAS_NUM_THREADS": "1"}
    variables.pop("PYTHONPATH", None)
    run = [str(python), "-P", "-m", "pytest", *options, "tests/extension"]
    return subprocess.run(run, cwd=extension.ROOT, env=variables).returncode == 0


def environment(name: str) -> Path:
    """The Python of a version's environment, which is made where it is missing or unfinished."""
    folder = ENVIRONMENTS / name
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    wanted = f"bpy=={name} numpy=={VERSIONS[name].numpy} {PYTEST}"
    stamp = folder / "finished"
    if stamp.exists() and stamp.read_text() == f"{folder}: {wanted}":
        return python
    print(f"Blender {name}: setting up {folder.relative_to(extension.ROOT)} (375 MB to download, 1 GB on disk)")
    if folder.exists():
        shutil.rmtree(folder)
    subprocess.run([interpreter(VERSIONS[name].python), "-m", "venv", folder], check=True)
    subprocess.run([python, "-m", "pip", "install", "--quiet", "--prefer-binary", *wanted.split()], check=True)
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
    """Commands that may be a Python: the one that runs this, one on the path, those that pyenv keeps."""
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
