# SPDX-License-Identifier: GPL-3.0-or-later
"""Map files of `zoomout match` and `zoomout symmetry`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from zoomout_core.assets.files import inputs_of
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import MeshError, Surface
from zoomout_core.runtime.outputs import check_output


def check_map_output(path: str, inputs: Iterable[str], in_place: bool = False) -> None:
    """Check that a map can be written to a path, before it is computed.

    Raises:
        OutputError: the folder is missing or cannot be written to, or the file is an input or named by one.
        MeshError: the path does not end in .npz.
    """
    check_output(path, inputs_of(*inputs), in_place)
    if Path(path).suffix != ".npz":
        raise MeshError(f"{path} does not end in .npz: maps are written to .npz files only.")


def read_surface_map(path: str, source: Surface, target: Surface) -> SurfaceMap:
    """The map from `target` to `source` in a file that `match` wrote.

    Raises:
        MeshError: the file is not from `match`, or the map is between other surfaces.
    """
    surface_map = SurfaceMap.load(path, source)
    if len(surface_map.triangle) != len(target.vertices):
        raise MeshError(
            f"{path} maps {len(surface_map.triangle)} vertices, but the target has {len(target.vertices)}: give the "
            "two meshes of the map, in the same order."
        )
    return surface_map
