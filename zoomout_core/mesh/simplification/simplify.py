# SPDX-License-Identifier: GPL-3.0-or-later
"""Simplify a mesh whose corners have data, in several poses at once, along its seams.

Vertices are merged into neighbours in the order of their quadric errors (Garland and Heckbert 1997). Errors are summed
over the poses of the mesh (Mohr and Gleicher 2003), so that more vertices stay where it bends. Borders, seams of the
data and borders between labels are lines: a vertex on a line moves along it, and one where lines meet stays. Each
vertex of the result is a vertex of the mesh, with all of its data. If lines must be ignored, a corner that moves across
a seam keeps its own data, such as texture coordinates, so that no triangle mixes two charts. Small regions of a label,
such as eyes, do not vanish.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.simplification.collapsing_mesh import CollapsingMesh
from zoomout_core.runtime.progress import advance

# The largest number of regions that are protected from vanishing, relative to the vertices of the result.
REGIONS = 0.125
# Root mean square distances from their planes, relative to the extent, by which collapses may move vertices: at first,
# and once the least important layer is ignored. Farther ones would destroy parts.
DISTANCES = (0.01, 0.02)


def simplify(
    poses: Floats,
    triangles: Integers,
    layers: Sequence[Integers],
    counts: Sequence[int],
    mirror: Integers | None = None,
    uv: Floats | None = None,
    charts: Integers | None = None,
    regions: Integers | None = None,
) -> list[tuple[Integers, Integers, Integers]]:
    """Reduce a mesh step by step, to about the given numbers of vertices.

    Args:
        poses: (p, n, 3) positions in the poses, the first of which is at rest.
        triangles: (m, 3) vertex numbers.
        layers: numbers (m, 3) of the data of each corner, which differ across seams, the most important layer first. If
            the lines leave too many vertices, the last layers are ignored, and then `mirror`, see `DISTANCES`.
        counts: numbers of vertices of the results, the largest first.
        mirror: (n,) the mirror image of each vertex, -1 for none; images are treated alike.
        uv: (m, 3, 2) texture coordinates, whose triangles are not turned over.
        charts: (m, 3) numbers of the data that each corner keeps when it moves across a seam that is not a line; those
            of the first layer, when not given.
        regions: (m,) numbers of regions that do not vanish, such as eyes, the most important first, see `REGIONS`;
            none when not given.

    Returns:
        Three arrays for each count: (m',) the original triangle of each triangle of the result, (m', 3) an original
            corner at the vertex of each of its corners, and (m', 3) the original corner that each takes its data from.
            Corners are numbers in the flat list of all corners (3 m). The last two differ where a triangle reaches
            across a seam of `charts` that is not a line.
    """
    if charts is None:
        charts = layers[0] if len(layers) else np.zeros_like(triangles)
    mesh = CollapsingMesh(poses, triangles, charts, mirror, uv, regions)
    fewer = max(len(layers) - 1, 0)
    steps = [(fewer, DISTANCES[0]), *((kept, DISTANCES[1]) for kept in range(fewer, -1, -1))]
    mesh.mirror_diagonals(layers)
    mesh.set_lines(layers, DISTANCES[0])
    first = max(mesh.count_vertices(), counts[0] + 1)
    found = []
    for count in counts:
        mesh.guard_regions(0 if regions is None else int(REGIONS * count))
        while (now := mesh.count_vertices()) > count:
            advance(float(np.log(first / now) / np.log(first / counts[-1])))
            if mesh.collapse(now - count):
                continue
            if mesh.mirror is None and not steps:
                break
            if steps:
                kept, distance = steps.pop(0)
                mesh.set_lines(layers[:kept], distance)
            else:
                mesh.ignore_mirror()
        found.append((mesh.alive, mesh.corners.copy(), mesh.content.copy()))
    return found
