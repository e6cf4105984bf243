# SPDX-License-Identifier: GPL-3.0-or-later
"""List the content of GLB files as the game engine Panda3D imports it, as JSON: python panda.py FILE...

It runs in an environment of its own, with panda3d and panda3d-gltf.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from direct.showbase.ShowBase import ShowBase
from panda3d.core import CharacterJoint, CharacterSlider, Filename, loadPrcFileData


def main() -> None:
    """Import each file, and print what is in it."""
    loadPrcFileData("", "window-type none\naudio-library-name null\nnotify-level-error fatal")
    loader = ShowBase().loader
    found = []
    for file in sys.argv[1:]:
        row = {"file": Path(file).name, "reader": "Panda3D"}
        try:
            found.append(row | _content(loader.loadModel(Filename.fromOsSpecific(file), noCache=True)))
        except OSError as error:
            found.append(row | {"problem": str(error).split(":")[0]})
    print(json.dumps(found))


def _content(model: Any) -> dict[str, Any]:
    nodes = [path.node() for path in model.findAllMatches("**/+GeomNode")]
    meshes = [node.getGeom(number) for node in nodes for number in range(node.getNumGeoms())]
    lists = [mesh.getPrimitive(number).decompose() for mesh in meshes for number in range(mesh.getNumPrimitives())]
    parts = [
        part
        for path in model.findAllMatches("**/+Character")
        for bundle in range(path.node().getNumBundles())
        for part in _parts(path.node().getBundle(bundle))
    ]
    return {
        "names": [node.name for node in nodes],
        "vertices": sum(mesh.getVertexData().getNumRows() for mesh in meshes),
        "triangles": sum(triangles.getNumPrimitives() for triangles in lists),
        "joints": sum(isinstance(part, CharacterJoint) for part in parts),
        "targets": [part.name for part in parts if isinstance(part, CharacterSlider)],
    }


def _parts(group: Any) -> Iterator[Any]:
    for number in range(group.getNumChildren()):
        yield group.getChild(number)
        yield from _parts(group.getChild(number))


if __name__ == "__main__":
    main()
