# SPDX-License-Identifier: GPL-3.0-or-later
"""Repair a finished map: rematch wrong branches, find where it tears the target apart, and fill these places in.

A map that is right as a whole may still send a patch of the target to another limb, finger or lip, where the source's
surfaces face each other. Closest points cannot distinguish the two sides, but geodesic distances can: the images of two
neighbours are close in space and far apart along the surface. Such patches, and edges whose images are far too long,
are filled in from the rest by `fill_patches`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Indices, Integers, any_in_row
from zoomout_core.geometry.procrustes import SMALLEST
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.refinement.branches import branches_of, exchange_branches
from zoomout_core.matching.refinement.fill_patches import fill_patches
from zoomout_core.matching.refinement.image_features import Images, PairMeshes, image_lengths
from zoomout_core.matching.registration.nonrigid_icp import replace_images
from zoomout_core.mesh.triangles import at_any, components
from zoomout_core.tuning import Tuning, tuned

# Share of the target's area below which a component is too small, as a strand of hair is, to have parts cut off.
SMALL_COMPONENT = 0.05


@dataclass(frozen=True)
class RepairTuning(Tuning, set_by="everywhere"):
    """Which edges are torn, and which vertices beside them are filled in."""

    max_stretch: float = tuned(4.0, "1", 1, 100)  # torn edges are longer than this multiple of the median ratio,
    min_length: float = tuned(0.02, "at unit area", 0, 1)  # and longer than this
    # Edges from this multiple on may cut a part off. On 60 pairs, some of them damaged, 65 % of the area that they cut
    # off is off by more than 0.1. With `max_stretch` it is 60 % of an area that is a fifth smaller.
    seam: float = tuned(3.0, "1", 1, 100)
    small_patch: float = tuned(0.02, "1", 0, 1)  # patches below this part of their component are filled in
    min_trusted: float = tuned(0.5, "1", 0, 1)  # a component is repaired only if this fraction of its area is not torn
    # Maximum number of rounds of filling; they end when nothing is torn. Between a knight and a heavy man, .60 % of
    # the edges are torn after one, .27 % after two, .24 % after three, and .22 % after five.
    rounds: int = tuned(3, "rounds", 1, 100)
    # Longest edge to a vertex that is filled in along with torn ones: on coarse meshes the next vertex is far away.
    around: float = tuned(0.05, "at unit area", 0, 10)


REPAIR = RepairTuning()


class Repair(NamedTuple):
    """A repaired map."""

    surface_map: SurfaceMap  # from the target to the source
    filled: Booleans  # (n_t,) vertices whose images were filled in from their surroundings
    torn: Booleans  # (n_t,) vertices at edges that are torn still
    # (n_t,) share of its component's area, in [0, 1], that a vertex can reach without crossing a tear. Small on a limb
    # that is mapped to another limb. Filled places and small components count as connected with everything.
    connected: Floats


def repair(pair: Pair, surface_map: SurfaceMap, has_partner: Booleans | None = None) -> Repair:
    """Rematch branches that are on the wrong branch, and fill in torn places; exact landmarks keep their images.

    Of a part, only vertices that have a partner (n_t,) can be torn apart: others have their images anywhere.

    Bases of rematched branches may show further wrong branches, and what a filling leaves torn is filled in again, from
    surroundings that have become smoother.
    """
    meshes, of_both = PairMeshes(pair, has_partner), branches_of(pair)
    branches = filled = np.zeros(len(pair.target.vertices), dtype=bool)
    connected = np.ones(len(branches))
    images = meshes.images_by(surface_map)
    length = image_lengths(images.features, meshes.edges)
    for _ in range(REPAIR.rounds):
        exchanged, bases = exchange_branches(pair, surface_map, of_both)
        moved = exchanged.triangle != surface_map.triangle
        branches = branches | moved
        moved = (moved | any_in_row(exchanged.barycentric != surface_map.barycentric))[meshes.target.surface_vertex]
        at, beside = np.flatnonzero(moved), at_any(moved, meshes.edges)  # all else is known from the last round
        images.replace_at(at, meshes.images_by(exchanged, at))
        length[beside] = image_lengths(images.features, meshes.edges[beside])
        found = _fill_torn(meshes, exchanged, images, length, bases, branches)
        surface_map, filled = found.surface_map, filled | found.filled
        connected = np.minimum(connected, found.connected)
        if not (bases.any() or found.torn.any()):
            break
    return Repair(surface_map, filled, found.torn, connected)


def _fill_torn(
    meshes: PairMeshes,
    surface_map: SurfaceMap,
    images: Images,
    length: Floats,
    bases: Booleans,
    branches: Booleans,
) -> Repair:
    """Fill in the places at which a map is torn, and the bases (n_t,) of branches (n_t,) that were rematched.

    The images of the working vertices, and the lengths (e,) of the images of their edges, are updated in place.
    """
    source, target, edges = meshes.source, meshes.target, meshes.edges
    member = target.surface_vertex
    known = meshes.known if meshes.known.any() else np.ones(len(edges), dtype=bool)
    limit = REPAIR.max_stretch * float(np.median((length / np.maximum(meshes.length, SMALLEST))[known]))
    torn = _torn(length, meshes.length, limit) & meshes.known
    seams = torn | (_torn(length, meshes.length, limit * REPAIR.seam / REPAIR.max_stretch) & meshes.known)
    patch = components(edges[meshes.known & ~seams], len(member))
    connected = _connected_share(meshes, seams, patch)
    joined = edges[meshes.known & seams & ~torn]  # seams that are no tears join patches
    patch = components(patch[joined], int(patch.max()) + 1)[patch]
    filled = ((_to_fill(meshes, torn, patch) & ~branches[member]) | bases[member]) & ~meshes.fixed
    if filled.any():
        beside = at_any(filled, edges)  # edges that the filling changes
        usual = limit / REPAIR.max_stretch * meshes.length[beside]
        fill_patches(images, filled, meshes, beside, usual, REPAIR.max_stretch)
        length[beside] = image_lengths(images.features, edges[beside])
        torn = _torn(length, meshes.length, limit) & meshes.known
    at_torn = np.zeros(len(filled), dtype=bool)
    at_torn[edges[torn]] = True
    vertex_of = target.vertex_of
    changed = np.flatnonzero(_on_surface(filled, vertex_of))
    new_triangle = source.triangle_of[images.triangle[vertex_of[changed]]]
    new = SurfaceMap(new_triangle, images.barycentric[vertex_of[changed]], surface_map.source_triangles)
    repaired = replace_images(surface_map, changed, new)
    area = np.bincount(target.component, meshes.areas)
    connected[filled | meshes.fixed | (area < SMALL_COMPONENT * area.sum())[target.component]] = 1
    return Repair(
        repaired,
        _on_surface(filled, vertex_of),
        _on_surface(at_torn & ~meshes.fixed, vertex_of),
        np.where(vertex_of >= 0, connected[vertex_of], 1.0),
    )


def _torn(length: Floats, own: Floats, limit: float) -> Booleans:
    """(e,) which edges have images that are far too long.

    The lengths (e,) are those of the images, in space or along the surface, and `own` (e,) are those on the target. The
    limit is the ratio above which they are torn.
    """
    return np.asarray((length / np.maximum(own, SMALLEST) > limit) & (length > REPAIR.min_length))


def _connected_share(meshes: PairMeshes, torn: Booleans, patch: Indices) -> Floats:
    """(n,) the part of its component's area that each vertex is connected with along edges that are not torn (e,).

    The patches (n,) are those that these edges connect. The part is 1 on pieces of a component without a tear, even if
    they only touch the others.
    """
    edges, areas, component = meshes.edges, meshes.areas, meshes.target.component
    component_area = np.bincount(component, areas)[component]
    share = np.bincount(patch, areas)[patch] / np.maximum(component_area, SMALLEST)
    is_torn = np.zeros(len(areas), dtype=bool)  # by patch
    is_torn[patch[edges[torn]]] = True
    return np.where(is_torn[patch], share, 1.0)


def _to_fill(meshes: PairMeshes, torn: Booleans, patch: Indices) -> Booleans:
    """(n,) vertices near torn edges (e,) and on small patches (n,) that these cut off, on components mostly whole."""
    edges, areas, component = meshes.edges, meshes.areas, meshes.target.component
    chosen = _connected_share(meshes, torn, patch) < REPAIR.small_patch
    chosen[edges[torn]] = True
    chosen[edges[at_any(chosen, edges) & (meshes.length < REPAIR.around)]] = True
    whole = np.bincount(component, areas * ~chosen)[component]
    component_area = np.bincount(component, areas)[component]
    return np.asarray(chosen & (whole > REPAIR.min_trusted * component_area))


def _on_surface(chosen: Booleans, vertex_of: Integers) -> Booleans:
    """(n_surface,) which vertices of a surface belong to some vertices (n,) of its working mesh."""
    return np.asarray((vertex_of >= 0) & chosen[vertex_of])
