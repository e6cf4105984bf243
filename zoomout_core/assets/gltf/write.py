# SPDX-License-Identifier: GPL-3.0-or-later
"""Write assets as glTF, GLB and VRM files, with the nodes, animations, materials and extensions of their documents."""

from __future__ import annotations

import json
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from zoomout_core.assets.asset import Asset, one_line
from zoomout_core.assets.gltf.animations import keep_animations, keep_copies
from zoomout_core.assets.gltf.keep_avatars import keep_avatar
from zoomout_core.assets.gltf.materials import ImageFiles, full_look, write_materials
from zoomout_core.assets.gltf.meshes import write_meshes
from zoomout_core.mesh.formats.gltf_buffer import Buffer
from zoomout_core.mesh.formats.gltf_document import STORED_MAP, library
from zoomout_core.runtime.version import package_version

if TYPE_CHECKING:
    from pygltflib import GLTF2

# Extensions of files that are always binary.
BINARY = (".glb", ".vrm")


@np.errstate(over="ignore")  # what overflows is refused in a sentence
def write_gltf(asset: Asset, path: Path) -> tuple[str, ...]:
    """Write an asset to a .glb, .gltf or .vrm file; its skin provides the rest positions of its vertices.

    The meshes of the document stay on their nodes if the surface is theirs (`Asset.nodes`); otherwise it replaces
    all of them. A .gltf file has its buffer and images in files of their own if its document has.

    Returns:
        A sentence for each kind of data that was left out.

    Raises:
        ImportError: pygltflib is not installed.
    """
    gltf = library()
    document, look = asset.document, full_look(asset)
    made: GLTF2 = gltf.GLTF2(asset=gltf.Asset(version="2.0")) if document is None else deepcopy(document.gltf)
    made.asset.generator = f"ZoomOut Transfer {package_version()}"
    extras = {name: value for name, value in (made.asset.extras or {}).items() if name != STORED_MAP}
    if asset.stored_map is not None:
        extras[STORED_MAP] = asset.stored_map.description
    made.asset.extras = extras
    made.accessors = []
    buffer = Buffer(made)
    files = ImageFiles(made, buffer, path)
    notes = list(write_materials(made, asset, look, files))
    renumbering, lost = write_meshes(made, asset, look, buffer, path.stem)
    notes += lost
    if document is not None:
        notes += keep_animations(made, document, renumbering, look is document, buffer)
        notes += keep_copies(made, document, renumbering, buffer)
        notes += keep_avatar(made, document, look, renumbering, files)
    _declare_extensions(made)
    buffer.finish()
    if path.suffix.lower() in BINARY:
        path.write_bytes(b"".join(made.save_to_bytes()))
        return tuple(notes)
    if document is not None and document.has_buffer_files:
        place = path.with_name(f"{one_line(path.stem)}.bin")
        place.write_bytes(buffer.content)
        made.buffers[0].uri = quote(place.name)
    else:
        made.convert_buffers(gltf.BufferFormat.DATAURI)
    path.write_text(made.to_json(), encoding="utf-8")
    return tuple(notes)


def _declare_extensions(made: GLTF2) -> None:
    """Declare the extensions that occur in a document, and no others."""
    used = set(extensions_in(json.loads(made.to_json())))
    made.extensionsUsed = [name for name in made.extensionsUsed if name in used]
    made.extensionsUsed += sorted(used - set(made.extensionsUsed))
    made.extensionsRequired = [name for name in made.extensionsRequired if name in used]


def extensions_in(part: Any) -> Iterator[str]:
    """The names of the extensions in a part of a document."""
    if isinstance(part, dict):
        yield from part["extensions"] if isinstance(part.get("extensions"), dict) else ()
        part = [value for name, value in part.items() if name != "extras"]
    if isinstance(part, list):
        for each in part:
            yield from extensions_in(each)
