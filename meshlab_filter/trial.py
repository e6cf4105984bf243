# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether pymeshlab can read a file: tried in a process of its own, since malformed ones crash, hang or fill memory.

This module is what that process runs, too: `python trial.py PATH MEMORY GLTF`; it says nothing where all is well.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

# Seconds that a file may take, and for each megabyte of it.
SECONDS, SECONDS_PER_MEGABYTE = 30.0, 2.0
# Bytes of memory beyond what the library takes, and for each byte of a file.
MEMORY, MEMORY_PER_BYTE = 1 << 30, 150

# Files that were read without a fault, by path, size and time of change: what has stayed as it was is not tried again.
_SOUND: set[tuple[str, int, int, bool]] = set()


def fault_of_file(path: str | Path, gltf: bool) -> str:
    """Why pymeshlab cannot read a mesh file, in words, or nothing.

    Args:
        path: of the file.
        gltf: whether it is to be read in a single layer.
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
    if Path(path).suffix.lower() == ".stl" and size < _stated_size(Path(path)):
        return "it declares more triangles than it contains"
    command = [sys.executable, __file__, str(path), str(MEMORY + MEMORY_PER_BYTE * size), "gltf" if gltf else ""]
    try:
        ran = subprocess.run(
            command,
            capture_output=True,
            timeout=SECONDS + SECONDS_PER_MEGABYTE * size / 1e6,
            stdin=subprocess.DEVNULL,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "MeshLab does not finish reading it"
    if ran.returncode == 0:
        return ""
    lines = ran.stdout.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else "MeshLab crashes on it"


def _stated_size(path: Path) -> int:
    """How large a binary STL file is by the number of triangles that it states; 0 of one in words."""
    with path.open("rb") as file:
        head = file.read(84)
    in_words = head.lstrip().startswith(b"solid") and b"\0" not in head
    return 0 if in_words or len(head) < 84 else 84 + 50 * int.from_bytes(head[80:], "little")


def _try(path: str, memory: int, gltf: bool) -> str:
    """Read a file, and look whether what was read holds together: the fault, or nothing."""
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
            mesh.polygonal_face_list()  # endless where a face lies on the diagonal of another
    except (MemoryError, ValueError, RuntimeError):
        return "some of its faces overlap, so MeshLab cannot join them to polygons: triangulate it"
    return ""


def _limit_memory(more: int) -> None:
    """Let this process take so many bytes beyond what it has, where the system can say no."""
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
