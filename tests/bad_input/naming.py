# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that name other files, by names that lead out of their folder."""

from __future__ import annotations

import os
from pathlib import Path

from broken_gltf import content_of, document

# A one-pixel image, which must not get into any output.
SECRET = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c4944415408d763f8cfc0000003010100"
    "18dd8db00000000049454e44ae426082"
)
# Names of a file beside the folder of the mesh, as files give them; {there} is its folder.
CLIMBING = {
    "absolute": "{there}/secret.png",
    "absolute with two slashes": "/{there}/secret.png",
    "climbing": "../secret.png",
    "climbing in the middle": "textures/../../secret.png",
    "climbing by Windows' separators": "..\\secret.png",
    "climbing far": "../" * 40 + "{there}/secret.png",
    "of a drive": "C:{there}/secret.png",
    "of a server": "\\\\server\\share\\secret.png",
    "through a link to a folder": "link/secret.png",
    "through a link to the file": "link.png",
}


def with_image(folder: Path, uri: str) -> Path:
    """Write a glTF document with an image."""
    tree = document()
    tree["images"], tree["textures"] = [{"uri": uri}], [{"source": 0}]
    tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    (folder / "a.gltf").write_bytes(content_of(tree))
    return folder / "a.gltf"


def with_library(folder: Path, library: str, image: str) -> Path:
    """Write an OBJ file with the name of its materials, and beside it materials with the name of an image."""
    (folder / "a.mtl").write_text(f"newmtl Red\nKd 1 0 0\nmap_Kd {image}\n")
    (folder / "a.obj").write_text(f"mtllib {library}\nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl Red\nf 1 2 3\n")
    return folder / "a.obj"


def make_pipe(path: Path) -> None:
    os.mkfifo(path)
