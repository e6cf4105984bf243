"""Prepared shapes, kept for the next match: one source is often matched with many targets, and again.

A shape is known by its content, so what was edited is prepared anew. `store_shapes` has them written to disk, too.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Generator
from hashlib import blake2b
from os import PathLike
from threading import Lock

import numpy as np

from zoomout_core.correspondence.shape import Shape, shape_steps
from zoomout_core.correspondence.stored_shapes import MOST_BYTES as MOST_BYTES_ON_DISK
from zoomout_core.correspondence.stored_shapes import ShapeFolder
from zoomout_core.surface import WorkingMesh

# The shapes kept take at most so many bytes: some ten of the usual size.
MOST_BYTES = 256 << 20
# Numbers of eight bytes that a shape holds for each of its vertices, beside the eigenfunctions: distances above all.
PER_VERTEX = 300

_kept: OrderedDict[bytes, Shape] = OrderedDict()
_lock = Lock()
_folder: ShapeFolder | None = None


def kept_shape_steps(
    part: WorkingMesh, k: int, samples: int, seed: int, proxy_vertices: int | None
) -> Generator[float, None, Shape]:
    """`shape_steps`, or at once the shape that it returned for the same mesh and numbers before."""
    key = _content(part, k, samples, seed, proxy_vertices)
    with _lock:
        shape, folder = _kept.pop(key, None), _folder
    if shape is None and folder is not None:
        yield 0.0
        shape = folder.load(key, part)
    if shape is None:
        shape = yield from shape_steps(part, k, samples, seed, proxy_vertices)
        if folder is not None:
            yield 1.0
            folder.save(key, shape)
    with _lock:
        _kept[key] = shape  # last, as the one used most recently
        while sum(map(_bytes, _kept.values())) > MOST_BYTES:
            _kept.popitem(last=False)
    return shape


def store_shapes(folder: str | PathLike[str] | None, most_bytes: int = MOST_BYTES_ON_DISK) -> None:
    """Have shapes that are prepared from now on written to a folder, and read from it, also by other processes.

    Args:
        folder: where; made if it is missing. None to leave the disk alone again, as it is at first.
        most_bytes: what they may take there; those used longest ago go first.
    """
    global _folder
    stored = None if folder is None else ShapeFolder(folder, most_bytes)
    with _lock:
        _folder = stored


def forget_shapes() -> None:
    """Let go of all shapes that were kept in memory."""
    with _lock:
        _kept.clear()


def _content(part: WorkingMesh, *numbers: int | None) -> bytes:
    """A hash of all that a shape depends on."""
    digest = blake2b(repr((numbers, part.scale)).encode())
    for array in (part.vertices, part.triangles, part.flipped, part.vertex_of, part.triangle_of):
        digest.update(repr((array.shape, array.dtype)).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()


def _bytes(shape: Shape) -> int:
    """How much memory a shape takes, about, once a match has used it."""
    return (
        8 * len(shape.mesh.vertices) * (len(shape.basis.eigenvalues) + PER_VERTEX)
        + 20 * shape.proxy.full.vertices.nbytes
    )
