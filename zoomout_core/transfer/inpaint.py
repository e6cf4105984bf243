# SPDX-License-Identifier: GPL-3.0-or-later
"""Fill in values where the map cannot be trusted, from their surroundings on the target.

Abdrashitov, Raichstat, Monsen and Hill, Robust Skin Weights Transfer via Weight Inpainting (2023). The values w of
doubtful vertices minimise w' (-L + L M^-1 L) w, while those of trusted vertices are fixed. L is the Laplacian, and M
has the areas of the vertices. The second term continues them smoothly, the first limits overshoot. Both are computed at
unit area, so that the result does not depend on units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array, hstack, vstack
from scipy.sparse.linalg import SuperLU
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.sparse_solve import factorise
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.messages import plural
from zoomout_core.spectral.laplacian import mesh_laplacian
from zoomout_core.transfer.groups import first_of_each

# Columns that are solved together; bounds the memory.
BLOCK = 16
# Minimum area of a vertex relative to the mean; smaller ones worsen the condition without a smoother result.
MIN_VERTEX_AREA = 1e-3
# Maximum number of doubtful vertices for both terms. For more, the factors take gigabytes; those of only the first term
# take a fifth of that.
MAX_BIHARMONIC = 150_000
# Distance from the doubtful vertices, in edges, over which the Laplacian is assembled; two are needed.
ASSEMBLED_RINGS = 4
# Area of a loose part, relative to the total, below which it moves as a whole, such as a button or an eye.
SMALL_PART = 0.02
# Smaller skinning weights move nothing visibly, but count towards limits.
MIN_WEIGHT = 1e-4


@dataclass(frozen=True, eq=False)
class Filling:
    """The vertices of a surface to fill in, prepared for any number of values."""

    filled: Integers  # (f,) doubtful vertices with trusted ones on their part of the surface
    row: Integers  # (f,) position of each among k trusted places, followed by u doubtful ones
    follower: Integers  # (c,) vertices of small loose parts without any trusted vertex
    followed: Integers  # (c,) the trusted vertex nearest to the part of each
    left: int  # number of doubtful vertices that stay unchanged: on larger parts without a trusted vertex, or no face
    merged: csr_array  # (k, n) sparse; means of the trusted vertices in one place
    coupling: csr_array  # (u, k) sparse; the block of the system for the trusted places
    factor: SuperLU | None  # the factors of the remaining block, or None if u is zero

    def fill(self, values: Floats, following: bool = False) -> Floats:
        """Fill in values (n, d) from those of trusted vertices, within their range.

        They are left if those of trusted vertices are not finite. Followers take the values of the vertices that they
        follow, or stay unchanged.
        """
        known = self.merged @ values
        whole = values.copy()
        if following:
            whole[self.follower] = values[self.followed]
        if len(self.filled) and np.isfinite(known).all():
            solved = np.clip(self._solve(-(self.coupling @ known)), known.min(axis=0), known.max(axis=0))
            whole[self.filled] = np.concatenate([known, solved])[self.row]
        return whole

    def fill_weights(self, weights: csr_array) -> csr_array:
        """Fill in sparse weights (n, groups), from zero to one; followers take those of the vertex that they follow.

        Only groups that occur around a hole extend into it.
        """
        n, groups = weights.shape
        known = csr_array(self.merged @ weights)
        pull = csc_array(self.coupling @ known)
        pull.eliminate_zeros()
        occurring = np.flatnonzero(np.diff(pull.indptr))
        blocks = [csr_array((pull.shape[0], 0))]
        for first in range(0, len(occurring), BLOCK):
            columns = pull[:, occurring[first : first + BLOCK]].toarray()
            solved = np.clip(self._solve(-columns), 0, max(1, weights.max()))
            blocks.append(csr_array(np.where(solved < MIN_WEIGHT, 0, solved)))
        narrow = hstack(blocks, format="csr")
        found = csr_array((narrow.data, occurring[narrow.indices], narrow.indptr), shape=(narrow.shape[0], groups))
        origin = np.arange(n)
        origin[self.follower] = self.followed
        origin[self.filled] = n + self.row
        return csr_array(vstack([weights, known, found], format="csr")[origin])

    def notes(self, following: bool = False) -> tuple[str, ...]:
        """Sentences for the user; `following` as for `fill`."""
        left = self.left + (0 if following else len(self.follower))
        counted = (
            plural(
                len(self.filled),
                "1 vertex without a usable match took its neighbors' values.",
                "{count:,} vertices without a usable match took their neighbors' values.",
            ),
            plural(
                len(self.follower) * following,
                "1 vertex of a small part without a usable match follows the nearest part.",
                "{count:,} vertices of small parts without a usable match follow the nearest part.",
            ),
            plural(
                left,
                "1 vertex without a usable match was left as mapped, because no vertex of its part has one.",
                "{count:,} vertices without a usable match were left as mapped, because no vertex of their part "
                "has one.",
            ),
        )
        return tuple(note for note in counted if note.values["count"])

    def _solve(self, right: Floats) -> Floats:
        """(u, b) solutions for right-hand sides (u, b)."""
        return right if self.factor is None else np.asarray(self.factor.solve(np.ascontiguousarray(right)))


def filling(surface: Surface, trusted: Booleans) -> Filling:
    """Prepare to fill in the vertices of a surface that are not trusted (n,).

    Each connected part of the surface, with coincident borders welded, is filled in from its own trusted vertices.
    """
    working, vertex_of = surface.working, surface.working.vertex_of
    known = np.zeros(len(working.vertices), dtype=bool)
    known[vertex_of[trusted & (vertex_of >= 0)]] = True
    anchored = np.bincount(working.component[known], minlength=working.component.max() + 1) > 0
    unknown = ~known & anchored[working.component]
    row = np.full(len(known) + 1, -1)  # the extra last entry is for vertex_of = -1
    row[np.flatnonzero(known)] = np.arange(known.sum())
    row[np.flatnonzero(unknown)] = known.sum() + np.arange(unknown.sum())

    doubtful = np.flatnonzero(~trusted)
    filled = doubtful[row[vertex_of[doubtful]] >= 0]
    follower, place = _followers(working, known, ~anchored & are_small(working), doubtful)
    giver = np.flatnonzero(trusted & (vertex_of >= 0))
    given = vertex_of[giver]
    one_giver = np.empty(len(known), dtype=np.int64)
    one_giver[given] = giver
    share = 1 / np.bincount(given, minlength=len(known))[given]
    coupling, factor = _system(working, known, unknown)
    return Filling(
        filled=filled,
        row=row[vertex_of[filled]],
        follower=follower,
        followed=one_giver[place],
        left=len(doubtful) - len(filled) - len(follower),
        merged=csr_array((share, (row[given], giver)), shape=(known.sum(), len(trusted))),
        coupling=coupling,
        factor=factor,
    )


def _system(working: WorkingMesh, known: Booleans, unknown: Booleans) -> tuple[csr_array, SuperLU | None]:
    """The rows of the system at unknown vertices: the block (u, k) for the known ones, and factors of the rest."""
    if not unknown.any():
        return csr_array((0, int(known.sum()))), None
    near = unknown.copy()
    for _ in range(ASSEMBLED_RINGS):
        near[working.triangles[near[working.triangles].any(axis=1)]] = True
    triangles = (np.cumsum(near) - 1)[working.triangles[near[working.triangles].all(axis=1)]]
    stiffness, shares = mesh_laplacian(working.vertices[near], triangles)
    areas = shares * triangle_areas(working.vertices[near], triangles).sum()
    rows = csr_array(stiffness)[unknown[near]]
    if unknown.sum() <= MAX_BIHARMONIC:
        rows = rows + rows @ diags_array(1 / np.maximum(areas, MIN_VERTEX_AREA * areas.mean())) @ stiffness
    columns = csc_array(rows)
    factor = factorise(columns[:, np.flatnonzero(unknown[near])])
    pull = csr_array(columns[:, np.flatnonzero(known[near])])
    place = (np.cumsum(known) - 1)[near & known]
    return csr_array(
        (pull.data, place[pull.indices], pull.indptr), shape=(int(unknown.sum()), int(known.sum()))
    ), factor


def are_small(working: WorkingMesh) -> Booleans:
    """(c,) which connected components are small, such as buttons."""
    areas = triangle_areas(working.vertices, working.triangles)
    return np.bincount(working.component[working.triangles[:, 0]], areas) < SMALL_PART * areas.sum()


def _followers(
    working: WorkingMesh, known: Booleans, following: Booleans, doubtful: Integers
) -> tuple[Integers, Integers]:
    """The doubtful vertices on following components, and the known working vertex nearest to their component."""
    at = working.vertex_of[doubtful]
    follower = doubtful[(at >= 0) & following[working.component[at]]]
    if len(follower) == 0 or not known.any():
        return follower[:0], follower[:0]
    places, vertex = np.flatnonzero(known), working.vertex_of[follower]
    distance, nearest = map(np.asarray, cKDTree(working.vertices[places]).query(working.vertices[vertex]))
    component = working.component[vertex]
    first = first_of_each(component, distance)
    return follower, places[nearest[first[np.searchsorted(component[first], component)]]]
