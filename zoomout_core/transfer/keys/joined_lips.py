# SPDX-License-Identifier: GPL-3.0-or-later
"""Detect joined lips of the target, such as on scans: no key can open such a mouth."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats, row_norms
from zoomout_core.geometry.procrustes import SMALLEST
from zoomout_core.mesh.triangles import components, unique_edges
from zoomout_core.transfer.frames import on_working_mesh
from zoomout_core.transfer.keys.face_landmarks import OPEN_MOUTH, FaceSlits, are_parted
from zoomout_core.transfer.mapped_target import MappedTarget

# Lips are joined if edges connect them along this share of the mouth's width. On 13 heads with separate lips, errors of
# the map connect at most a third of it. On two heads with joined lips it is three quarters.
JOINED = 0.55


def has_joined_lips(opens: Floats, face: FaceSlits, mapped: MappedTarget) -> bool:
    """Whether edges of the target connect lips of the source's face, which a key (n_s, 3) separates."""
    target, skin, mouth = mapped.target.working, face.skin, face.slits[OPEN_MOUTH]
    if not len(mouth.upper):
        return False
    edges, _ = unique_edges(target.triangles)
    closed, opened = (
        on_working_mesh(target, mapped.surface_map.interpolate(shape))
        for shape in (mapped.source.vertices, mapped.source.vertices + opens)
    )
    near, far = (row_norms(shape[edges[:, 0]] - shape[edges[:, 1]]) for shape in (closed, opened))
    parted = edges[are_parted(near, far, float(row_norms(opens).max(initial=0)))]
    if not len(parted):
        return False
    left, right = (face.vertices[skin.find_corner(mouth, side)] for side in (skin.left, -skin.left))
    across = mapped.source.vertices[left] - mapped.source.vertices[right]
    along = closed @ across / max(float(across @ across), SMALLEST)
    beside = np.zeros(len(closed), dtype=bool)
    beside[parted] = True
    piece = components(edges[beside[edges].all(axis=1)], len(closed))
    lengths = [np.ptp(along[beside & (piece == number)]) for number in np.unique(piece[beside])]
    return bool(max(lengths) > JOINED)
