# SPDX-License-Identifier: GPL-3.0-or-later
"""Python processes that import nothing from the folder that the user happens to be in.

`python -m`, `python -c` and multiprocessing put the working folder first on the path of modules, where a downloaded
`numpy.py` would replace the package. A child process therefore starts in an empty folder, so give it absolute paths.
Where processes cannot be given a folder, such as those of multiprocessing, the environment variable `SAFE_PATH` has
Python 3.11 leave the working folder out.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

SAFE_PATH = "PYTHONSAFEPATH"


def child_environment(places: Iterable[str | os.PathLike[str]] = ()) -> dict[str, str]:
    """The environment variables of a child process in a folder of its own.

    Args:
        places: folders to import from, before those that the user has set.
    """
    # An empty entry, as in `PYTHONPATH=$PYTHONPATH:/folder`, is the working folder by accident.
    given = [os.path.abspath(place) for place in os.environ.get("PYTHONPATH", "").split(os.pathsep) if place]
    path = [*(os.path.abspath(place) for place in places), *given]
    return os.environ | {"PYTHONPATH": os.pathsep.join(path), SAFE_PATH: "1"}  # Python ignores an empty one


def leave_out_working_folder() -> None:
    """Import nothing more from the working folder, where `python -m` looks first, unless this package is there."""
    try:
        os.getcwd()
    except FileNotFoundError:  # it was deleted, so nothing can be imported from it
        return
    first = sys.path[0] if sys.path else None
    if first is not None and _is_same(first or os.curdir, os.curdir) and not _is_same(first or os.curdir, _home()):
        del sys.path[0]


@contextmanager
def empty_working_folder() -> Iterator[None]:
    """A context in which the working folder of this process is an empty one: some packages read settings there."""
    before = os.getcwd()
    with TemporaryDirectory(prefix="zoomout-") as folder:
        os.chdir(folder)
        try:
            yield
        finally:
            os.chdir(before)


def modules_of_python_in(folder: Path) -> list[str]:
    """Files and folders that Python would import instead of modules of its own library, if it looked there first."""
    names = (path.name for path in folder.iterdir() if path.is_dir() or path.suffix in (".py", ".pyc", ".so", ".pyd"))
    return sorted(name for name in names if name.partition(".")[0] in sys.stdlib_module_names)


def _home() -> Path:
    """The folder that this package was imported from."""
    return Path(__file__).resolve().parents[2]


def _is_same(one: str | os.PathLike[str], other: str | os.PathLike[str]) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)
