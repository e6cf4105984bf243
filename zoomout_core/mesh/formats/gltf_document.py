# SPDX-License-Identifier: GPL-3.0-or-later
"""glTF documents from pygltflib: read their buffers, accessors and nodes as arrays, and write new ones."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.formats.gltf_files import GltfFile, data_of, read_gltf_file
from zoomout_core.mesh.formats.gltf_tables import COMPONENT_TYPES, FLOATS, TYPES, WIDTHS
from zoomout_core.mesh.formats.image_types import TEXTURE_EXTENSIONS, image_type
from zoomout_core.mesh.formats.opening import shown
from zoomout_core.runtime.extras import install_hint
from zoomout_core.runtime.input_files import FormatError, OutsideError, reason_of

if TYPE_CHECKING:
    from pygltflib import GLTF2, Mesh, Texture

# The attribute of vertices, and the name in the free data of the document, that store the map of an asset.
PLACE, STORED_MAP = "_ZOOMOUT_PLACE", "zoomout_map"
# Extensions of glTF for copies of a mesh, for materials to choose from, and for animations of any value.
INSTANCES, VARIANTS, POINTER = "EXT_mesh_gpu_instancing", "KHR_materials_variants", "KHR_animation_pointer"
# The extensions of VRM 0 and 1 for avatars.
VRM_0, VRM_1 = "VRM", "VRMC_vrm"


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


def free_name(name: str, taken: Collection[str | None]) -> str:
    """A name that is not taken: the given one, or the same with the lowest number that makes it free."""
    found, copy = name, 1
    while found in taken:
        copy += 1
        found = f"{name} {copy}"
    return found


class Document:
    """A glTF or GLB file with its buffers read.

    Args:
        path: path of the file.
        folders: further folders in which its buffers and images may be.

    Attributes:
        gltf: its content.
        notes: sentences about images that could not be read.

    Raises:
        MeshError: it cannot be read, or its meshes are compressed.
        ImportError: pygltflib is not installed.
    """

    def __init__(self, path: Path, folders: Iterable[Path] = ()) -> None:
        library()  # before a large file is read
        self._file: GltfFile | None = read_gltf_file(path, folders)
        self.gltf: GLTF2 = _gltf_of(self._file.tree)
        self.notes: list[str] = []
        self._buffers, self._images = self._file.buffers, dict[int, bytes | None]()

    @classmethod
    def from_gltf(cls, gltf: GLTF2) -> Document:
        """Make a document from a glTF object in memory, with one buffer."""
        document = cls.__new__(cls)
        document.gltf, document._file, document.notes = gltf, None, []
        document._buffers, document._images = (bytes(gltf.binary_blob()),), {}
        return document

    @classmethod
    def from_tree(cls, tree: dict[str, Any], content: bytes) -> Document:
        """Make a document from JSON and the content of its only buffer."""
        gltf = _gltf_of(tree)
        gltf.set_binary_blob(content)
        return cls.from_gltf(gltf)

    def copy(self) -> Document:
        """A copy that shares the buffers; changes to its nodes and animations do not change this document."""
        document = Document.__new__(Document)
        document.gltf, document._file, document.notes = deepcopy(self.gltf), self._file, list(self.notes)
        document._buffers, document._images = self._buffers, self._images
        return document

    def add_array(self, values: NDArray[Any]) -> int:
        """Add values (count, width) of single floats; returns the number of their accessor."""
        gltf, content = library(), np.ascontiguousarray(values, "<f4").tobytes()
        self._buffers = (*self._buffers, content)
        self.gltf.buffers.append(gltf.Buffer(byteLength=len(content)))
        self.gltf.bufferViews.append(
            gltf.BufferView(buffer=len(self._buffers) - 1, byteOffset=0, byteLength=len(content))
        )
        self.gltf.accessors.append(
            gltf.Accessor(
                bufferView=len(self.gltf.bufferViews) - 1,
                byteOffset=0,
                componentType=FLOATS,
                count=len(values),
                type=TYPES[values.shape[1]],
            )
        )
        return len(self.gltf.accessors) - 1

    @property
    def has_buffer_files(self) -> bool:
        """Whether a buffer of it is in a file of its own."""
        return any(is_file(buffer.uri) for buffer in self.gltf.buffers)

    @property
    def tree(self) -> dict[str, Any]:
        """A copy of its JSON; that of a file as it was read, without later changes of `gltf`."""
        tree: dict[str, Any] = json.loads(self.gltf.to_json()) if self._file is None else deepcopy(self._file.tree)
        return tree

    @property
    def buffers(self) -> tuple[bytes, ...]:
        """The content of its buffers."""
        return self._buffers

    def node_weights(self, number: int) -> list[float] | None:
        """The weights that a node gives to its morph targets, which pygltflib does not read; None without any."""
        tree = {} if self._file is None else self._file.tree
        return tree["nodes"][number].get("weights") if number < len(tree.get("nodes", ())) else None

    def image(self, number: int) -> bytes | None:
        """File content of an image; None, with a note, if it cannot be read or is not an image."""
        if number not in self._images:
            self._images[number] = None
            try:
                content = self._image(number)
                if image_type(content) is None:
                    raise FormatError("it is not an image of a known type")
                self._images[number] = content
            except OutsideError:
                self._note(number, "is outside the folder of the file")
            except OSError as error:
                self._note(number, f"could not be opened ({error.strerror})")
            except ValueError as error:
                self._note(number, f"could not be read ({reason_of(error)})")
        return self._images[number]

    def _image(self, number: int) -> bytes:
        image = self.gltf.images[number]
        if image.bufferView is not None:
            return self.view(image.bufferView)
        if image.uri is None:
            raise FormatError("it has neither a file nor a buffer")
        if self._file is None:
            return data_of(image.uri)
        return self._file.read_uri(image.uri)

    def _note(self, number: int, why: str) -> None:
        image = self.gltf.images[number]
        name = shown(image.uri if is_file(image.uri) else image.name or f"image {number}")
        self.notes.append(f"The image {name} {why}, and was left out.")

    def image_of(self, texture: int) -> bytes | None:
        """File content of a texture's image: the one that all programs read, if there are several."""
        for number in sources_of(self.gltf.textures[texture]).values():
            content = self.image(number)
            if content is not None:
                return content
        return None

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
        """The numbers of nodes with parents (n,), each after its parent. No node has two: the file was checked."""
        waiting = [number for number in range(len(parent) - 1, -1, -1) if parent[number] < 0]
        while waiting:
            number = waiting.pop()
            yield number
            waiting.extend(reversed(self.gltf.nodes[number].children or []))


def _gltf_of(tree: dict[str, Any]) -> GLTF2:
    """The object of pygltflib for JSON."""
    return library().GLTF2.from_json(json.dumps(tree), infer_missing=True, object_hook=_with_free_objects)


def _with_free_objects(part: dict[str, Any]) -> dict[str, Any]:
    """A part of a document without free data that pygltflib rejects, because they are not objects."""
    return {name: value for name, value in part.items() if name != "extras" or isinstance(value, dict)}


def morph_target_names(mesh: Mesh) -> tuple[str, ...]:
    """The names of a mesh's morph targets, made distinct; from its free data, or in VRM 0 that of a primitive."""
    count = max((len(each.targets or []) for each in mesh.primitives), default=0)
    given = next(filter(None, (_names_of(each.extras) for each in (mesh, *mesh.primitives))), [])[:count]
    names: dict[str, None] = {}
    for number in range(count):
        name = wanted = given[number] if number < len(given) else f"Target {number + 1}"
        copy = 1
        while name in names:
            copy += 1
            name = f"{wanted} {copy}"
        names[name] = None
    return tuple(names)


def _names_of(extras: Any) -> list[str]:
    """The names of morph targets in free data, which may be of any type."""
    names = extras.get("targetNames") if isinstance(extras, dict) else None
    return [str(name) for name in names] if isinstance(names, list) else []


def is_file(uri: str | None) -> bool:
    """Whether a URI refers to a file, rather than containing the data."""
    return uri is not None and not uri.startswith("data:")


def sources_of(texture: Texture) -> dict[str, int]:
    """The images of a texture by the extension that refers to each, "" for glTF itself, which comes first."""
    found = {} if texture.source is None else {"": texture.source}
    extensions = texture.extensions or {}
    return found | {
        name: extensions[name]["source"] for name in TEXTURE_EXTENSIONS if "source" in (extensions.get(name) or {})
    }


def local_matrix(node: Any) -> Floats:
    """(4, 4) transform of a node relative to its parent."""
    if node.matrix is not None:
        return np.asarray(node.matrix, dtype=np.float64).reshape(4, 4).T
    from scipy.spatial.transform import Rotation

    if node.rotation and not any(node.rotation):
        raise FormatError("the rotation of a node is 0, 0, 0, 0")
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(node.rotation or [0, 0, 0, 1]).as_matrix() * (node.scale or [1, 1, 1])
    matrix[:3, 3] = node.translation or [0, 0, 0]
    return matrix
