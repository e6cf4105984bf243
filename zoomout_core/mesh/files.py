"""Mesh files: surfaces and point clouds from OFF, PLY, OBJ, STL, glTF and whatever else trimesh reads.

Vertices keep their number and order, since landmarks and maps name them by number. The formats that hold
polygons are read here: trimesh splits the vertices of OBJ wherever texture coordinates or normals part and
regroups them by material, takes all faces of a binary PLY to be as large as the first, and refuses OFF with
faces of several sizes. The others are left to it, and it keeps vertices when told not to process them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.blender_files import ENDINGS as OF_BLENDER
from zoomout_core.mesh.blender_files import write_surface
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.more_files import READERS as MORE_READERS
from zoomout_core.mesh.surface import MeshError, PointCloud, Surface
from zoomout_core.runtime.outputs import written_whole

# What trimesh reads with packages of the extra `formats`.
WITH_EXTRA = frozenset({".dae", ".zae", ".3mf"})
# Positions (n, 3), the vertex of each corner (c,), and the first corner of each face (f + 1,).
Polygons = tuple[Floats, Integers, Integers]


def read_surface(path: str | PathLike[str]) -> Surface:
    """Read a mesh file; several objects in one file follow one another in a single surface.

    Args:
        path: an OFF, PLY, OBJ, STL, glTF or GLB file, or another format that trimesh knows; .blend and .fbx are read
            by Blender, see `blender_files`.

    Raises:
        MeshError: the file is missing, cannot be read, holds no faces, or holds faces that cannot be used.
        TypeError: the path is neither a string nor a path.
        ImportError: trimesh is not installed, and the file is none of OFF, PLY, OBJ.

    Example:
        >>> notes = zo.write_asset(zo.Asset(source), folder / "creature.obj")
        >>> len(zo.read_surface(folder / "creature.obj").triangles) == len(source.triangles)
        True
    """
    shape = read_shape(path)
    if isinstance(shape, PointCloud):
        raise MeshError(
            f"{path} holds no faces, only {len(shape.points)} points: give a file with a surface, "
            "or read it as a point cloud."
        )
    return shape


@memory_in_words
def read_shape(path: str | PathLike[str]) -> Surface | PointCloud:
    """Read a mesh file as `read_surface` does, or as `read_point_cloud` does where it holds no faces.

    Raises:
        MeshError: the file is missing, cannot be read, or holds points or faces that cannot be used.
        TypeError: the path is neither a string nor a path.
        ImportError: trimesh is not installed, and the file is none of OFF, PLY, OBJ.
    """
    vertices, corner_vertex, face_start = read_polygons(path)
    try:
        if len(face_start) < 2:
            return PointCloud(vertices, _normals(Path(path)))
        return Surface.from_corners(vertices, corner_vertex, face_start)
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from error


def read_point_cloud(path: str | PathLike[str]) -> PointCloud:
    """Read the points of a file, whether it holds faces or not, and the normals of a PLY file.

    Raises:
        MeshError: the file is missing, cannot be read, or holds points that cannot be used.
        TypeError: the path is neither a string nor a path.
        ImportError: trimesh is not installed, and the file is none of OFF, PLY, OBJ.

    Example:
        >>> np.savetxt(folder / "scan.xyz", target.vertices)
        >>> len(zo.read_point_cloud(folder / "scan.xyz").points) == len(target.vertices)
        True
    """
    vertices = read_polygons(path)[0]
    try:
        return PointCloud(vertices, _normals(Path(path)))
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from error


def existing(path: str | PathLike[str]) -> Path:
    """The path of a file that is there, else a MeshError."""
    if not isinstance(path, str | PathLike):
        raise TypeError(f"A file is named by a string or a path, not by a {type(path).__name__}.")
    path = Path(path)
    if not path.is_file():
        raise MeshError(f"There is no file {path}: check the path.")
    return path


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise MeshError(f"{path} could not be opened ({error.strerror}): check who may read it.") from error


def _text(content: bytes) -> str:
    # Names and comments may be in any encoding; only numbers and keywords are of interest.
    return content.decode("utf-8-sig", errors="replace").replace("\r\n", "\n")


def read_polygons(path: str | PathLike[str]) -> Polygons:
    """The polygons of a mesh file as they stand there, not yet checked.

    Returns:
        (n, 3) positions, (c,) the vertex of each corner, and (f + 1,) the first corner of each face.

    Raises:
        MeshError: the file is missing, or cannot be read.
        TypeError: the path is neither a string nor a path.
        ImportError: trimesh is not installed, and the file is none of OFF, PLY, OBJ.
    """
    path = existing(path)
    readers = dict.fromkeys(MORE_READERS, _read_with_extra) | dict.fromkeys(OF_BLENDER, _read_with_blender)
    readers |= {".off": _read_off, ".ply": _read_ply, ".obj": _read_obj}
    try:
        return readers.get(path.suffix.lower(), _read_with_trimesh)(path)
    except (MeshError, ImportError):
        raise
    except Exception as error:  # what a reader raises on a broken file depends on where it stumbles
        reason = " ".join(str(error).split())
        raise MeshError(f"{path} could not be read ({reason}): is it complete, and is its ending right?") from error


# --- OFF ----------------------------------------------------------------------------------------------------


def _read_off(path: Path) -> Polygons:
    """After keyword and counts a line a vertex, then a line a face; colours and the like may follow."""
    text = _text(_bytes(path))
    lines = [line for line in (line.partition("#")[0].strip() for line in text.splitlines()) if line]
    keyword, *counts = lines[0].split() if lines else [""]
    if not keyword.endswith("OFF"):
        raise ValueError("it does not begin with OFF")
    lines[:1] = [" ".join(counts)] if counts else []  # the counts may stand beside the keyword
    vertex_count, face_count = (int(word) for word in lines[0].split()[:2])
    vertex_lines = lines[1 : vertex_count + 1]
    face_lines = lines[vertex_count + 1 : vertex_count + face_count + 1]
    if len(face_lines) < face_count:
        raise ValueError("it ends too early")
    sizes = _table(face_lines, [0], np.int64)[:, 0]
    words = np.array([len(line.split()) for line in face_lines])
    wrong = np.flatnonzero((sizes < 0) | (sizes >= words))
    if len(wrong):
        face = wrong[0]
        raise ValueError(f"face {face} states {sizes[face]} vertices, and its line has {words[face] - 1} numbers")
    if len(np.unique(sizes)) == 1:
        return _table(vertex_lines, [0, 1, 2]), *_flat(_table(face_lines, range(1, sizes[0] + 1), np.int64))
    polygons = [line.split()[1 : size + 1] for line, size in zip(face_lines, sizes, strict=True)]
    return _table(vertex_lines, [0, 1, 2]), *_flat([[int(word) for word in polygon] for polygon in polygons])


def _table(lines: list[str], columns: Sequence[int], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """(len(lines), len(columns)) numbers."""
    if not lines:
        return np.zeros((0, len(columns)), dtype)
    table = np.loadtxt(lines, usecols=columns, ndmin=2)
    found = table.astype(dtype)
    if (found != table).any() and np.issubdtype(dtype, np.integer):
        raise ValueError(f"{table[found != table][0]} stands where a whole number should")
    return found


def _flat(polygons: Any) -> tuple[Integers, Integers]:
    """The corners (c,) and face starts (f + 1,) of polygons."""
    sizes = [len(polygon) for polygon in polygons]
    return np.concatenate([[], *polygons]).astype(np.int64), np.cumsum([0, *sizes])


# --- OBJ ----------------------------------------------------------------------------------------------------


def _read_obj(path: Path) -> Polygons:
    positions: list[str] = []
    polygons: list[list[int]] = []
    for line in _text(_bytes(path)).replace("\\\n", " ").splitlines():
        keyword = line.lstrip()[:2].rstrip()
        if keyword == "v":
            positions.append(line)
        elif keyword == "f":
            polygons.append([_vertex_number(corner, len(positions)) for corner in line.split()[1:]])
    return _table(positions, [1, 2, 3]), *_flat(polygons)


def _vertex_number(corner: str, known: int) -> int:
    """The vertex of a face corner `v/vt/vn`: counted from 1, or backwards from the last one so far."""
    number = int(corner.partition("/")[0])
    if number == 0:
        raise ValueError("a face names vertex 0, and vertices are counted from 1")
    return number - 1 if number > 0 else known + number


# --- PLY ----------------------------------------------------------------------------------------------------

# Names of types in PLY headers, and numpy's.
PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}


@dataclass(frozen=True)
class _Property:
    """A column of a PLY element; of a list, `size_type` is the type of the length that precedes it."""

    name: str
    type: np.dtype[Any]
    size_type: np.dtype[Any] | None


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def _read_ply(path: Path) -> Polygons:
    columns = ply_columns(_bytes(path))
    vertices = np.stack([np.array(columns["vertex"][axis], dtype=np.float64) for axis in "xyz"], axis=1)
    face = columns.get("face", {})
    return vertices, *_flat(face.get("vertex_indices", face.get("vertex_index", [])))


def _normals(path: Path) -> Floats | None:
    """(n, 3) normals, where a PLY file has one for each vertex."""
    columns = ply_columns(_bytes(path))["vertex"] if path.suffix.lower() == ".ply" else {}
    if not {"nx", "ny", "nz"} <= columns.keys():
        return None
    return np.stack([np.array(columns[axis], dtype=np.float64) for axis in ("nx", "ny", "nz")], axis=1)


def ply_columns(content: bytes) -> dict[str, dict[str, Any]]:
    """The content of a PLY file, by element and property.

    Returns:
        Arrays (count,), or (count, k) for lists of one size; for lists of several sizes a list of arrays.

    Raises:
        ValueError: it is not PLY, or incomplete; a KeyError or a StopIteration where its header is broken.
    """
    end = content.find(b"end_header")
    if not content.startswith(b"ply") or end < 0:
        raise ValueError("it has no PLY header")
    header = [line.split() for line in _text(content[:end]).splitlines()]
    body = content[content.index(b"\n", end) + 1 :]
    encoding = next(words[1] for words in header if words[:1] == ["format"])
    if encoding == "ascii":
        body = np.array(body.split(), dtype=np.float64).tobytes()  # from here on a binary file of doubles
        types = {word: np.dtype(np.float64) for word in PLY_TYPES}
    else:
        order = ">" if encoding == "binary_big_endian" else "<"
        types = {word: np.dtype(order + code) for word, code in PLY_TYPES.items()}
    columns = {}
    for element in _ply_elements(header, types):
        columns[element.name], body = _element_columns(body, element)
    return columns


def _ply_elements(header: list[list[str]], types: dict[str, np.dtype[Any]]) -> list[_Element]:
    elements = []
    for words in header:
        if words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[:2] == ["property", "list"]:
            elements[-1].properties.append(_Property(words[4], types[words[3]], types[words[2]]))
        elif words[:1] == ["property"]:
            elements[-1].properties.append(_Property(words[2], types[words[1]], None))
    return elements


def _element_columns(body: bytes, element: _Element) -> tuple[dict[str, Any], bytes]:
    """The columns of an element, arrays (count, ...) or lists of arrays of any size; and what follows it."""
    if element.count == 0:
        return {column.name: np.zeros(0) for column in element.properties}, body
    first, _ = _ply_row(body, 0, element.properties)
    fields: list[Any] = []
    for column in element.properties:
        if column.size_type is not None:
            fields.append((column.name + " size", column.size_type))
        fields.append((column.name, column.type, first[column.name].shape))
    row = np.dtype(fields)
    if len(body) >= element.count * row.itemsize:
        table = np.frombuffer(body, row, element.count)
        lists = [column.name for column in element.properties if column.size_type is not None]
        if all((table[name + " size"] == len(first[name])).all() for name in lists):
            columns = {column.name: table[column.name] for column in element.properties}
            return columns, body[element.count * row.itemsize :]
    offset, rows = 0, []
    for _ in range(element.count):
        values, offset = _ply_row(body, offset, element.properties)
        rows.append(values)
    return {column.name: [values[column.name] for values in rows] for column in element.properties}, body[offset:]


def _ply_row(body: bytes, offset: int, properties: list[_Property]) -> tuple[dict[str, Any], int]:
    """The values of the row that begins at an offset, and the offset of the next."""
    values: dict[str, Any] = {}
    for column in properties:
        size = None
        if column.size_type is not None:
            size = int(np.frombuffer(body, column.size_type, 1, offset)[0])
            offset += column.size_type.itemsize
        flat = np.frombuffer(body, column.type, 1 if size is None else size, offset) if size != 0 else np.zeros(0)
        values[column.name] = flat[0] if size is None else flat
        offset += len(flat) * column.type.itemsize
    return values, offset


def write_shape(shape: Surface | PointCloud, path: str | PathLike[str]) -> None:
    """Write a surface or a point cloud with its normals to a PLY file, whole, with every digit.

    Raises:
        OutputError: it cannot be written.
    """
    points = shape.points if isinstance(shape, PointCloud) else shape.vertices
    normals = shape.normals if isinstance(shape, PointCloud) else None
    columns = points if normals is None else np.hstack([points, normals])
    names = ("x", "y", "z", "nx", "ny", "nz")[: columns.shape[1]]
    faces = [] if isinstance(shape, PointCloud) else np.split(shape.corner_vertex, shape.face_start[1:-1])
    header = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(points)}",
        *(f"property double {name}" for name in names),
    ]
    if not isinstance(shape, PointCloud):
        header += [f"element face {len(faces)}", "property list int int vertex_indices"]
    rows = [" ".join(map(repr, row)) for row in columns.tolist()]
    rows += [" ".join(map(str, (len(face), *face.tolist()))) for face in faces]
    with written_whole(path) as part:
        part.write_text("\n".join([*header, "end_header", *rows, ""]), encoding="ascii")


# --- everything else ----------------------------------------------------------------------------------------


def _read_with_blender(path: Path) -> Polygons:
    """The triangles of all meshes that are shown in a file, without what modifiers add to them."""
    with TemporaryDirectory(prefix="zoomout-") as folder:
        surface = Path(folder) / "surface.ply"
        write_surface(path, surface)
        return _read_ply(surface)


def _read_with_extra(path: Path) -> Polygons:
    """The faces of a file of another program's format."""
    try:
        vertices, corner_vertex, sizes = MORE_READERS[path.suffix.lower()](path)
    except ImportError as error:
        raise ImportError(
            f"{path} needs the package {error.name}, which is missing: pip install 'zoomout-core[formats]', or convert "
            "it to OFF, PLY, OBJ, STL, glTF or GLB."
        ) from error
    return vertices, corner_vertex, np.cumsum([0, *sizes.tolist()])


def _read_with_trimesh(path: Path) -> Polygons:
    """The triangles of all meshes and point sets in a file, in its order, placed as its scene says."""
    try:
        import trimesh
    except ImportError as error:
        raise ImportError("Reading mesh files needs trimesh: pip install 'zoomout-core[cli]'.") from error
    try:
        scene = trimesh.load_scene(str(path), process=False)
    except NotImplementedError as error:
        raise MeshError(f"{path} is of no known format: convert it to OFF, PLY, OBJ, STL, glTF or GLB.") from error
    except ImportError as error:
        how = "convert it to OFF, PLY, OBJ, STL, glTF or GLB"
        if path.suffix.lower() in WITH_EXTRA:
            how = f"pip install 'zoomout-core[formats]', or {how}"
        raise ImportError(f"{path} needs a package that is missing to be read: {how}.") from error
    vertices, triangles, count = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0
    for points, faces in _parts(scene):
        vertices.append(points)
        triangles.append(faces + count)
        count += len(points)
    corner_vertex = np.concatenate(triangles).ravel()
    return np.concatenate(vertices), corner_vertex, np.arange(0, len(corner_vertex) + 1, 3)


def _parts(scene: Any) -> Iterator[tuple[Floats, Integers]]:
    """Positions (n, 3) and triangles (m, 3) of each mesh or point set, in the order of the file."""
    for name, geometry in scene.geometry.items():
        points = np.asarray(getattr(geometry, "vertices", ()), dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            continue  # voxels, or a drawing in the plane
        triangles = np.asarray(getattr(geometry, "faces", ()), dtype=np.int64).reshape(-1, 3)
        for node in scene.graph.geometry_nodes[name]:
            transform = scene.graph[node][0]
            mirrored = np.linalg.det(transform[:3, :3]) < 0
            yield (
                points @ transform[:3, :3].T + transform[:3, 3],
                triangles[:, ::-1] if mirrored else triangles,
            )
