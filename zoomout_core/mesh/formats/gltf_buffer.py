# SPDX-License-Identifier: GPL-3.0-or-later
"""The buffer of a glTF document that is written."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zoomout_core.mesh.errors import MeshError

if TYPE_CHECKING:
    from pygltflib import GLTF2, Accessor
from zoomout_core.mesh.formats.gltf_document import library
from zoomout_core.mesh.formats.gltf_tables import COMPONENT_TYPES, TYPES

# glTF's codes for buffers of vertices and of indices.
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


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

        Raises:
            MeshError: bounded values are infinite, or too large for single floats.
        """
        rows = values.reshape(len(values), -1)
        if bounded and not np.isfinite(rows).all():
            raise MeshError(
                "Some coordinates or times are infinite, or too large for the single floats of glTF: check that no "
                "node of the source has a scale of zero, or scale the meshes down."
            )
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
