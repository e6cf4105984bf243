# SPDX-License-Identifier: GPL-3.0-or-later
"""Read and write meshes and their textures in MeshLab's formats."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, TypeAlias

from meshlab_filter.mesh_data import custom_in_ply
from meshlab_filter.trial import fault_of_file
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_polygons
from zoomout_core.mesh.formats.named_files import check_named_files
from zoomout_core.mesh.formats.opening import outside
from zoomout_core.runtime.extras import install_hint
from zoomout_core.runtime.input_files import OutsideError, beside
from zoomout_core.runtime.outputs import atomic_write_together, is_same_file

if TYPE_CHECKING:
    from pymeshlab import Image, Mesh, MeshSet

# Images of textures by their files.
TextureFiles: TypeAlias = "dict[Path, Image]"
# The results of a transfer that each format can store.
FORMATS = {
    ".ply": {"texcoord", "vertex_color", "face_color", "vertex_scalar", "face_scalar"},
    ".obj": {"texcoord", "vertex_color", "face_color"},
}
# How pymeshlab's message about an extension begins that it cannot write.
UNKNOWN_FORMAT = "Unknown format for save"
# Extensions of mesh files; other files in a folder are skipped.
SURFACES = {".3ds", ".ctm", ".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".stl", ".wrl", ".x3d", ".x3dv"}


def new_mesh_set() -> MeshSet:
    """A MeshSet without a mesh.

    Raises:
        ImportError: pymeshlab is not installed; the message says how to install it.
    """
    try:
        import pymeshlab
    except ImportError as error:
        raise ImportError(f"This command requires pymeshlab: {install_hint('meshlab')}.") from error
    return pymeshlab.MeshSet()


def load_mesh(ms: MeshSet, path: str | Path) -> int:
    """Load the mesh of a file into a MeshSet, as its current mesh.

    Returns:
        Its id.

    Raises:
        MeshError: the file cannot be read, or contains several meshes.
    """
    from pymeshlab import PyMeshLabException

    before = ms.mesh_number()
    gltf = Path(path).suffix.lower() in (".gltf", ".glb")
    check_named_files(path)  # MeshLab would read them anywhere
    if Path(path).suffix.lower() == ".off":  # MeshLab reads beyond the end of short lines, with undefined results
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
    _check_textures(ms, Path(path))
    return int(ms.current_mesh_id())


def _check_textures(ms: MeshSet, path: Path) -> None:
    """Delete the current mesh, and raise a MeshError, if a texture of it is not in the folder of its file."""
    for name in ms.current_mesh().textures():
        try:
            beside(name, path.parent)
        except OutsideError as error:
            ms.delete_current_mesh()
            raise outside(path, name) from error


def save_mesh(ms: MeshSet, output: str | Path, name: Path | None = None) -> None:
    """Write the current mesh; PLY files include custom attributes, which other programs read but MeshLab does not.

    Args:
        ms: a `pymeshlab.MeshSet`.
        output: the file to write.
        name: the file for messages, if `output` is a temporary one.

    Raises:
        MeshError: it cannot be written.
    """
    from pymeshlab import PyMeshLabException

    custom = dict.fromkeys(custom_in_ply(ms), True) if Path(output).suffix.lower() == ".ply" else {}
    try:
        with _staying():
            ms.save_current_mesh(str(output), **custom)
    except PyMeshLabException as error:
        reason = " ".join(str(error).split())
        if reason.startswith(UNKNOWN_FORMAT):
            raise MeshError(
                f"MeshLab cannot write the format of {name or output}: choose another, such as .ply."
            ) from None
        raise MeshError(
            f"{name or output} could not be written ({reason}): check disk space and permissions, or choose another "
            "place."
        ) from error


@contextmanager
def _staying() -> Iterator[None]:
    """A context manager that restores the working directory, which pymeshlab changes when it fails."""
    before = Path.cwd()
    try:
        yield
    finally:
        os.chdir(before)


def texture_files(mesh: Mesh, path: str | Path) -> TextureFiles:
    """The textures of a mesh that was read from a file."""
    return {Path(path).parent / name: image for name, image in mesh.textures().items()}


def save_beside(
    ms: MeshSet,
    output: Path,
    inputs: TextureFiles,
    brought: dict[str, bytes],
    in_place: bool = False,
    kept: Iterable[Path] = (),
) -> None:
    """Write the current mesh and its textures into a shared folder, completely or not at all.

    Args:
        ms: a `pymeshlab.MeshSet`.
        output: the file to write; its textures are written next to it.
        inputs: textures that were read; one that would be rewritten unchanged to its own path is left alone.
        brought: digests of the textures already written to the folder, by name; this mesh's are added.
        in_place: whether textures may replace input files.
        kept: further files that must not be replaced, unless `in_place`.

    Raises:
        MeshError: one of its textures has the name of another one.
        OutputError: it cannot be written.
    """
    with atomic_write_together(output, () if in_place else kept) as whole:
        save_mesh(ms, whole, output)
        # An OBJ file's materials are in a file whose name begins with its own; all others are textures.
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
    """Encode an image as pymeshlab writes it to a file with some extension."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"image{ending}"
        image.save(str(path))
        return path.read_bytes()


def check_format(output: Path) -> None:
    """Check before the work that a file's format can store the transferred data.

    Raises:
        MeshError: it cannot.
    """
    if output.suffix.lower() not in FORMATS:
        raise MeshError(
            f"{output} ends in '{output.suffix}', which cannot store the results: choose {' or '.join(FORMATS)}."
        )
