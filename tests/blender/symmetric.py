# SPDX-License-Identifier: GPL-3.0-or-later
"""A posed creature with different topology on its two sides, and shape keys to mirror."""

import numpy as np
from creatures import creature
from scenes import from_pydata, key_shape, positions

from zoomout_core.mesh.triangles import vertex_normals

BENT = creature(1500, seed=1, bend=0.9)
X = BENT.directions[:, 0]
LEFT, RIGHT = X > 0.1, X < -0.1
# The tips of the arms, by the sign of x.
TIP = {1: int(np.argmax(X)), -1: int(np.argmin(X))}


def new_object():
    return from_pydata("Creature", BENT.surface.vertices.tolist(), BENT.surface.triangles.tolist())


def bumps(shares):
    """(n, 3) displacements along the normals of the creature, by their sizes (n,)."""
    return 0.1 * shares[:, None] * vertex_normals(BENT.surface.vertices, BENT.surface.triangles)


def add_key(obj, name, offsets):
    if obj.data.shape_keys is None:
        obj.shape_key_add(name="Basis")
    key = obj.shape_key_add(name=name)
    key.points.foreach_set("co", np.ascontiguousarray(positions(obj.data) + offsets, np.float32).ravel())
    obj.active_shape_key_index = len(obj.data.shape_keys.key_blocks) - 1
    return key


def key_offsets(obj, name):
    return key_shape(obj.data, name) - key_shape(obj.data, "Basis")


def off_by(found, wanted):
    """The mean length of the error, relative to that of the expected offsets."""
    return np.linalg.norm(found - wanted, axis=1).mean() / np.linalg.norm(wanted, axis=1).mean()


def edges_between(mesh, inside):
    """(e,) the edges of a triangle mesh between selected faces (f,) and others."""
    edge_of = np.array([loop.edge_index for loop in mesh.loops])
    return np.bincount(edge_of, np.repeat(inside, 3), len(mesh.edges)) == 1
