# SPDX-License-Identifier: GPL-3.0-or-later
"""A cache of prepared shapes, because one source is often matched with many targets.

Shapes and working meshes are keyed by content: an edited mesh is prepared again, and programs that pass the same mesh
as a new surface each time find the earlier one. `store_shapes` also writes shapes to disk.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import blake2b
from os import PathLike
from threading import Lock
from typing import Generic, TypeVar

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers, check_counts
from zoomout_core.matching.components.hulls import hull_of
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.preparation.disk_cache import MAX_BYTES as MAX_BYTES_ON_DISK
from zoomout_core.matching.preparation.disk_cache import ShapeFolder
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.input_files import check_path
from zoomout_core.runtime.memory import bytes_of
from zoomout_core.runtime.option_names import suggest_names

# Maximum bytes of the cached shapes, which is about ten of the usual size; as much again for working meshes. The two of
# the last match are kept whatever their size, or matching a million vertices again would analyse one of them again.
MAX_BYTES, MIN_KEPT = 512 << 20, 2

Value = TypeVar("Value", ShapeAnalysis, WorkingMesh)


class _LruCache(Generic[Value]):
    """A cache with the hash of the content as key. It drops the least recently used values to limit its memory."""

    def __init__(self) -> None:
        self._values: OrderedDict[bytes, Value] = OrderedDict()
        self._lock = Lock()

    def get(self, key: bytes) -> Value | None:
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
            return self._values.get(key)

    def put(self, key: bytes, value: Value) -> None:
        with self._lock:
            self._values[key] = value
            self._values.move_to_end(key)
            while len(self._values) > MIN_KEPT and bytes_of(*self._values.values()) > MAX_BYTES:
                self._values.popitem(last=False)

    def unlock(self) -> None:
        """Replace the lock, in a child process."""
        self._lock = Lock()

    def clear(self) -> None:
        with self._lock:
            self._values.clear()


_shapes: _LruCache[ShapeAnalysis] = _LruCache()
_meshes: _LruCache[WorkingMesh] = _LruCache()
if hasattr(os, "register_at_fork"):  # not on Windows; a thread that does not exist in the child may hold the locks
    os.register_at_fork(after_in_child=_shapes.unlock)
    os.register_at_fork(after_in_child=_meshes.unlock)
_folder: ShapeFolder | None = None


def cached_working_mesh(surface: Surface) -> WorkingMesh:
    """The working mesh of a surface, from the cache if a surface with the same arrays was prepared before."""
    key = _hash("", surface.vertices, surface.corner_vertex, surface.triangle_corners)
    mesh = _meshes.get(key)
    if mesh is None:
        mesh = surface.working
    else:
        surface.working = mesh
    _meshes.put(key, mesh)
    return mesh


def cached_hull(surface: Surface, tight: bool = False) -> WorkingMesh:
    """The hull of a surface, see `hull_of`, from the cache if a surface with the same arrays was prepared before."""
    key = _hash(f"hull, tight: {tight}", surface.vertices, surface.corner_vertex, surface.triangle_corners)
    hull = _meshes.get(key)
    if hull is None:
        hull = hull_of(surface, tight)
    _meshes.put(key, hull)
    return hull


def cached_analysis(part: WorkingMesh, k: int, samples: int, seed: int, proxy_vertices: int | None) -> ShapeAnalysis:
    """The analysis of a mesh, see `analyse`, from memory or disk if it was computed before."""
    arrays = part.vertices, part.triangles, part.flipped, part.vertex_of, part.triangle_of
    key = _hash(repr(((k, samples, seed, proxy_vertices), part.scale)), *arrays)
    shape, folder = _shapes.get(key), _folder
    if shape is None and folder is not None:
        shape = folder.load(key, part)
    if shape is None:
        shape = analyse(part, k, samples, seed, proxy_vertices)
        if folder is not None:
            folder.save(key, shape)
    _shapes.put(key, shape)
    return shape


@suggest_names
def store_shapes(folder: str | PathLike[str] | None, max_bytes: int = MAX_BYTES_ON_DISK) -> None:
    """Cache shapes that are prepared from now on in a folder, also for other processes.

    Args:
        folder: the folder, created if missing; None, the default at start, to cache in memory only.
        max_bytes: maximum size of the folder; the least recently used shapes are removed first.

    Raises:
        TypeError: the folder is neither a string nor a path.
        ValueError: the size is not a positive whole number.

    Example:
        >>> zo.store_shapes(folder)  # analysed shapes are read from there, also by other processes
        >>> zo.store_shapes(None)
    """
    global _folder
    if folder is not None:
        check_path(folder)
    check_counts(max_bytes=max_bytes)
    _folder = None if folder is None else ShapeFolder(folder, max_bytes)


@contextmanager
def store_shapes_in(folder: str | PathLike[str], max_bytes: int = MAX_BYTES_ON_DISK) -> Iterator[None]:
    """A context that stores shapes in a folder, see `store_shapes`; the earlier setting is restored after it."""
    global _folder
    before = _folder
    store_shapes(folder, max_bytes)
    try:
        yield
    finally:
        _folder = before


def forget_shapes() -> None:
    """Empty the cache in memory.

    Example:
        >>> zo.forget_shapes()  # the next match analyses its shapes again
    """
    _shapes.clear()
    _meshes.clear()


def _hash(words: str, *arrays: Floats | Integers | Booleans) -> bytes:
    digest = blake2b(words.encode())
    for array in arrays:
        digest.update(repr((array.shape, array.dtype)).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()
