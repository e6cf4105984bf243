# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh files with all of their data: glTF, OBJ and PLY; only the shape for other formats."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from zoomout_core.assets.asset import Asset
from zoomout_core.assets.obj import read_obj, write_obj
from zoomout_core.assets.ply import read_ply, write_ply
from zoomout_core.assets.read_gltf import read_gltf
from zoomout_core.assets.write_gltf import write_gltf
from zoomout_core.mesh.blender_files import ENDINGS as OF_BLENDER
from zoomout_core.mesh.files import existing, read_surface
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.more_files import READERS as MORE_READERS
from zoomout_core.mesh.surface import MeshError
from zoomout_core.runtime.outputs import atomic_write_together

READERS = {".glb": read_gltf, ".gltf": read_gltf, ".obj": read_obj, ".ply": read_ply}
WRITERS = {".glb": write_gltf, ".gltf": write_gltf, ".obj": write_obj, ".ply": write_ply}

# Extensions of mesh files; other files in a folder are skipped.
MESHES = (*READERS, ".off", ".stl", ".dae", ".3mf", *MORE_READERS, *OF_BLENDER)


@memory_in_words
def read_asset(path: str | PathLike[str]) -> Asset:
    """Read a mesh file with its attributes, materials and skin; only the shape for formats without a reader here.

    Raises:
        MeshError: the file is missing, cannot be read, or has no faces.
        ImportError: a package that reads this format is not installed.

    Example:
        >>> notes = zo.write_asset(zo.Asset(source), folder / "creature.glb")
        >>> len(zo.read_asset(folder / "creature.glb").surface.triangles) == len(source.triangles)
        True
    """
    place = existing(path)
    reader = READERS.get(place.suffix.lower())
    try:
        return Asset(read_surface(place)) if reader is None else reader(place)
    except (MeshError, ImportError):
        raise
    except Exception as error:  # readers raise various errors on a broken file
        reason = " ".join(str(error).split())
        raise MeshError(
            f"{path} could not be read ({reason}): check that the file is complete and has the right extension."
        ) from error


def check_format(path: str | PathLike[str]) -> None:
    """Raise a MeshError if files with this extension cannot be written."""
    if Path(path).suffix.lower() not in WRITERS:
        raise MeshError(f"{path} has no supported file extension: use {', '.join(WRITERS)}.")


def write_asset(asset: Asset, path: str | PathLike[str]) -> tuple[str, ...]:
    """Write an asset and the files that it refers to; returns a sentence for each kind of data that was left out.

    Raises:
        MeshError: files with this extension cannot be written.
        OutputError: it cannot be written; the earlier file is unchanged.

    Example:
        >>> zo.write_asset(zo.Asset(source), folder / "creature.ply")  # notes on data that the format cannot store
        ()
    """
    check_format(path)
    with atomic_write_together(path) as place:
        return WRITERS[place.suffix.lower()](asset, place)
