# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh files: surfaces and point clouds from OFF, PLY, OBJ, STL, glTF and all other formats that trimesh reads.

Vertices keep their number and order, since landmarks and maps refer to them by number. Formats with polygons are read
here, because trimesh alters them. It splits the vertices of OBJ where texture coordinates or normals differ, and
regroups them by material. It assumes that all faces of a binary PLY are as large as the first, and rejects OFF with
faces of several sizes. Shapes of glTF are those of its assets. Trimesh reads the other formats; it keeps their vertices
with processing switched off.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from io import BytesIO
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zipfile import ZipFile

import numpy as np

from zoomout_core.arrays import Booleans
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.blender_files import ENDINGS as OF_BLENDER
from zoomout_core.mesh.formats.blender_files import write_surface
from zoomout_core.mesh.formats.gltf_files import read_gltf_file
from zoomout_core.mesh.formats.gltf_scene import read_scene
from zoomout_core.mesh.formats.meshio_files import ENDINGS as OF_MESHIO
from zoomout_core.mesh.formats.meshio_files import read_with_meshio
from zoomout_core.mesh.formats.obj_files import parse_obj
from zoomout_core.mesh.formats.opening import existing, explain_damage, file_bytes, name_file
from zoomout_core.mesh.formats.ply_files import PlyColumns, ply_columns, ply_normals, ply_polygons
from zoomout_core.mesh.formats.polygons import Faces, Polygons, join
from zoomout_core.mesh.formats.stl import complete_stl
from zoomout_core.mesh.formats.text_tables import flatten, number_table, text_lines, whole_number
from zoomout_core.mesh.formats.usd_files import ENDINGS as OF_USD
from zoomout_core.mesh.formats.usd_files import read_usd
from zoomout_core.mesh.formats.xml_instances import check_instances
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.point_cloud import PointCloud
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.extras import install_hint
from zoomout_core.runtime.input_files import FormatError, check_expansion
from zoomout_core.runtime.outputs import atomic_write

# Readers that need a package of the extra `formats`, by file extension.
OPTIONAL_READERS = dict.fromkeys(OF_USD, read_usd) | dict.fromkeys(OF_MESHIO, read_with_meshio)
# Formats that trimesh reads with packages of the extra `formats`, and all that it is asked to read.
WITH_EXTRA = frozenset({".dae", ".zae", ".3mf"})
OF_TRIMESH = WITH_EXTRA | {".3dxml", ".ctm", ".step", ".stl", ".stl_ascii", ".stp", ".xaml", ".xyz"}
# Zip archives of XML may expand less than other data, because XML takes 40 times its size in memory: to this many times
# the size of the file, or to the bytes in the second constant if that is more. Meshes expand 7 to 11 times.
ARCHIVES = frozenset({".3dxml", ".3mf", ".zae"})
XML_EXPANSION, XML_ALLOWED = 16, 1 << 23


def read_surface(path: str | PathLike[str]) -> Surface:
    """Read a mesh file; several objects in one file follow one another in a single surface.

    Args:
        path: an OFF, PLY, OBJ, STL, glTF or GLB file, or another format that trimesh knows; .blend and .fbx are read
            by Blender, see `blender_files`.

    Raises:
        MeshError: the file is missing, cannot be read, has no faces, or has invalid faces.
        TypeError: the path is neither a string nor a path.
        ImportError: trimesh is not installed, and the file is none of OFF, PLY, OBJ.

    Example:
        >>> notes = zo.write_asset(zo.Asset(source), folder / "creature.obj")
        >>> len(zo.read_surface(folder / "creature.obj").triangles) == len(source.triangles)
        True
    """
    return _with_faces(read_shape(path), path)


@memory_in_words
def read_shape(path: str | PathLike[str]) -> Surface | PointCloud:
    """Read a mesh file like `read_surface`, or like `read_point_cloud` if it has no faces.

    Faces at vertices whose coordinates are not numbers are left out. These vertices stay, so that all vertices keep
    their numbers; `match` has a note on them.

    Raises:
        MeshError: the file is missing, cannot be read, or has invalid points or faces.
        TypeError: the path is neither a string nor a path.
        ImportError: trimesh is not installed, and the file is none of OFF, PLY, OBJ.
    """
    polygons, vertex_columns = _read(path)
    with name_file(path):
        return _shape(drop_broken_faces(polygons)[0], vertex_columns, path)


def drop_broken_faces(polygons: Polygons) -> tuple[Polygons, Booleans]:
    """Drop polygons at vertices that are not numbers, unless that would be all of them.

    Returns:
        The polygons, and (f,) which of the f given ones these are.
    """
    vertices, corner_vertex, face_start = polygons
    broken = np.isnan(vertices).any(axis=1)
    sizes = np.diff(face_start)
    kept = np.ones(len(sizes), dtype=bool)
    if len(sizes) and broken.any() and (sizes > 0).all() and (corner_vertex < len(vertices)).all():
        kept = ~np.logical_or.reduceat(broken[corner_vertex], face_start[:-1])
    if kept.all() or not kept.any():
        return polygons, np.ones(len(sizes), dtype=bool)
    return (vertices, corner_vertex[np.repeat(kept, sizes)], np.concatenate([[0], np.cumsum(sizes[kept])])), kept


def surface_of(polygons: Polygons, vertex_columns: PlyColumns, path: str | PathLike[str]) -> Surface:
    """Make the surface of a file from its polygons, and the vertex columns of a PLY file.

    Raises:
        MeshError: it has no faces, or invalid points or faces.
    """
    return _with_faces(_shape(polygons, vertex_columns, path), path)


def _shape(polygons: Polygons, vertex_columns: PlyColumns, path: str | PathLike[str]) -> Surface | PointCloud:
    vertices, corner_vertex, face_start = polygons
    if not len(vertices):
        raise MeshError(f"{path} contains neither faces nor points: check that it is a mesh file.")
    try:
        if len(face_start) < 2:
            return PointCloud(vertices, ply_normals(vertex_columns))
        return Surface.from_corners(vertices, corner_vertex, face_start)
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from error


def _with_faces(shape: Surface | PointCloud, path: str | PathLike[str]) -> Surface:
    if isinstance(shape, PointCloud):
        raise MeshError(
            f"{path} contains no faces, only {len(shape.points)} points: give a file with a surface, or read it as a "
            "point cloud."
        )
    return shape


def read_point_cloud(path: str | PathLike[str]) -> PointCloud:
    """Read the points of a file with or without faces, and the normals of a PLY file.

    Raises:
        MeshError: the file is missing, cannot be read, or has invalid points.
        TypeError: the path is neither a string nor a path.
        ImportError: trimesh is not installed, and the file is none of OFF, PLY, OBJ.

    Example:
        >>> np.savetxt(folder / "scan.xyz", target.vertices)
        >>> len(zo.read_point_cloud(folder / "scan.xyz").points) == len(target.vertices)
        True
    """
    (vertices, _, _), vertex_columns = _read(path)
    try:
        return PointCloud(vertices, ply_normals(vertex_columns))
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from error


def read_polygons(path: str | PathLike[str]) -> Polygons:
    """The polygons of a mesh file, unchecked; raises as `read_shape`."""
    return _read(path)[0]


def _read(path: str | PathLike[str]) -> tuple[Polygons, PlyColumns]:
    """The polygons of `read_polygons`, and the vertex columns of a PLY file."""
    path = existing(path)
    readers = dict.fromkeys(OPTIONAL_READERS, _read_with_extra) | dict.fromkeys(OF_BLENDER, _read_with_blender)
    readers |= {
        ".off": _read_off,
        ".obj": lambda path: parse_obj(file_bytes(path)).polygons(),
        ".gltf": _read_gltf,
        ".glb": _read_gltf,
        ".vrm": _read_gltf,
        ".stl": lambda path: _read_with_trimesh(path, complete_stl(file_bytes(path))),
    }
    with explain_damage(path):
        if path.suffix.lower() == ".ply":
            columns = ply_columns(file_bytes(path))
            return ply_polygons(columns), columns["vertex"]
        return readers.get(path.suffix.lower(), _read_with_trimesh)(path), {}


# --- OFF ----------------------------------------------------------------------------------------------------


def _read_off(path: Path) -> Polygons:
    """Keyword and counts, then a line per vertex, then a line per face, where colours may follow."""
    lines = [line for line in (line.partition("#")[0].strip() for line in text_lines(file_bytes(path))) if line]
    keyword, *counts = lines[0].split() if lines else [""]
    if not keyword.endswith("OFF"):
        raise FormatError("it does not begin with OFF")
    lines[:1] = [" ".join(counts)] if counts else []  # the counts may follow the keyword on its line
    declared = [whole_number(word) for word in " ".join(lines[:1]).split()[:2]]
    if len(declared) < 2 or min(declared) < 0:
        raise FormatError("it does not declare its numbers of vertices and faces")
    vertex_count, face_count = declared
    vertex_lines = lines[1 : vertex_count + 1]
    face_lines = lines[vertex_count + 1 : vertex_count + face_count + 1]
    if len(vertex_lines) < vertex_count or len(face_lines) < face_count:
        raise FormatError("it ends too early")
    sizes = number_table(face_lines, [0], np.int64)[:, 0]
    words = np.array([len(line.split()) for line in face_lines])
    wrong = np.flatnonzero((sizes < 0) | (sizes >= words))
    if len(wrong):
        face = wrong[0]
        raise FormatError(f"face {face} should have {sizes[face]} vertices, but its line has {words[face] - 1} numbers")
    if len(np.unique(sizes)) == 1:
        same_size = number_table(face_lines, range(1, sizes[0] + 1), np.int64)
        return number_table(vertex_lines, [0, 1, 2]), *flatten(same_size)
    polygons = [line.split()[1 : size + 1] for line, size in zip(face_lines, sizes, strict=True)]
    corners = [[whole_number(word) for word in polygon] for polygon in polygons]
    return number_table(vertex_lines, [0, 1, 2]), *flatten(corners)


def write_shape(shape: Surface | PointCloud, path: str | PathLike[str]) -> None:
    """Write a surface, or a point cloud with its normals, to a PLY file, atomically and in full precision.

    Raises:
        OutputError: it cannot be written.
    """
    points = shape.points if isinstance(shape, PointCloud) else shape.vertices
    normals = shape.normals if isinstance(shape, PointCloud) else None
    columns = points if normals is None else np.hstack([points, normals])
    names = ("x", "y", "z", "nx", "ny", "nz")[: columns.shape[1]]
    faces = [] if isinstance(shape, PointCloud) else np.split(shape.corner_vertex, shape.face_start[1:-1])
    header = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    header += [f"property double {name}" for name in names]
    if not isinstance(shape, PointCloud):
        header += [f"element face {len(faces)}", "property list int int vertex_indices"]
    rows = [" ".join(map(repr, row)) for row in columns.tolist()]
    rows += [" ".join(map(str, (len(face), *face.tolist()))) for face in faces]
    with atomic_write(path) as part:
        part.write_text("\n".join([*header, "end_header", *rows, ""]), encoding="ascii")


# --- everything else ----------------------------------------------------------------------------------------


def _read_with_blender(path: Path) -> Polygons:
    """The triangles of all visible meshes of a file, without their modifiers."""
    with TemporaryDirectory(prefix="zoomout-") as folder:
        surface = Path(folder) / "surface.ply"
        write_surface(path, surface)
        return ply_polygons(ply_columns(surface.read_bytes()))


def _read_with_extra(path: Path) -> Polygons:
    """The faces of a file of another program's format."""
    try:
        return OPTIONAL_READERS[path.suffix.lower()](path)
    except ImportError as error:
        raise ImportError(
            f"{path} requires the package {error.name}, which is not installed: {install_hint('formats')}, "
            "or convert the file to OFF, PLY, OBJ, STL, glTF or GLB."
        ) from error


def _read_gltf(path: Path) -> Polygons:
    """The posed shape of a file, whose vertices have the same numbers as in its asset."""
    scene = read_scene(path)
    if scene is None:
        return _read_gltf_points(path)
    return scene.surface.vertices, scene.surface.corner_vertex, scene.surface.face_start


def _read_gltf_points(path: Path) -> Polygons:
    """The points of a file without triangles."""
    file = read_gltf_file(path)
    buffers = {f"buffer {number}": content for number, content in enumerate(file.buffers)}
    unread = ("images", "materials", "samplers", "textures")
    tree = {name: each for name, each in file.tree.items() if name not in unread}
    tree["asset"] = {"version": "2.0"}
    tree["buffers"] = [{"uri": name, "byteLength": len(content)} for name, content in buffers.items()]
    shape = ("attributes", "indices", "mode", "targets")
    tree["meshes"] = [
        {**mesh, "primitives": [{name: each[name] for name in shape if name in each} for each in mesh["primitives"]]}
        for mesh in file.tree.get("meshes") or []
    ]
    return _read_with_trimesh(path, json.dumps(tree).encode(), ".gltf", buffers)


def _read_with_trimesh(
    path: Path, content: bytes | None = None, ending: str | None = None, files: dict[str, bytes] | None = None
) -> Polygons:
    """The triangles of all meshes and point sets in a file, in file order, transformed as in its scene.

    Args:
        path: the file.
        content: its content, if it was read already.
        ending: the file extension of its format.
        files: contents of the files that it names, and that are needed; it reads no others.
    """
    ending = ending or path.suffix.lower()
    unsupported = MeshError(f"The format of {path} is not supported: convert it to OFF, PLY, OBJ, STL, glTF or GLB.")
    if files is None and ending not in OF_TRIMESH:
        raise unsupported
    try:
        import trimesh
    except ImportError as error:
        raise ImportError(f"Reading mesh files needs trimesh: {install_hint('cli')}.") from error
    content = file_bytes(path) if content is None else content
    if ending in ARCHIVES:
        with ZipFile(BytesIO(content)) as archive:
            check_expansion(archive, expansion=XML_EXPANSION, allowed=XML_ALLOWED)
            for name in archive.namelist():
                if name.lower().endswith((".model", ".dae")):
                    check_instances(archive.read(name))
    elif ending == ".dae":
        check_instances(content)
    try:
        scene = trimesh.load_scene(BytesIO(content), file_type=ending[1:], resolver=files or {}, process=False)
    except NotImplementedError as error:
        raise unsupported from error
    except ImportError as error:
        how = "convert it to OFF, PLY, OBJ, STL, glTF or GLB"
        if path.suffix.lower() in WITH_EXTRA:
            how = f"{install_hint('formats')}, or {how}"
        raise ImportError(f"Reading {path} requires a package that is not installed: {how}.") from error
    return polygons_of_scene(scene)


def polygons_of_scene(scene: Any) -> Polygons:
    """The triangles of all meshes and point sets of a `trimesh.Scene`, transformed as in it."""
    return join(_parts(scene))


def _parts(scene: Any) -> Iterator[Faces]:
    """The triangles of each mesh or point set, in the order of the file."""
    for name, geometry in scene.geometry.items():
        points = np.asarray(getattr(geometry, "vertices", ()), dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            continue  # voxels, or a planar drawing
        triangles = np.asarray(getattr(geometry, "faces", ()), dtype=np.int64).reshape(-1, 3)
        for node in scene.graph.geometry_nodes[name]:
            transform = scene.graph[node][0]
            mirrored = np.linalg.det(transform[:3, :3]) < 0
            corners = (triangles[:, [0, 2, 1]] if mirrored else triangles).ravel()
            yield points @ transform[:3, :3].T + transform[:3, 3], corners, np.full(len(triangles), 3)
