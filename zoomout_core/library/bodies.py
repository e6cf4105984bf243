# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies that represent a whole character in a library: small meshes of one part, with their descriptors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from zoomout_core.arrays import Floats, Integers, SingleFloats
from zoomout_core.library.descriptor import Descriptor, describe
from zoomout_core.library.surroundings import FEATURES, SURROUNDINGS, surroundings_of
from zoomout_core.matching.components.bodies import BODIES
from zoomout_core.matching.components.hulls import hull_of, main_part_coverage
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.partial.incomplete_shape import INCOMPLETE
from zoomout_core.matching.preparation.analysis import ShapeAnalysis
from zoomout_core.matching.preparation.prepare import prepare_shape
from zoomout_core.matching.preparation.proxy import make_proxy
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import border_edges
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.runtime.progress import stage
from zoomout_core.runtime.threads import for_each
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class BodyTuning(Tuning, set_by="library"):
    """The size of bodies, and of the matches between them."""

    vertices: int = tuned(2000, "vertices", 100, 10**6)  # of a body
    functions: int = tuned(60, "eigenfunctions", 10, 1000)  # size of the functional map
    samples: int = tuned(500, "samples", 50, 10_000)  # number of samples for computing it


BODY = BodyTuning()
# Kinds of bodies; only those of the same kind are compared.
HULL, TIGHT_HULL, MAIN_PART = "hull", "tight hull", "main part"


@dataclass(frozen=True, eq=False)
class Body:
    """A mesh of one part that represents a character, with its descriptor and the surroundings of its places."""

    vertices: Floats  # (n, 3) in the unit of the character
    triangles: Integers  # (m, 3)
    descriptor: Descriptor
    surroundings: SingleFloats  # (d, r, 4) see `surroundings_of`

    @property
    def surface(self) -> Surface:
        """The mesh, for a match."""
        return Surface(self.vertices, self.triangles)

    def as_arrays(self) -> dict[str, Any]:
        """Arrays that `from_arrays` reads; positions in single precision, surroundings in half precision."""
        mesh = {"vertices": self.vertices.astype(np.float32), "triangles": self.triangles.astype(np.int32)}
        return mesh | {"surroundings": self.surroundings.astype(np.float16)} | self.descriptor.as_arrays()

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> Body:
        """A body of arrays; raises KeyError if one is missing, and ValueError if they contradict each other."""
        vertices, triangles = arrays["vertices"].astype(np.float64), arrays["triangles"].astype(np.int64)
        surroundings = arrays["surroundings"].astype(np.float32)
        if surroundings.shape[1:] != (SURROUNDINGS.radii, FEATURES):
            raise ValueError("its surroundings have other radii")
        return cls(vertices, triangles, Descriptor.from_arrays(arrays), surroundings)


@dataclass(frozen=True, eq=False)
class LibraryAsset:
    """A prepared file of a library.

    Attributes:
        path: the file, or the asset in a .blend file, see `split_asset`.
        bodies: meshes that represent its shape, by kind.
    """

    path: Path
    bodies: dict[str, Body]


def match_options() -> MatchOptions:
    """The options of matches between bodies."""
    return MatchOptions(k_final=BODY.functions, samples=BODY.samples, proxy_vertices=None, partial="off")


def bodies_of(surface: Surface) -> dict[str, Body]:
    """Meshes that represent a surface, by kind: a hull, a tight hull, and the main part if that is most of the surface.

    A tight hull separates touching limbs, and the main part has separate limbs in any pose.

    Raises:
        MeshError: the surface cannot be analysed.
    """
    with stage("Finding the body", 0.0, 0.6):
        hulls = for_each(partial(hull_of, surface), (False, True))
    parts = dict(zip((HULL, TIGHT_HULL), hulls, strict=True))
    if main_part_coverage(surface, parts[HULL]) >= BODIES.much_of_body:
        parts[MAIN_PART] = surface.working.part(0)[0]
    with stage("Describing the body", 0.6, 1.0):
        return dict(zip(parts, for_each(_body, list(parts.values())), strict=True))


def _body(part: WorkingMesh) -> Body:
    """A part with few vertices, and its descriptor."""
    proxy = make_proxy(part, BODY.vertices)
    small = Surface(part.to_surface(proxy.vertices), proxy.mesh.triangles)
    shape = analyse_body(small)
    return Body(small.vertices, small.triangles, describe(shape), surroundings_of(shape))


def analyse_body(surface: Surface) -> ShapeAnalysis:
    """The analysis of the surface of a body, for its descriptor and for matches of it."""
    options = match_options()
    size = options.k_final, options.samples, options.seed, options.proxy_vertices
    return prepare_shape(surface.working.part(0)[0], *size, ahead=())


def may_be_part(bodies: Mapping[str, Body]) -> bool:
    """Whether a character has borders long enough for a part, such as a bust."""
    body = bodies.get(MAIN_PART)
    if body is None:
        return False
    begin, end = body.vertices[border_edges(body.triangles)].swapaxes(0, 1)
    length = np.linalg.norm(end - begin, axis=1).sum()
    return bool(length > INCOMPLETE.fragment * np.sqrt(body.surface.area))
