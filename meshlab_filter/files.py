# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes and their textures from files and to files, in the formats that MeshLab knows."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, TypeAlias

from meshlab_filter.mesh_data import custom_in_ply
from meshlab_filter.trial import fault_of_file
from zoomout_core.mesh.files import read_polygons
from zoomout_core.mesh.surface import MeshError
from zoomout_core.runtime.outputs import atomic_write_together, is_same_file

if TYPE_CHECKING:
    from pymeshlab import Image, Mesh, MeshSet

# Images of textures by the files that they were read from.
TextureFiles: TypeAlias = "dict[Path, Image]"
# What of the results of a transfer the formats can hold.
FORMATS = {
    ".ply": {"texcoord", "vertex_color", "face_color", "vertex_scalar", "face_scalar"},
    ".obj": {"texcoord", "vertex_color", "face_color"},
}
# The endings of files that hold surfaces; what else lies in a folder is passed over.
SURFACES = {".3ds", ".ctm", ".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".stl", ".wrl", ".x3d", ".x3dv"}


def new_mesh_set() -> MeshSet:
    """A MeshSet without a mesh.

    Raises:
        ImportError: pymeshlab is not installed; the message says how to install it.
    """
    try:
        import pymeshlab
    except ImportError as error:
        raise ImportError("This command requires pymeshlab: pip install 'zoomout-core[meshlab]'.") from error
    return pymeshlab.MeshSet()


def load_mesh(ms: MeshSet, path: str | Path) -> int:
    """Add the mesh of a file to a MeshSet, as its current one.

    Returns:
        Its id.

    Raises:
        MeshError: the file cannot be read, or holds several meshes.
    """
    from pymeshlab import PyMeshLabException

    before = ms.mesh_number()
    gltf = Path(path).suffix.lower() in (".gltf", ".glb")
    if not Path(path).is_file():
        raise MeshError(f"There is no file {path}: check the path.")
    if Path(path).suffix.lower() == ".off":  # of a line too short, MeshLab reads beyond it: what then happens varies
        read_polygons(path)
    fault = fault_of_file(path, gltf)
    if fault:
        raise MeshError(f"{path} could not be read ({fault}): check the file.")
    try:
        with _staying():
            ms.load_new_mesh(str(path), **({"load_in_a_single_layer": True} if gltf else {}))
    except PyMeshLabException as error:
        raise MeshError(f"{path} could not be read ({' '.join(str(error).split())}): check the file.") from error
    if ms.mesh_number() > before + 1:
        raise MeshError(f"{path} contains {ms.mesh_number() - before} meshes: merge them into one.")
    return int(ms.current_mesh_id())


def save_mesh(ms: MeshSet, output: str | Path) -> None:
    """Write the current mesh; to PLY with its custom attributes, which other programs can read, not MeshLab.

    Raises:
        MeshError: it cannot be written.
    """
    from pymeshlab import PyMeshLabException

    custom = dict.fromkeys(custom_in_ply(ms), True) if Path(output).suffix.lower() == ".ply" else {}
    try:
        with _staying():
            ms.save_current_mesh(str(output), **custom)
    except PyMeshLabException as error:
        raise MeshError(
            f"{output} could not be written ({' '.join(str(error).split())}): check disk space and permissions, or "
            "choose another place."
        ) from error


@contextmanager
def _staying() -> Iterator[None]:
    """The process stays in its folder; where pymeshlab fails, it leaves it in the file's."""
    before = Path.cwd()
    try:
        yield
    finally:
        os.chdir(before)


def texture_files(mesh: Mesh, path: str | Path) -> TextureFiles:
    """The textures of a mesh that was read from a file."""
    return {Path(path).parent / name: image for name, image in mesh.textures().items()}


def save_beside(
    ms: MeshSet, output: Path, inputs: TextureFiles, brought: dict[str, bytes], in_place: bool = False
) -> None:
    """Write the current mesh into a folder that it shares with others, whole or not at all.

    Args:
        ms: a `pymeshlab.MeshSet`.
        output: the file to write; its textures come to lie beside it.
        inputs: textures that were read; where one would be written again to its own place, it stays as it is.
        brought: digests of the textures that others have written there, by name; those of this mesh are added.
        in_place: whether other pictures may take the place of those that were read.

    Raises:
        MeshError: another texture has a name that it needs.
        OutputError: it cannot be written.
    """
    with atomic_write_together(output) as whole:
        save_mesh(ms, whole)
        # An OBJ file's materials are in a file whose name begins with its own; all else are textures.
        images = [file for file in sorted(whole.parent.iterdir()) if not file.name.startswith(whole.name)]
        digests = {file.name: sha256(file.read_bytes()).digest() for file in images}
        for name, digest in digests.items():
            if brought.get(name, digest) != digest:
                raise MeshError(f"Another mesh has a different texture {name}: choose another output folder.")
        for file in images:
            for path, image in inputs.items():
                if not is_same_file(path, output.parent / file.name):
                    continue
                if _encode(image, file.suffix) == file.read_bytes():
                    file.unlink()
                    break
                if not in_place:
                    raise MeshError(
                        f"The texture {file.name} would overwrite the input image {path}: choose another output "
                        "folder, or pass --in-place."
                    )
        brought |= digests


def _encode(image: Image, ending: str) -> bytes:
    """An image as pymeshlab writes it to a file of an ending."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"image{ending}"
        image.save(str(path))
        return path.read_bytes()


def check_format(output: Path) -> None:
    """Check that a file's format can hold what is transferred; before the work begins, not after.

    Raises:
        MeshError: it cannot.
    """
    if output.suffix.lower() not in FORMATS:
        raise MeshError(
            f"{output} ends in '{output.suffix}', which cannot store the results: choose {' or '.join(FORMATS)}."
        )
