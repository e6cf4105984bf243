# SPDX-License-Identifier: GPL-3.0-or-later
"""glTF documents from pygltflib: read their buffers, accessors and nodes as arrays, and write new ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.surface import MeshError
from zoomout_core.runtime.extras import install_hint

if TYPE_CHECKING:
    from pygltflib import GLTF2, Accessor

COMPONENT_TYPES = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
# glTF's codes for buffers of vertices and of indices.
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
COMPRESSED = {"KHR_draco_mesh_compression": "Draco", "EXT_meshopt_compression": "meshopt"}


def library() -> Any:
    """The package that reads and writes the format.

    Raises:
        ImportError: it is not installed.
    """
    try:
        import pygltflib
    except ImportError as error:
        raise ImportError(f"Skins and materials of glTF need pygltflib: {install_hint('cli')}.") from error
    return pygltflib


class Document:
    """A glTF or GLB file with its buffers read.

    Args:
        path: path of the file.

    Raises:
        MeshError: it cannot be read, or its meshes are compressed.
        ImportError: pygltflib is not installed.
    """

    def __init__(self, path: Path) -> None:
        reading = library().GLTF2
        try:
            self.gltf: GLTF2 = reading().load(str(path))
            self.folder = path.parent
            self._buffers = [self._buffer(number) for number in range(len(self.gltf.buffers))]
        except Exception as error:  # pygltflib raises various errors on a broken file
            reason = " ".join(str(error).split())
            raise MeshError(
                f"{path} could not be read ({reason}): check that the file is complete and has the right extension."
            ) from error
        for extension in self.gltf.extensionsRequired:
            if extension in COMPRESSED:
                raise MeshError(f"{path} is compressed by {COMPRESSED[extension]}: export it without compression.")

    @classmethod
    def from_gltf(cls, gltf: GLTF2) -> Document:
        """Make a document from a glTF object in memory, with one buffer."""
        document = cls.__new__(cls)
        document.gltf, document.folder = gltf, Path()
        document._buffers = [bytes(gltf.binary_blob())]
        return document

    def _buffer(self, number: int) -> bytes:
        uri = self.gltf.buffers[number].uri
        return bytes(self.gltf.binary_blob()) if uri is None else self.read_uri(uri)

    def read_uri(self, uri: str) -> bytes:
        """Read the bytes of a URI: embedded data, or a file beside the document."""
        if uri.startswith("data:"):
            return bytes(self.gltf.decode_data_uri(uri))
        from urllib.parse import unquote

        return (self.folder / unquote(uri)).read_bytes()

    def image(self, number: int | None) -> bytes | None:
        """File content of an image; None without a number, or if an extension stores it."""
        image = None if number is None else self.gltf.images[number]
        if image is None or (image.bufferView is None and image.uri is None):
            return None
        return self.read_uri(image.uri) if image.bufferView is None else self.view(image.bufferView)

    def view(self, number: int) -> bytes:
        """The bytes of a buffer view."""
        view = self.gltf.bufferViews[number]
        start = view.byteOffset or 0
        return self._buffers[view.buffer][start : start + view.byteLength]

    def array(self, number: int) -> NDArray[Any]:
        """(count, width) values of an accessor; normalised integers become fractions."""
        accessor = self.gltf.accessors[number]
        dtype, width = np.dtype("<" + COMPONENT_TYPES[accessor.componentType]), WIDTHS[accessor.type]
        values = np.zeros((accessor.count, width), dtype)
        if accessor.bufferView is not None:
            stride = self.gltf.bufferViews[accessor.bufferView].byteStride or dtype.itemsize * width
            content, start = self.view(accessor.bufferView), accessor.byteOffset or 0
            if len(content) < start + stride * (accessor.count - 1) + dtype.itemsize * width:
                raise MeshError("A buffer of the file ends too early: check that the file is complete.")
            values = np.ndarray((accessor.count, width), dtype, content, start, (stride, dtype.itemsize)).copy()
        if accessor.sparse is not None:
            indices, changed = accessor.sparse.indices, accessor.sparse.values
            of_index = np.dtype("<" + COMPONENT_TYPES[indices.componentType])
            at = np.frombuffer(self.view(indices.bufferView), of_index, accessor.sparse.count, indices.byteOffset or 0)
            flat = np.frombuffer(self.view(changed.bufferView), dtype, len(at) * width, changed.byteOffset or 0)
            values[at] = flat.reshape(-1, width)
        if accessor.normalized and dtype.kind in "iu":
            return np.maximum(values / np.iinfo(dtype).max, -1)
        return values

    def matrices(self, number: int) -> Floats:
        """(count, 4, 4) matrices of an accessor, which are stored column by column."""
        return np.asarray(self.array(number).reshape(-1, 4, 4).transpose(0, 2, 1), dtype=np.float64)

    def worlds(self) -> tuple[Floats, Integers]:
        """(nodes, 4, 4) world transforms of the nodes, and (nodes,) the parent of each, -1 for none."""
        nodes = self.gltf.nodes
        parent = np.full(len(nodes), -1)
        for number, node in enumerate(nodes):
            parent[node.children or []] = number
        worlds = np.tile(np.eye(4), (len(nodes), 1, 1))
        for number in self.in_order(parent):
            own = local_matrix(nodes[number])
            worlds[number] = own if parent[number] < 0 else worlds[parent[number]] @ own
        return worlds, parent

    def in_order(self, parent: Integers) -> Iterator[int]:
        """The nodes, each after its parent."""
        waiting = [number for number in range(len(parent) - 1, -1, -1) if parent[number] < 0]
        while waiting:
            number = waiting.pop()
            yield number
            waiting.extend(reversed(self.gltf.nodes[number].children or []))


def local_matrix(node: Any) -> Floats:
    """(4, 4) transform of a node relative to its parent."""
    if node.matrix is not None:
        return np.asarray(node.matrix, dtype=np.float64).reshape(4, 4).T
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(node.rotation or [0, 0, 0, 1]).as_matrix() * (node.scale or [1, 1, 1])
    matrix[:3, 3] = node.translation or [0, 0, 0]
    return matrix


class Buffer:
    """The single buffer of a written document.

    Args:
        gltf: the document; its buffer views are rebuilt.
    """

    def __init__(self, gltf: GLTF2) -> None:
        self.gltf = gltf
        self.content = bytearray()
        gltf.bufferViews, gltf.buffers = [], []

    def add_view(self, content: bytes, target: int | None = None) -> int:
        """Add bytes; returns the number of their view."""
        self.content += bytes(-len(self.content) % 4)
        view = library().BufferView(buffer=0, byteOffset=len(self.content), byteLength=len(content), target=target)
        self.content += content
        self.gltf.bufferViews.append(view)
        return len(self.gltf.bufferViews) - 1

    def add(self, values: NDArray[Any], target: int | None = None, bounded: bool = False) -> int:
        """Add values (count, width), or (count,) numbers; returns the number of their accessor.

        Args:
            values: values of a type that glTF supports.
            target: the use of the buffer.
            bounded: whether to store the minimum and maximum of each column.
        """
        rows = values.reshape(len(values), -1)
        code = next(code for code, letters in COMPONENT_TYPES.items() if values.dtype == np.dtype("<" + letters))
        width = rows.dtype.itemsize * rows.shape[1]
        padding = np.zeros((len(rows), -width % 4 if target == ARRAY_BUFFER else 0), np.uint8)
        content = np.hstack([np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1), padding])
        number = self.add_view(content.tobytes(), target)
        if target == ARRAY_BUFFER:
            self.gltf.bufferViews[number].byteStride = content.shape[1]
        accessor: Accessor = library().Accessor(
            bufferView=number, byteOffset=0, componentType=code, count=len(rows), type=TYPES[rows.shape[1]]
        )
        if bounded:
            accessor.min, accessor.max = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
        self.gltf.accessors.append(accessor)
        return len(self.gltf.accessors) - 1

    def finish(self) -> None:
        """Add the buffer to the document."""
        self.content += bytes(-len(self.content) % 4)
        self.gltf.buffers = [library().Buffer(byteLength=len(self.content))]
        self.gltf.set_binary_blob(bytes(self.content))
