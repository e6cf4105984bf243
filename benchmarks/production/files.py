# SPDX-License-Identifier: GPL-3.0-or-later
"""Files as the web ships them: their sizes and differences, and their content as other programs read it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import bpy
import numpy as np
import pygltflib
import trimesh
from bpy.types import Object
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from benchmarks.production.levels import through_file
from blender_addon import mesh_data
from blender_addon.demo.character import build_character
from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import UV, Asset, on_corners
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.gltf.compress import METHODS
from zoomout_core.assets.lods import make_lods, with_level_names

Row = dict[str, Any]

# The level of detail that other programs open: its share of the vertices, and most joints of a vertex.
SHARE, JOINTS = 0.25, 4
# Keys of the character: displacements along an axis, in metres, that fade out around a place.
KEYS = {"Smile": 0, "Look Up": 2}
LIFT, CENTER, REACH = 0.05, (0.0, -0.2, 1.2), 0.15


def open_elsewhere(
    cell: float, node_modules: Path | None = None, panda: Path | None = None, godot: Path | None = None
) -> list[Row]:
    """Open a level of the demo's character, in files of each compression, in other programs.

    Args:
        cell: edge length of the character, in metres.
        node_modules: a folder of packages for Node.js, see `loaders.mjs`; without it, its programs are left out.
        panda: a Python program with panda3d, see `panda.py`; without it, it is left out.
        godot: the program of Godot 3 with its editor, see `godot.gd`; without it, it is left out.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    character, rig = build_character(cell)
    _add_keys(character)
    rows = list[Row]()
    with TemporaryDirectory() as name:
        folder = Path(name)
        asset = through_file(character, rig, folder / "character.glb")
        assert asset.skin is not None
        level = with_level_names(make_lods(asset, [SHARE], JOINTS)[0].asset, 1)
        files = [folder / f"{method or 'plain'}.glb" for method in (None, *METHODS)]
        for path, method in zip(files, (None, *METHODS), strict=True):
            write_asset(level, path, compression=method)
            rows += [{"file": path.name, "reader": reader, **_attempt(read, path)} for reader, read in READERS.items()]
        here = Path(__file__).parent
        if node_modules is not None:
            rows += _run("node", here / "loaders.mjs", node_modules, *files)
        if panda is not None:
            rows += _run(panda, here / "panda.py", *files)
        if godot is not None:
            rows += _run(godot, "-s", here / "godot.gd", *files)
    written = {
        "file": "",
        "reader": "(written)",
        "names": [name for name, _ in level.objects],
        "vertices": len(level.surface.vertices),
        "triangles": len(level.surface.triangles),
        "joints": len(asset.skin.names),
        "targets": list(KEYS),
        "errors": None,
        "problem": None,
    }
    return [_as_text(row) for row in (written, *rows)]


def _add_keys(character: Object) -> None:
    places = mesh_data.read_positions(character.data).astype(float)
    share = np.exp(-(((places - CENTER) / REACH) ** 2).sum(axis=1))
    character.shape_key_add(name="Basis")
    for name, axis in KEYS.items():
        moved = places.copy()
        moved[:, axis] += LIFT * share
        character.shape_key_add(name=name).points.foreach_set("co", moved.ravel())


def _attempt(read: Any, path: Path) -> Row:
    try:
        return dict(read(path))
    except Exception as error:  # each program has exceptions of its own
        return {"problem": str(error).strip().splitlines()[-1][-120:]}


def _read_in_blender(path: Path) -> Row:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.import_scene.gltf(filepath=str(path), import_shading="NORMALS")
    meshes = [obj.data for obj in bpy.data.objects if obj.type == "MESH" and obj.vertex_groups]
    keys = [mesh.shape_keys.key_blocks.keys()[1:] for mesh in meshes if mesh.shape_keys]
    return {
        "names": [mesh.name for mesh in meshes],
        "vertices": sum(len(mesh.vertices) for mesh in meshes),
        "triangles": sum(len(mesh.polygons) for mesh in meshes),
        "joints": sum(len(rig.bones) for rig in bpy.data.armatures),
        "targets": [name for each in keys for name in each],
    }


def _read_by_trimesh(path: Path) -> Row:
    scene = trimesh.load_scene(path)
    meshes = scene.geometry
    return {
        "names": list(meshes),
        "vertices": sum(len(mesh.vertices) for mesh in meshes.values()),
        "triangles": sum(len(mesh.faces) for mesh in meshes.values()),
    }


def _read_by_pygltflib(path: Path) -> Row:
    """The structure alone: it decodes no compression."""
    made = pygltflib.GLTF2().load(str(path))
    parts = [part for mesh in made.meshes for part in mesh.primitives]
    return {
        "names": [mesh.name for mesh in made.meshes],
        "vertices": sum(made.accessors[part.attributes.POSITION].count for part in parts),
        "triangles": sum(made.accessors[part.indices].count // 3 for part in parts),
        "joints": max(len(skin.joints) for skin in made.skins),
        "targets": [name for mesh in made.meshes for name in mesh.extras.get("targetNames", [])],
    }


READERS = {"trimesh": _read_by_trimesh, "pygltflib": _read_by_pygltflib, "Blender": _read_in_blender}


def _run(*command: object) -> list[Row]:
    """The rows that a program prints as JSON in its last line."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    if done.returncode:
        print(done.stderr, file=sys.stderr)
        return []
    return list(json.loads(done.stdout.splitlines()[-1]))


def _as_text(row: Row) -> Row:
    """A row whose lists are names with commas between them."""
    return {key: ", ".join(value) if isinstance(value, list) else value for key, value in row.items()}


def compress(cell: float) -> list[Row]:
    """The demo's character in compressed files: their sizes, and the largest differences in millionths."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    character, rig = build_character(cell)
    rows = []
    with TemporaryDirectory() as folder:
        asset = through_file(character, rig, Path(folder) / "character.glb")
        for method in (None, *METHODS):
            path = Path(folder) / f"{method}.glb"
            begin = process_time()
            write_asset(asset, path, compression=method)
            written = process_time()
            again = read_asset(path)
            rows.append(
                {
                    "compression": method or "none",
                    "kB": path.stat().st_size / 1000,
                    "write s": written - begin,
                    "read s": process_time() - written,
                    **_differences(asset, again),
                }
            )
    return rows


def _differences(asset: Asset, again: Asset) -> Row:
    """How far a file's content is from that of another one, whose vertices may have another order."""
    surface, extent = asset.surface, float(np.ptp(asset.surface.vertices, axis=0).max())
    off, place = map(np.asarray, cKDTree(again.surface.vertices).query(surface.vertices))
    faces, found = (
        {tuple(sorted(row)) for row in triangles.tolist()}
        for triangles in (place[surface.triangles], again.surface.triangles)
    )
    rows = [
        np.column_stack([each.surface.vertices[each.surface.corner_vertex] / extent, _values_of(each)])
        for each in (asset, again)
    ]
    return {
        "vertices": len(again.surface.vertices),
        "same faces %": 100 * len(faces & found) / len(faces),
        "position": 1e6 * off.max() / extent,
        "UV": 1e6 * float(np.max(cKDTree(rows[1]).query(rows[0])[0])),
        "weight": 1e6 * float(abs(csr_array(again.skin.weights)[place] - asset.skin.weights).max())
        if asset.skin is not None and again.skin is not None
        else None,
    }


def _values_of(asset: Asset) -> Floats:
    """(c, 2) the texture coordinates of an asset's corners, zero without any."""
    texture = asset.find(f"{UV} 0")
    return np.zeros((len(asset.surface.corner_vertex), 2)) if texture is None else on_corners(texture, asset.surface)
