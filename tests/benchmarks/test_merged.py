# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets of shapes that are merged where their parts touch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks.generate.folder import write_set
from benchmarks.generate.merged import merge, write_merged
from benchmarks.official.lists import lists_in
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph

# Numbers of vertices around and along a tube, and its radius.
AROUND, ALONG, RADIUS = 16, 60, 0.15
# A flat grid that encloses little counts as solid.
ASKEW = Rotation.from_euler("xy", [0.7, 0.5])


def bow(gap: float) -> Surface:
    """A closed tube along a circle of radius 1, whose ends are a distance apart."""
    along = np.linspace(gap / 2, 2 * np.pi - gap / 2, ALONG)[:, None]
    around = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    out, up = 1 + RADIUS * np.cos(around), RADIUS * np.sin(around)
    rings = np.stack(np.broadcast_arrays(out * np.cos(along), out * np.sin(along), up), axis=-1)
    first = np.arange((ALONG - 1) * AROUND)
    second = first // AROUND * AROUND + (first + 1) % AROUND
    lid = np.array([[0, i, i + 1] for i in range(1, AROUND - 1)])
    triangles = [
        np.column_stack([first, second + AROUND, second]),
        np.column_stack([first, first + AROUND, second + AROUND]),
        lid,
        lid[:, ::-1] + (ALONG - 1) * AROUND,
    ]
    return Surface(ASKEW.apply(rings.reshape(-1, 3)), np.concatenate(triangles))


def test_touching_ends_merge_and_distant_ones_do_not() -> None:
    touching, apart = bow(0.02), bow(0.5)
    merged = merge(touching)
    assert merged is not None
    assert between_ends(touching) > 2
    assert between_ends(merged) < 1
    assert merge(apart) is None


def between_ends(surface: Surface) -> float:
    """Length of the shortest path along edges between the places that are nearest to the middle of either end."""
    lids = [[1, 0.15 * side, RADIUS] for side in (1, -1)]
    ends = cKDTree(surface.vertices).query(ASKEW.apply(lids))[1]
    return float(dijkstra(edge_graph(surface.vertices, surface.triangles), indices=ends[0])[ends[1]])


def test_merged_shapes_keep_their_places(tmp_path: Path) -> None:
    shapes = {"a": bow(0.02), "b": bow(0.5)}
    every = np.arange(ALONG * AROUND)
    write_set(tmp_path / "bows", shapes, {"a": every, "b": every}, [("a", "b")])
    write_merged(tmp_path / "merged", [tmp_path / "bows"], 0, 5)
    (written,) = lists_in(tmp_path / "merged")
    assert written.pairs == (("a_b_merged", "a_b_merged_whole"),)  # the other shape does not merge
    at, truth = written.places(*written.pairs[0])
    assert len(at) > 0.7 * len(every)
    merged = read_surface(written.shape_file("a_b_merged"))
    off = np.linalg.norm(merged.vertices[at] - shapes["a"].vertices[truth], axis=1)
    assert np.median(off) < 0.05
