# SPDX-License-Identifier: GPL-3.0-or-later
"""Test in a child process whether pymeshlab can read a file: malformed ones crash, hang or exhaust memory.

The child process runs this module as well: `python trial.py PATH MEMORY GLTF`; it prints nothing on success. It starts
in an empty folder, see `zoomout_core.runtime.child_process`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

# Time limit in seconds: a constant, and per megabyte of the file.
SECONDS, SECONDS_PER_MEGABYTE = 30.0, 2.0
# Memory limit in bytes beyond the library's: a constant, and per byte of the file.
MEMORY, MEMORY_PER_BYTE = 1 << 30, 150

# Files that were read without a fault, by path, size and modification time; they are not tried again.
_SOUND: set[tuple[str, int, int, bool]] = set()


def fault_of_file(path: str | Path, gltf: bool) -> str:
    """The reason why pymeshlab cannot read a mesh file, or an empty text.

    Args:
        path: the file.
        gltf: whether to read it into a single layer.
    """
    found = Path(path).stat()
    file = os.path.abspath(path), found.st_size, found.st_mtime_ns, gltf
    if file in _SOUND:
        return ""
    fault = _fault(path, found.st_size, gltf)
    if not fault:
        _SOUND.add(file)
    return fault


def _fault(path: str | Path, size: int, gltf: bool) -> str:
    from zoomout_core.mesh.formats.stl import HEAD, stated_size  # the child does without
    from zoomout_core.runtime.child_process import child_environment

    if Path(path).suffix.lower() == ".stl":
        with open(path, "rb") as file:
            if size < stated_size(file.read(HEAD)):
                return "it declares more triangles than it contains"

    limit, single = str(MEMORY + MEMORY_PER_BYTE * size), "gltf" if gltf else ""
    command = [sys.executable, os.path.abspath(__file__), os.path.abspath(path), limit, single]
    with TemporaryDirectory(prefix="zoomout-") as folder:
        try:
            ran = subprocess.run(
                command,
                capture_output=True,
                timeout=SECONDS + SECONDS_PER_MEGABYTE * size / 1e6,
                stdin=subprocess.DEVNULL,
                env=child_environment(),
                cwd=folder,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return "MeshLab does not finish reading it"
    if ran.returncode == 0:
        return ""
    lines = ran.stdout.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else "MeshLab crashes on it"


def _try(path: str, memory: int, gltf: bool) -> str:
    """Read a file, check the consistency of the mesh, and return the fault, if any."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    _limit_memory(memory)
    try:
        meshes.load_new_mesh(path, **({"load_in_a_single_layer": True} if gltf else {}))
        for mesh in meshes:
            faces = mesh.face_matrix()
            if len(faces) and not 0 <= faces.min() <= faces.max() < mesh.vertex_number():
                return "its faces refer to vertices that it does not have"
    except pymeshlab.PyMeshLabException as error:
        return " ".join(str(error).split())
    except (MemoryError, ValueError, RuntimeError):
        return "it declares more data than it contains"
    try:
        for mesh in meshes:
            mesh.polygonal_face_list()  # does not terminate if a face is on another one's diagonal
    except (MemoryError, ValueError, RuntimeError):
        return "some of its faces overlap, so MeshLab cannot join them to polygons: triangulate it"
    return ""


def _limit_memory(more: int) -> None:
    """Limit this process to a number of additional bytes, if the system supports that."""
    try:
        import resource
    except ImportError:  # Windows
        return
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if Path("/proc/self/statm").exists() else 1 << 20
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + more,) * 2)


if __name__ == "__main__":
    fault = _try(sys.argv[1], int(sys.argv[2]), bool(sys.argv[3]))
    print(fault, flush=True)
    sys.exit(bool(fault))
