# SPDX-License-Identifier: GPL-3.0-or-later
"""The shapes of a collection: files, each prepared once, and summaries to compare maps by."""

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
from zoomout_core.matching.analysis import ShapeAnalysis
from zoomout_core.matching.components.bodies import find_bodies
from zoomout_core.matching.memory_cache import cached_working_mesh
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.pair import surface_vertices
from zoomout_core.matching.preparation import prepare_shape
from zoomout_core.mesh.files import read_shape
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.mesh.surface import MeshError, Surface
from zoomout_core.runtime.array_files import ArrayFileError, read_arrays
from zoomout_core.runtime.progress import stage
from zoomout_core.runtime.threads import on_one_blas_thread


@dataclass(frozen=True)
class Item:
    """A file of a collection.

    Attributes:
        name: of the shape, unlike that of any other.
        path: of the file that its surface is read from.
        original: the file that Blender read that surface from, and carries data from or onto; None for `path` itself.
    """

    name: str
    path: Path
    original: Path | None = None

    @property
    def file(self) -> Path:
        """The file of this shape that there was before."""
        return self.path if self.original is None else self.original


@dataclass(frozen=True, eq=False)
class ShapeSummary:
    """What of a prepared shape maps are compared by.

    Attributes:
        key: a hash of the file's content.
        samples: (s,) vertices of the surface.
        points: (s, 3) where they are.
        distances: (d, s) geodesic distances, at unit area, from the first samples to all.
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
        """(q,) the samples that vertices (q,) of the surface are, or that are nearest to them."""
        if np.array_equal(vertices, self.samples):
            return np.arange(len(vertices))
        return np.asarray(cKDTree(self.points).query(surface.vertices[vertices])[1])

    def as_arrays(self) -> dict[str, Any]:
        """What `from_arrays` makes the same of."""
        return {
            "key": np.frombuffer(bytes.fromhex(self.key), dtype=np.uint8),
            "samples": self.samples,
            "points": self.points,
            "distances": self.distances.astype(np.float32),
            "eigenvalues": self.eigenvalues,
        }

    @classmethod
    def from_arrays(cls, arrays: dict[str, Any]) -> ShapeSummary:
        """The shape that `as_arrays` was of."""
        return cls(**{**arrays, "key": arrays["key"].tobytes().hex()})

    @classmethod
    def load(cls, path: Path) -> ShapeSummary:
        """The shape of a file that was written from `as_arrays`.

        Raises:
            ArrayFileError: it is no such file.
        """
        try:
            return cls.from_arrays(read_arrays(path))
        except (KeyError, TypeError) as error:
            raise ArrayFileError("it is not a preprocessed shape") from error


def items_of(paths: Sequence[str | PathLike[str]]) -> list[Item]:
    """Files as items of a collection, each named after its file, with its ending where several would be called alike.

    Raises:
        MeshError: two files of the same name and ending.
    """
    files = [Path(path) for path in paths]
    stems = [path.stem for path in files]
    items = [Item(path.stem if stems.count(path.stem) == 1 else path.name, path) for path in files]
    first: dict[str, Path] = {}
    for item in items:
        other = first.setdefault(item.name.casefold(), item.path)
        if other is not item.path:
            raise MeshError(f"{other} and {item.path} would both be named {item.name}: rename one of them.")
    return items


def content_key(content: bytes) -> str:
    """A name for the content of a file."""
    return blake2b(content, digest_size=16).hexdigest()


@on_one_blas_thread
def summarise(path: Path, key: str, options: MatchOptions) -> ShapeSummary:
    """Prepare the shape of a file as a match with these options would, and say what maps of it are compared by.

    Raises:
        MeshError: the file cannot be read, or its shape not be matched.
    """
    surface = as_surface(read_shape(path))
    cached_working_mesh(surface)
    with stage("Finding the body", 0.0, 0.1):
        bodies = find_bodies(surface, surface, options.seed)
    with stage("Analysing the shape", 0.1, 1.0):
        size = options.k_final, options.samples, options.seed, options.proxy_vertices
        shape = prepare_shape(bodies[0].source, *size, ahead=())
    return summary_of(surface, shape, key)


def summary_of(surface: Surface, shape: ShapeAnalysis, key: str) -> ShapeSummary:
    """What maps of a prepared shape are compared by."""
    samples = surface_vertices(shape, shape.search.samples)
    return ShapeSummary(
        key,
        samples,
        surface.vertices[samples],
        shape.distances_between,
        shape.basis.eigenvalues,
    )


def spread_from_samples(surface: Surface, samples: Integers, images: Integers) -> Integers:
    """(n,) for each vertex of a surface the image (s,) of the nearest of its samples (s,), as a start for a map."""
    near = cKDTree(surface.vertices[samples]).query(surface.vertices)[1]
    return np.asarray(images[near])
