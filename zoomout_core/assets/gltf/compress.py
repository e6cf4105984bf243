# SPDX-License-Identifier: GPL-3.0-or-later
"""Compress the meshes of glTF files by Draco or meshopt, as the web ships them.

Both round numbers. Positions and morph targets are exact to 2^-17 of the mesh's extent, texture coordinates to 2^-17,
normals to a tenth of a degree. Weights and colours have 16 bits. Joints, indices, animations and stored maps are not
rounded.
"""

from __future__ import annotations

import json
from base64 import b64encode
from pathlib import Path
from urllib.parse import unquote

from zoomout_core.assets.gltf.compress_draco import compress_by_draco
from zoomout_core.assets.gltf.compress_meshopt import compress_by_meshopt
from zoomout_core.assets.gltf.compressed_parts import CompressedParts
from zoomout_core.mesh.formats.glb import MAGIC, pack_glb
from zoomout_core.mesh.formats.gltf_files import data_of, parse_gltf

METHODS = ("draco", "meshopt")


def compress_gltf(path: Path, method: str) -> None:
    """Compress a glTF or GLB file in its place.

    Args:
        path: a file whose accessors each have a view of their own, as `write_gltf` writes it.
        method: one of `METHODS`.

    Raises:
        ImportError: DracoPy is not installed, and the method needs it.
    """
    content = path.read_bytes()
    tree, binary = parse_gltf(content)
    if not tree.get("meshes"):
        return
    uri = tree["buffers"][0].get("uri")
    beside = uri is not None and not uri.startswith("data:")
    if uri is not None:
        binary = path.with_name(unquote(uri)).read_bytes() if beside else data_of(uri)
    made = (compress_by_draco if method == "draco" else compress_by_meshopt)(CompressedParts(tree, binary))
    if content.startswith(MAGIC):
        path.write_bytes(pack_glb(tree, made))
        return
    if beside:
        path.with_name(unquote(uri)).write_bytes(made)
    else:
        uri = "data:application/octet-stream;base64," + b64encode(made).decode()
    tree["buffers"][0]["uri"] = uri
    path.write_text(json.dumps(tree), encoding="utf-8")


# --- meshopt ------------------------------------------------------------------------------------------------
