# SPDX-License-Identifier: GPL-3.0-or-later
"""MeshLab's projects (`.mlp`): files and transforms of the meshes of a document.

A project contains no mesh data, so changes that were not saved to a mesh file are not in it.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from meshlab_filter.files import TextureFiles, load_mesh, texture_files
from meshlab_filter.xml_elements import Element, read_elements
from zoomout_core.arrays import Floats
from zoomout_core.mesh.errors import MeshError
from zoomout_core.runtime.outputs import atomic_write

if TYPE_CHECKING:
    from pymeshlab import MeshSet

PROJECT = ".mlp"


@dataclass(frozen=True, eq=False)
class ProjectMesh:
    """A mesh of a project.

    Attributes:
        label: its name.
        path: its file.
        transform: (4, 4) to the global frame.
        visible: whether it is shown.
    """

    label: str
    path: Path
    transform: Floats
    visible: bool = True


def is_project(path: str | Path) -> bool:
    """Whether a file is a project, by its extension."""
    return Path(path).suffix.lower() == PROJECT


def read_project(path: str | Path) -> list[ProjectMesh]:
    """Read the meshes of a project, in order.

    Raises:
        MeshError: it is not a project, has no mesh, or has a mesh without a file; the message names the line.
        OSError: the file cannot be read.
    """
    root = read_elements(path, "MeshLabProject", PROJECT)
    meshes = [mesh for group in root.find("MeshGroup") for mesh in group.find("MLMesh")]
    if not meshes:
        raise MeshError(f"The project {path} has no mesh: add one and save it again.")
    return [_project_mesh(Path(path), mesh) for mesh in meshes]


def load_inputs(ms: MeshSet, path: str | Path) -> TextureFiles:
    """Load the mesh of a file, or the meshes of a project, into a MeshSet; the last one is current.

    Returns:
        Their textures.

    Raises:
        MeshError: a file cannot be read, or contains several meshes.
        OSError: the project cannot be read.
    """
    if not is_project(path):
        return texture_files(ms.mesh(load_mesh(ms, path)), path)
    textures: TextureFiles = {}
    for one in read_project(path):
        mesh = ms.mesh(load_mesh(ms, one.path))
        mesh.set_label(one.label)
        if not np.array_equal(one.transform, np.eye(4)):
            ms.apply_filter("set_matrix", transformmatrix=one.transform, freeze=False)
        textures |= texture_files(mesh, one.path)
    return textures


def files_of(path: str | Path) -> list[Path]:
    """The files of an input: itself, and those of a project's meshes.

    Raises:
        MeshError: it is not a project.
        OSError: the project cannot be read.
    """
    return [Path(path), *((one.path for one in read_project(path)) if is_project(path) else ())]


def write_project(path: Path, meshes: Sequence[ProjectMesh]) -> None:
    """Write a project of meshes.

    Raises:
        OutputError: it cannot be written.
    """
    lines = ["<!DOCTYPE MeshLabDocument>", "<MeshLabProject>", " <MeshGroup>"]
    for mesh in meshes:
        name, label = (quoteattr(text) for text in (_relative(mesh.path, path.parent), mesh.label))
        lines += [
            f'  <MLMesh filename={name} label={label} idInFile="-1" visible="{int(mesh.visible)}">',
            "   <MLMatrix44>",
            *(" ".join(f"{value:.17g}" for value in row) for row in mesh.transform),
            "</MLMatrix44>",
            "  </MLMesh>",
        ]
    with atomic_write(path) as part:
        part.write_text(
            "\n".join([*lines, " </MeshGroup>", " <RasterGroup/>", "</MeshLabProject>", ""]), encoding="utf-8"
        )


def _project_mesh(path: Path, element: Element) -> ProjectMesh:
    name = element.attributes.get("filename", "").replace("\\", "/")
    label = element.attributes.get("label") or name
    if not name:
        raise MeshError(
            f"Line {element.line} of {path}: the mesh '{label}' has no file; export it, and save the project again."
        )
    words = " ".join(matrix.text for matrix in element.find("MLMatrix44")).split() or np.eye(4).ravel()
    try:
        transform = np.array(words, dtype=np.float64).reshape(4, 4)
        if not np.isfinite(transform).all() or not np.linalg.det(transform[:3, :3]):
            raise ValueError
    except ValueError:
        raise MeshError(
            f"Line {element.line} of {path}: the mesh '{label}' has an invalid matrix; correct it."
        ) from None
    return ProjectMesh(label, _find(path.parent, name), transform, element.attributes.get("visible") != "0")


def _find(folder: Path, name: str) -> Path:
    """The file of a mesh; if its path does not exist, a file of the same name next to the project.

    MeshLab 2022 writes paths relative to the folder that a project was opened from, not the one it is saved to.
    """
    there, beside = folder / name, folder / Path(name).name
    return beside if beside.is_file() and not there.is_file() else there


def _relative(file: Path, folder: Path) -> str:
    """A file's path in a project, relative to the project's folder."""
    try:
        return os.path.relpath(file, folder).replace(os.sep, "/")
    except ValueError:  # on another drive
        return str(file)
