"""Meshes and their textures from files and to files, in the formats that MeshLab knows."""

from __future__ import annotations

from contextlib import AbstractContextManager, chdir
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from meshlab_filter.mesh_data import custom_in_ply
from zoomout_core.mesh.surface import MeshError

if TYPE_CHECKING:
    from pymeshlab import MeshSet

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
        raise ImportError("This needs pymeshlab: pip install 'zoomout-core[meshlab]'.") from error
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
    try:
        with _staying():
            ms.load_new_mesh(str(path), **({"load_in_a_single_layer": True} if gltf else {}))
    except PyMeshLabException as error:
        raise MeshError(f"{path} could not be read ({' '.join(str(error).split())}): check the file.") from error
    if ms.mesh_number() > before + 1:
        raise MeshError(f"{path} holds {ms.mesh_number() - before} meshes: merge them into one.")
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
        raise MeshError(f"{output} could not be written ({' '.join(str(error).split())}): write elsewhere.") from error


def _staying() -> AbstractContextManager[None]:
    """The process stays in its folder; where pymeshlab fails, it leaves it in the file's."""
    return chdir(Path.cwd())


def save_beside(ms: MeshSet, output: Path, textures: dict[str, bytes]) -> None:
    """Write the current mesh into a folder that it shares with others, whole or not at all.

    Args:
        ms: a `pymeshlab.MeshSet`.
        output: the file to write; its textures come to lie beside it.
        textures: digests of the textures that the others brought, by name; those of this mesh are added.

    Raises:
        MeshError: it cannot be written, or has another texture of a name that is taken.
        OSError: the folder cannot be written to.
    """
    with TemporaryDirectory(dir=output.parent) as folder:
        save_mesh(ms, Path(folder) / output.name)
        written = sorted(Path(folder).iterdir())
        # An OBJ file's materials are in a file whose name begins with its own; all else are textures.
        images = [file for file in written if not file.name.startswith(output.name)]
        digests = {file.name: sha256(file.read_bytes()).digest() for file in images}
        for name, digest in digests.items():
            if textures.get(name, digest) != digest:
                raise MeshError(f"Another mesh brought a different texture {name}: write to another folder.")
        for file in written:
            file.replace(output.parent / file.name)
        textures |= digests


def check_format(output: Path) -> None:
    """Check that a file's format can hold what is transferred; before the work begins, not after.

    Raises:
        MeshError: it cannot, or its folder is missing.
    """
    if output.suffix.lower() not in FORMATS:
        raise MeshError(
            f"{output} ends in '{output.suffix}': choose {' or '.join(FORMATS)}, which can hold the results."
        )
    check_folder(output)


def check_folder(output: Path) -> None:
    """Check that the folder is there to which a file or a folder is to be written.

    Raises:
        MeshError: it is missing.
    """
    if not output.parent.is_dir():
        raise MeshError(f"There is no folder {output.parent}: create it, or write elsewhere.")
