"""Prepared shapes, kept for the next match: one source is often matched with many targets, and again.

A shape is known by its content, so what was edited is prepared anew. Nothing is written to disk.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Generator
from hashlib import blake2b
from threading import Lock

import numpy as np

from zoomout_core.correspondence.shape import Shape, shape_steps
from zoomout_core.surface import WorkingMesh

# The shapes kept take at most so many bytes: some ten of the usual size.
MOST_BYTES = 256 << 20
# Numbers of eight bytes that a shape holds for each of its vertices, beside the eigenfunctions: distances above all.
PER_VERTEX = 300

_kept: OrderedDict[bytes, Shape] = OrderedDict()
_lock = Lock()


def kept_shape_steps(
    part: WorkingMesh, k: int, samples: int, seed: int, proxy_vertices: int | None
) -> Generator[float, None, Shape]:
    """`shape_steps`, or at once the shape that it returned for the same mesh and numbers before."""
    key = _content(part, k, samples, seed, proxy_vertices)
    with _lock:
        shape = _kept.pop(key, None)
    if shape is None:
        shape = yield from shape_steps(part, k, samples, seed, proxy_vertices)
    with _lock:
        _kept[key] = shape  # last, as the one used most recently
        while sum(map(_bytes, _kept.values())) > MOST_BYTES:
            _kept.popitem(last=False)
    return shape


def forget_shapes() -> None:
    """Let go of all shapes that were kept."""
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
