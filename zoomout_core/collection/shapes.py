# SPDX-License-Identifier: GPL-3.0-or-later
"""The shapes of a collection: files that are each prepared once, and summaries for comparing maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from zoomout_core.arrays import Floats, Integers
from zoomout_core.matching.components.bodies import find_bodies
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.memory_cache import cached_working_mesh
from zoomout_core.matching.preparation.prepare import prepare_shape
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_shape
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.array_files import ArrayFileError, read_arrays
from zoomout_core.runtime.progress import stage
from zoomout_core.runtime.threads import on_one_blas_thread


@dataclass(frozen=True)
class Item:
    """A file of a collection.

    Attributes:
        name: unique name of the shape.
        path: the file that its surface is read from.
        original: the file that Blender read that surface from and transfers data from or to; None for `path` itself.
    """

    name: str
    path: Path
    original: Path | None = None

    @property
    def file(self) -> Path:
        """The user's file of this shape."""
        return self.path if self.original is None else self.original


@dataclass(frozen=True, eq=False)
class ShapeSummary:
    """The part of a prepared shape that maps are compared by.

    Attributes:
        key: a hash of the file's content.
        samples: (s,) sampled vertices of the surface.
        points: (s, 3) their positions.
        distances: (d, s) geodesic distances at unit area from the first d samples to all.
        eigenvalues: (k,).
    """

    key: str
    samples: Integers
    points: Floats
    distances: Floats
    eigenvalues: Floats

    @cached_property
    def _nearest_distance_sample(self) -> Integers:
        return np.asarray(np.argmin(self.distances, axis=0))

    def distance(self, one: Integers, other: Integers) -> Floats:
        """(q,) geodesic distances, at unit area, between samples (q,) and samples (q,)."""
        return np.where(one == other, 0.0, self.distances[self._nearest_distance_sample[one], other])

    def number_of(self, vertices: Integers, surface: Surface) -> Integers:
        """(q,) number of the sample at, or nearest to, each of some vertices (q,) of the surface."""
        if np.array_equal(vertices, self.samples):
            return np.arange(len(vertices))
        return np.asarray(cKDTree(self.points).query(surface.vertices[vertices])[1])

    def as_arrays(self) -> dict[str, Any]:
        """Arrays for a file that `load` reads."""
        return {
            "key": np.frombuffer(bytes.fromhex(self.key), dtype=np.uint8),
            "samples": self.samples,
            "points": self.points,
            "distances": self.distances.astype(np.float32),
            "eigenvalues": self.eigenvalues,
        }

    @classmethod
    def load(cls, path: Path) -> ShapeSummary:
        """Read a summary from a file that was written from `as_arrays`.

        Raises:
            ArrayFileError: it is not such a file.
        """
        try:
            arrays: dict[str, Any] = read_arrays(path)
            return cls(**arrays | {"key": arrays["key"].tobytes().hex()})
        except (KeyError, TypeError) as error:
            raise ArrayFileError("it is not a preprocessed shape") from error


def items_of(paths: Sequence[str | PathLike[str]]) -> list[Item]:
    """Turn files into items of a collection, named by file; with extension if names would be equal.

    Raises:
        MeshError: two files have the same name and extension.
    """
    files = [Path(path) for path in paths]
    stems = [path.stem for path in files]
    names = [path.stem if stems.count(path.stem) == 1 else path.name for path in files]
    items = [Item(_printable(name), path) for name, path in zip(names, files, strict=True)]
    first: dict[str, Path] = {}
    for item in items:
        other = first.setdefault(item.name.casefold(), item.path)
        if other is not item.path:
            raise MeshError(f"{other} and {item.path} would both be named {item.name}: rename one of them.")
    return items


def _printable(name: str) -> str:
    """The name of a file, with other bytes than those of UTF-8 written as numbers, for reports and keys."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def content_key(content: bytes) -> str:
    """A hash of the content of a file."""
    return blake2b(content, digest_size=16).hexdigest()


@on_one_blas_thread
def summarise(path: Path, key: str, options: MatchOptions) -> ShapeSummary:
    """Prepare the shape of a file as a match with these options would, and summarise it.

    Raises:
        MeshError: the file cannot be read, or its shape cannot be matched.
    """
    surface = as_surface(read_shape(path))
    cached_working_mesh(surface)
    with stage("Finding the body", 0.0, 0.1):
        bodies = find_bodies(surface, surface, options.seed)
    with stage("Analyzing the shape", 0.1, 1.0):
        size = options.k_final, options.samples, options.seed, options.proxy_vertices
        shape = prepare_shape(bodies[0].source, *size, ahead=())
    return summary_of(surface, shape, key)


def summary_of(surface: Surface, shape: ShapeAnalysis, key: str) -> ShapeSummary:
    """Summarise a prepared shape."""
    samples = shape.surface_vertex[shape.search.samples]
    return ShapeSummary(key, samples, surface.vertices[samples], shape.distances_between, shape.basis.eigenvalues)


def spread_from_samples(surface: Surface, samples: Integers, images: Integers) -> Integers:
    """(n,) for each vertex the image of the nearest sample, to start a map from images (s,) of samples (s,)."""
    near = cKDTree(surface.vertices[samples]).query(surface.vertices)[1]
    return np.asarray(images[near])
