# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh files with all of their data: glTF, OBJ and PLY; only the shape for other formats."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory

from zoomout_core.assets.asset import Asset, one_line
from zoomout_core.assets.gltf.avatars import is_avatar
from zoomout_core.assets.gltf.compress import METHODS, compress_gltf
from zoomout_core.assets.gltf.read_asset import read_gltf
from zoomout_core.assets.gltf.write import write_gltf
from zoomout_core.assets.obj import read_obj, write_obj
from zoomout_core.assets.ply import read_ply, write_ply
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.blender_files import ENDINGS as OF_BLENDER
from zoomout_core.mesh.formats.compression.draco import library
from zoomout_core.mesh.formats.files import OPTIONAL_READERS, read_surface
from zoomout_core.mesh.formats.named_files import named_files
from zoomout_core.mesh.formats.opening import existing, explain_damage
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.runtime.input_files import check_paths
from zoomout_core.runtime.outputs import OutputError, atomic_write_together, is_same_file, replaces_input
from zoomout_core.transfer.attribute import element_count
from zoomout_core.transfer.finite import with_finite_values

READERS = {".glb": read_gltf, ".gltf": read_gltf, ".obj": read_obj, ".ply": read_ply, ".vrm": read_gltf}
WRITERS = {".glb": write_gltf, ".gltf": write_gltf, ".obj": write_obj, ".ply": write_ply, ".vrm": write_gltf}
# Formats that can store a map, see `stored_map`.
GLTF = tuple(ending for ending, writer in WRITERS.items() if writer is write_gltf)
# Formats that can be compressed.
COMPRESSIBLE = (".glb", ".gltf")
# Avatars: GLB files with bones and terms of use that only another avatar can provide.
AVATAR = ".vrm"

# Extensions of mesh files; other files in a folder are skipped.
MESHES = (*READERS, ".off", ".stl", ".dae", ".3mf", *OPTIONAL_READERS, *OF_BLENDER)


@memory_in_words
def read_asset(path: str | PathLike[str], folders: Iterable[str | PathLike[str]] = ()) -> Asset:
    """Read a mesh file with its attributes, materials and skin; only the shape for formats without a reader here.

    Args:
        path: the file.
        folders: further folders in which the buffers, materials and images that it names may be. By default, they must
            be in the folder of the file, or below; the notes of the asset list those that were left out.

    Raises:
        MeshError: the file is missing, cannot be read, or has no faces.
        ImportError: a package that reads this format is not installed.

    Example:
        >>> notes = zo.write_asset(zo.Asset(source), folder / "creature.glb")
        >>> len(zo.read_asset(folder / "creature.glb").surface.triangles) == len(source.triangles)
        True
    """
    check_paths(folders, "folders")
    place = existing(path)
    reader = READERS.get(place.suffix.lower())
    with explain_damage(path):
        return Asset(read_surface(place)) if reader is None else reader(place, tuple(map(Path, folders)))


def check_format(path: str | PathLike[str]) -> None:
    """Raise a MeshError if files with this extension cannot be written."""
    if Path(path).suffix.lower() not in WRITERS:
        raise MeshError(f"{path} has no supported file extension: use {', '.join(WRITERS)}.")


def check_avatar(base: Asset, path: str | PathLike[str]) -> None:
    """Raise a MeshError if a .vrm file would have no bones and terms of an avatar.

    Args:
        base: the asset whose nodes the file has.
        path: the file to write.
    """
    if Path(path).suffix.lower() == AVATAR and not is_avatar(base.document):
        raise MeshError(
            f"{path} would not be an avatar, because its joints are not those of a VRM file: leave out the skin "
            "weights if the target is an avatar, or write a .glb file."
        )


def check_writable(asset: Asset, path: str | PathLike[str], ending: str) -> None:
    """Check that an asset can be written in a format, by writing it to a temporary folder.

    Args:
        asset: the asset.
        path: the file that it is from.
        ending: extension of the format.

    Raises:
        MeshError: it cannot be written; the message says why.
    """
    with TemporaryDirectory(prefix="zoomout-") as folder:
        try:
            write_asset(asset, Path(folder) / f"trial{'.glb' if ending.lower() == AVATAR else ending}")
        except OutputError:  # the disk is full, which is not the fault of the file
            raise
        except Exception as error:  # broken documents are noticed in various ways
            reason = " ".join(f"{error}".rstrip(".").split()) or type(error).__name__
            raise MeshError(
                f"The materials and joints of {path} cannot be written as {ending[1:].upper()} ({reason}): correct the "
                "file, or choose other data or another format."
            ) from error


def check_compression(path: str | PathLike[str], method: str | None) -> None:
    """Raise an error if files with this extension cannot be compressed, or the package for it is not installed.

    Args:
        path: the file to write.
        method: one of `compress_gltf.METHODS`, or None.

    Raises:
        MeshError: only glTF is compressed, and avatars are not, because the programs for them do not read it.
        ImportError: the package is not installed.
    """
    if method is None:
        return
    if method not in METHODS:
        raise MeshError(f"The compression is {method!r}: choose {' or '.join(METHODS)}.")
    if Path(path).suffix.lower() not in COMPRESSIBLE:
        raise MeshError(f"{path} cannot be compressed: write {' or '.join(COMPRESSIBLE)} files, or leave it as it is.")
    if method == "draco":
        library()


def write_asset(
    asset: Asset, path: str | PathLike[str], inputs: Iterable[str | PathLike[str]] = (), compression: str | None = None
) -> tuple[str, ...]:
    """Write an asset and the files that it refers to; returns a sentence for each kind of data that was left out.

    Args:
        asset: the content.
        path: the file to write; its materials, images and buffer are written beside it.
        inputs: files that must not be replaced, neither by the file nor by those beside it.
        compression: "draco" or "meshopt", for glTF, see `compress_gltf`.

    Raises:
        MeshError: files with this extension cannot be written or compressed, a .vrm file would not be an avatar, or an
            attribute does not have one value for each element.
        ImportError: a package that writes or compresses this format is not installed.
        OutputError: it cannot be written, or would replace an input; all earlier files are unchanged.
        TypeError: it is not an Asset.

    Example:
        >>> zo.write_asset(zo.Asset(source), folder / "creature.ply")  # notes on data that the format cannot store
        ()
    """
    if not isinstance(asset, Asset):
        raise TypeError(f"An Asset is needed, not a {type(asset).__name__}: write a surface as zo.Asset(surface).")
    check_paths(inputs, "inputs")
    check_format(path)
    check_avatar(asset, path)
    check_compression(path, compression)
    whole = _with_finite_values(asset)
    with atomic_write_together(path, inputs) as place:
        notes = WRITERS[place.suffix.lower()](whole, place)
        if compression is not None:
            compress_gltf(place, compression)
    known = {note for each in asset.attributes for note in each.notes}
    filled = tuple(note for each in whole.attributes for note in each.notes if note not in known)
    return (*filled, *notes)


def _with_finite_values(asset: Asset) -> Asset:
    """The asset without NaN and infinite values, which glTF forbids.

    Raises:
        MeshError: an attribute does not have one value for each element, or no finite values.
    """
    for each in asset.attributes:
        count, unit = element_count(each.domain, asset.surface), each.domain.name.lower()
        if len(each.values) != count:
            raise MeshError(f"'{each.name}' has {len(each.values)} values for {count} {unit}s: give one for each.")
    return replace(asset, attributes=tuple(with_finite_values(each, asset.surface) for each in asset.attributes))


def inputs_of(*paths: str | PathLike[str], folders: Iterable[str | PathLike[str]] = ()) -> list[Path]:
    """Mesh files, and the buffers, materials and images that they name; files that cannot be read name none."""
    found = []
    for path in map(Path, paths):
        found.append(path)
        with suppress(MeshError):  # it is reported when it is read
            found += [named.path for named in named_files(path, map(Path, folders))]
    return found


def check_siblings(output: str | PathLike[str], inputs: Iterable[Path]) -> None:
    """Check, before the work begins, that the files beside an output will replace no input.

    Args:
        output: the file that will be written.
        inputs: the files that it is made from, see `inputs_of`.

    Raises:
        OutputError: one of the files may have the name of an input.
    """
    path = Path(os.path.realpath(output))
    stem = re.escape(one_line(path.stem))
    siblings = re.compile(rf"{stem}\.(mtl|bin)|{stem}_\d+\.\w+", re.IGNORECASE)
    for each in inputs:
        if siblings.fullmatch(each.name) and is_same_file(each.parent, path.parent) and each.exists():
            raise replaces_input(each)
