# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of meshes that a user names, one by one or by their folders."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from zoomout_core.mesh.errors import MeshError
from zoomout_core.runtime.outputs import is_same_file


def meshes_of(given: Path, endings: Collection[str], source: Path | None = None) -> list[Path]:
    """The files that a user names: a single file, or the meshes in a folder, except the source.

    Raises:
        MeshError: a folder contains none.
    """
    if not given.is_dir():
        return [given]
    files = sorted(path for path in given.iterdir() if path.suffix.lower() in endings)
    found = [path for path in files if source is None or not is_same_file(path, source)]
    if not found:
        raise MeshError(f"The folder {given} contains no meshes{' besides the source' * bool(files)}: check the path.")
    return found


def meshes_of_all(given: Sequence[Path], endings: Collection[str]) -> list[Path]:
    """The files that a user names, and the meshes in folders among them, each once.

    Raises:
        MeshError: a file or folder does not exist, or a folder contains no meshes.
    """
    missing = next((path for path in given if not path.exists()), None)
    if missing is not None:
        raise MeshError(f"There is no file or folder {missing}: check the path.")
    return list(dict.fromkeys(path for each in given for path in meshes_of(each, endings)))
