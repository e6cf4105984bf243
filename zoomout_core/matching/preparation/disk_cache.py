# SPDX-License-Identifier: GPL-3.0-or-later
"""Prepared shapes on disk, for the next process: bounded, versioned, and safe where several processes write at once.

Nothing in the files can run: they are plain arrays. A file that cannot be read is ignored.
"""

from __future__ import annotations

import logging
import os
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_array

from zoomout_core.maps.sampled_basis import SampledBasis
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.proxy import Proxy
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.array_files import read_arrays, write_arrays
from zoomout_core.runtime.outputs import atomic_write
from zoomout_core.runtime.version import package_version
from zoomout_core.spectral.eigenbasis import SpectralBasis

# Increase this whenever the same mesh is prepared or stored differently.
FORMAT = 5
# Bytes that the files take at most, unless the user says otherwise.
MAX_BYTES = 1 << 30

MESH_ARRAYS = "vertices", "triangles", "flipped", "vertex_of", "triangle_of", "component", "origin"
SPARSE_ARRAYS = "data", "indices", "indptr"

_log = logging.getLogger(__name__)


def remove_shapes(folder: str | os.PathLike[str]) -> None:
    """Remove the shapes that a `ShapeFolder` stored in a folder, and the folder itself if nothing else is in it."""
    shutil.rmtree(_place_in(folder), ignore_errors=True)
    with suppress(OSError):
        os.rmdir(folder)


def _place_in(folder: str | os.PathLike[str]) -> Path:
    return Path(folder) / f"shapes-{FORMAT}-{package_version()}"


class ShapeFolder:
    """A folder of prepared shapes, made if it is missing; the least recently used beyond `max_bytes` are removed."""

    def __init__(self, folder: str | os.PathLike[str], max_bytes: int = MAX_BYTES) -> None:
        self._folder = _place_in(folder)
        self._max_bytes = max_bytes

    def load(self, key: bytes, part: WorkingMesh) -> ShapeAnalysis | None:
        """The shape of a part that was stored under a key, or None."""
        path = self._path(key)
        try:
            arrays = read_arrays(path)
            if arrays["key"].tobytes() != key:  # put here under another name
                raise ValueError("it is of another shape")
            shape = _shape(arrays, part)
            os.utime(path)  # used just now
        except FileNotFoundError:
            return None
        except Exception as error:  # where arrays do not fit together, what fails depends on the fault
            _log.warning("A cached shape cannot be read and is computed again: %s (%s)", path, error)
            with suppress(OSError):  # another process may have removed it, or read it just now
                path.unlink()
            return None
        return shape

    def save(self, key: bytes, shape: ShapeAnalysis) -> None:
        """Store a shape. If that fails, such as on a full disk, a warning is logged and nothing else happens."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with atomic_write(self._path(key)) as part:
                write_arrays(part, {"key": np.frombuffer(key, np.uint8)} | _arrays(shape), compressed=False)
            self._make_room()
        except OSError as error:
            _log.warning("A shape cannot be cached in %s: %s", self._folder, error)

    def _path(self, key: bytes) -> Path:
        return self._folder / f"{key.hex()}.npz"

    def _make_room(self) -> None:
        """Remove the least recently used files until the others take at most `max_bytes`."""
        seen = []
        for path in self._folder.glob("[!.]*.npz"):
            with suppress(OSError):  # another process was faster
                status = path.stat()
                seen.append((status.st_mtime, status.st_size, path))
        total = sum(size for _, size, _ in seen)
        for _, size, path in sorted(seen):
            if total <= self._max_bytes:
                break
            with suppress(OSError):  # another process removed it, or keeps it open
                path.unlink()
            total -= size


def _arrays(shape: ShapeAnalysis) -> dict[str, Any]:
    """All that `_shape` needs beside the part itself."""
    proxy, basis = shape.proxy, shape.basis
    arrays = {
        "eigenvalues": basis.eigenvalues,
        "eigenvectors": basis.eigenvectors,
        "areas": basis.areas,
        "samples": shape.sampled.samples,
        "distances": shape.distances,
        **{f"stiffness.{name}": getattr(shape.stiffness, name) for name in SPARSE_ARRAYS},
    }
    if proxy.mesh is not proxy.full:
        arrays |= {f"mesh.{name}": getattr(proxy.mesh, name) for name in MESH_ARRAYS}
        arrays |= {"mesh.scale": np.array(proxy.mesh.scale), "vertices": proxy.vertices, "merged": proxy.merged}
    return arrays


def _shape(arrays: dict[str, Any], part: WorkingMesh) -> ShapeAnalysis:
    if "merged" in arrays:
        mesh = WorkingMesh(**{name: arrays[f"mesh.{name}"] for name in MESH_ARRAYS}, scale=float(arrays["mesh.scale"]))
        proxy = Proxy(part, mesh, arrays["vertices"], arrays["merged"])
    else:
        proxy = Proxy(part, part, part.vertices, np.arange(len(part.vertices)))
    n = len(proxy.mesh.vertices)
    stiffness = csc_array(tuple(arrays[f"stiffness.{name}"] for name in SPARSE_ARRAYS), shape=(n, n))
    stiffness.check_format(full_check=True)  # or compiled code could read beyond its arrays
    if not len(arrays["areas"]) == len(arrays["eigenvectors"]) == arrays["distances"].shape[1] == n:
        raise ValueError("it is of another shape")
    basis = SpectralBasis(arrays["eigenvalues"], arrays["eigenvectors"], arrays["areas"], proxy.mesh.vertices)
    return ShapeAnalysis(proxy, stiffness, basis, SampledBasis.of(basis, arrays["samples"]), arrays["distances"])
