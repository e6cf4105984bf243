# SPDX-License-Identifier: GPL-3.0-or-later
"""Every reader of files that `fuzz.py` tests, with valid samples of its format."""

from __future__ import annotations

import json
import tempfile
from base64 import b64encode
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from fuzz_damage import damage, damage_binary, damage_structure
from numpy.typing import NDArray

from meshlab_filter.project import read_project
from meshlab_filter.script import read_script
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.gltf.avatars import read_avatar
from zoomout_core.assets.gltf.compress import METHODS
from zoomout_core.maps.surface_map import SurfaceMap, read_vertex_map
from zoomout_core.mesh.formats.files import read_shape
from zoomout_core.mesh.surface import Surface
from zoomout_core.text_arguments import read_landmarks

# The compressions of glTF whose packages are installed.
COMPRESSIONS = METHODS if find_spec("DracoPy") else ("meshopt",)


@dataclass(frozen=True)
class Reader:
    """A format and its reader.

    Attributes:
        ending: the extension of its files.
        read: reads a file.
        samples: valid files.
        damage: damages a file.
    """

    ending: str
    read: Callable[[Path], object]
    samples: tuple[bytes, ...]
    damage: Callable[[bytes, np.random.Generator], bytes] = field(default_factory=lambda: damage)


OFF = "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n4 0 1 2 3\n"
OBJ = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nusemtl a\nf 1/1 2/2 3/1\nf -4 -3 -2 -1\n"
SCRIPT = """<!DOCTYPE FilterScript>
<FilterScript>
 <filter name="transfer_attributes_by_zoomout">
  <Param name="sourcemesh" type="RichMesh" value="0"/>
  <Param name="targetmesh" type="RichMesh" value="1"/>
 </filter>
</FilterScript>
"""
PROJECT = """<!DOCTYPE MeshLabDocument>
<MeshLabProject>
 <MeshGroup>
  <MLMesh filename="a.ply" label="a" idInFile="-1" visible="1">
   <MLMatrix44>
1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1
</MLMatrix44>
  </MLMesh>
 </MeshGroup>
 <RasterGroup/>
</MeshLabProject>
"""
LANDMARKS = b"# pairs\n0 1\n2 3\n", b"0 0 0 1 1 1\n0 1 0 1 0 1\n"


def readers() -> dict[str, Reader]:
    """All readers of files by name."""
    mesh = trimesh.creation.icosphere(subdivisions=1)
    surface = Surface(mesh.vertices, mesh.faces)
    texture = np.linspace(0, 1, 2 * len(mesh.vertices)).reshape(-1, 2)
    colors = np.arange(4 * len(mesh.vertices)).reshape(-1, 4) % 256
    colored = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colors, process=False)
    saved = _saved_files(mesh, surface, texture)
    ply = tuple(_export(colored, file_type="ply", encoding=encoding) for encoding in ("ascii", "binary"))
    return {
        "off": Reader(".off", read_shape, (OFF.encode(),)),
        "obj": Reader(".obj", read_shape, (OBJ.encode(),)),
        "ply": Reader(".ply", read_shape, ply),
        "stl": Reader(".stl", read_shape, (_export(mesh, file_type="stl"),)),
        "glb": Reader(".glb", read_shape, (saved["a.glb"],)),
        "asset of obj": Reader(".obj", read_asset, (OBJ.encode(),)),
        "asset of ply": Reader(".ply", read_asset, (*ply, _ply_with_texture(mesh, texture))),
        "asset of glb": Reader(".glb", read_asset, (saved["a.glb"],)),
        "compressed glb": Reader(
            ".glb", read_shape, tuple(saved[f"{each}.glb"] for each in COMPRESSIONS), damage_binary
        ),
        "structure of compressed gltf": Reader(
            ".gltf", read_shape, tuple(saved[f"{each}.gltf"] for each in COMPRESSIONS), damage_structure
        ),
        "asset of gltf": Reader(".gltf", read_asset, (saved["a.gltf"],)),
        "structure of gltf": Reader(".gltf", _read_and_write, (gltf_with_everything(),), damage_structure),
        "structure of the shape of gltf": Reader(".gltf", read_shape, (gltf_with_everything(),), damage_structure),
        "map": Reader(".npz", lambda path: SurfaceMap.load(path, surface), (saved["map.npz"],)),
        "vertices of a map": Reader(".npz", lambda path: read_vertex_map(str(path)), (saved["map.npz"],)),
        "script": Reader(".mlx", read_script, (SCRIPT.encode(),)),
        "project": Reader(".mlp", read_project, (PROJECT.encode(),)),
        "landmarks": Reader(".txt", lambda path: read_landmarks(str(path)), LANDMARKS),
    }


def _saved_files(mesh: Any, surface: Surface, texture: NDArray[Any]) -> dict[str, bytes]:
    """The content of a map and of glTF files, compressed or not, by their names."""
    names = "map.npz", *(f"{name}.{ending}" for name in ("a", *COMPRESSIONS) for ending in ("glb", "gltf"))
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        SurfaceMap.from_vertices(np.arange(len(mesh.vertices)), surface).save(place / "map.npz")
        asset = read_asset(_write(place / "uv.ply", _ply_with_texture(mesh, texture)))
        for ending in ("glb", "gltf"):
            write_asset(asset, place / f"a.{ending}")
            for method in COMPRESSIONS:
                write_asset(asset, place / f"{method}.{ending}", compression=method)
        return {name: (place / name).read_bytes() for name in names}


def _export(mesh: Any, **options: str) -> bytes:
    return bytes(mesh.export(**options))


def _ply_with_texture(mesh: Any, texture: NDArray[Any]) -> bytes:
    """A PLY file with texture coordinates at the vertices."""
    header = f"ply\nformat ascii 1.0\nelement vertex {len(mesh.vertices)}\n"
    header += "".join(f"property float {name}\n" for name in "xyzst")
    header += f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [" ".join(f"{value:.5g}" for value in (*v, *t)) for v, t in zip(mesh.vertices, texture, strict=True)]
    return (header + "\n".join([*rows, *("3 " + " ".join(map(str, face)) for face in mesh.faces)]) + "\n").encode()


def gltf_with_everything() -> bytes:
    """A small glTF file with joints, animations, morph targets, a sparse accessor, a texture, and many extensions."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
    matrices = np.tile(np.eye(4, dtype="<f4").ravel(), (2, 1))
    image = bytes.fromhex(
        "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c4944415408d763f8cfc0000003010100"
        "18dd8db00000000049454e44ae426082"
    )
    rows: tuple[tuple[NDArray[Any], int, str], ...] = (
        (positions, 5126, "VEC3"),
        (np.array([0, 1, 2, 0, 2, 3], "<u2"), 5123, "SCALAR"),
        (positions[:, :2].copy(), 5126, "VEC2"),
        (np.tile(np.array([0, 1, 0, 0], "u1"), (4, 1)), 5121, "VEC4"),
        (np.tile(np.array([0.5, 0.5, 0, 0], "<f4"), (4, 1)), 5126, "VEC4"),
        (matrices, 5126, "MAT4"),
        (np.array([0, 1], "<f4"), 5126, "SCALAR"),
        (np.array([[0, 0, 0, 1], [0, 0, 0.6, 0.8]], "<f4"), 5126, "VEC4"),
        (np.array([1, 3], "<u2"), 5123, "SCALAR"),
    )
    views: list[dict[str, Any]] = []
    data = b""
    for content in (*(values.tobytes() for values, _, _ in rows), image):
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(content)})
        data += content + bytes(-len(content) % 4)
    accessors: list[dict[str, Any]] = [
        {"bufferView": number, "componentType": code, "count": len(values), "type": kind}
        for number, (values, code, kind) in enumerate(rows)
    ]
    changes = {"indices": {"bufferView": 8, "componentType": 5123}, "values": {"bufferView": 0, "byteOffset": 12}}
    accessors.append({"componentType": 5126, "count": 4, "type": "VEC3", "sparse": {"count": 2, **changes}})
    columns = {"POSITION": 0, "NORMAL": 0, "TEXCOORD_0": 2, "COLOR_0": 0, "JOINTS_0": 3, "WEIGHTS_0": 4}
    variants = {"KHR_materials_variants": {"mappings": [{"material": 1, "variants": [0]}]}}
    primitive = {"attributes": columns, "indices": 1, "material": 0, "targets": [{"POSITION": 9}, {"POSITION": 9}]}
    channels = [
        {"sampler": 0, "target": {"node": 2, "path": "rotation"}},
        {"sampler": 1, "target": {"node": 3, "path": "weights"}},
        *({"sampler": 1, "target": _pointer(to)} for to in ("/nodes/3/weights", "/meshes/0/weights/1", "/materials/0")),
    ]
    tree = {
        "asset": {"version": "2.0", "generator": "fuzz"},
        "scene": 0,
        "scenes": [{"nodes": [0, 3, 4]}],
        "nodes": [
            {"name": "Armature", "children": [1], "scale": [1, 1, 1]},
            {"name": "Lower", "children": [2], "matrix": np.eye(4).ravel().tolist()},
            {"name": "Upper", "translation": [0, 1, 0], "rotation": [0, 0, 0, 1]},
            {"mesh": 0, "skin": 0, "weights": [0, 0.5]},
            {
                "mesh": 1,
                "translation": [0, 0, 1],
                "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}},
            },
        ],
        "meshes": [
            {
                "primitives": [primitive | {"extensions": variants}],
                "weights": [0, 0],
                "extras": {"targetNames": ["A", "B"]},
            },
            {"name": "Strip", "primitives": [{"attributes": {"POSITION": 0}, "mode": 5}]},
        ],
        "skins": [{"joints": [1, 2], "inverseBindMatrices": 5, "skeleton": 0}],
        "animations": [
            {"samplers": [{"input": 6, "output": 7}, {"input": 6, "output": 8}], "channels": channels, "name": "Bend"}
        ],
        "materials": [
            {
                "name": "Red",
                "pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1], "baseColorTexture": {"index": 0}},
            },
            {"name": "Blue", "extras": {"kind": 1}},
        ],
        "textures": [{"source": 0, "sampler": 0, "extensions": {"EXT_texture_webp": {"source": 0}}}],
        "samplers": [{"magFilter": 9729}],
        "images": [{"bufferView": 9, "mimeType": "image/png"}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data), "uri": f"data:;base64,{b64encode(data).decode()}"}],
        "extensionsUsed": ["KHR_materials_variants", "EXT_texture_webp"],
        "extensions": {"KHR_materials_variants": {"variants": [{"name": "dark"}]}, **_avatars()},
    }
    return json.dumps(tree).encode()


def _pointer(to: str) -> dict[str, Any]:
    return {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": to}}}


def _avatars() -> dict[str, Any]:
    """The extensions of VRM 0 and 1."""
    color = {"materialName": "Red", "propertyName": "_Color", "targetValue": [1, 1, 1, 1]}
    blink = {"name": "Blink", "presetName": "blink", "binds": [{"mesh": 0, "index": 0, "weight": 100}]}
    expression = {
        "morphTargetBinds": [{"node": 3, "index": 1, "weight": 1}],
        "materialColorBinds": [{"material": 0, "type": "color", "targetValue": [1, 1, 1, 1]}],
    }
    return {
        "VRM": {
            "meta": {"title": "A", "author": "B", "licenseName": "CC0", "texture": 0},
            "humanoid": {"humanBones": [{"bone": "hips", "node": 1}]},
            "firstPerson": {"meshAnnotations": [{"mesh": 0, "firstPersonFlag": "Auto"}]},
            "blendShapeMaster": {"blendShapeGroups": [blink | {"materialValues": [color]}]},
            "secondaryAnimation": {"boneGroups": [{"bones": [1], "colliderGroups": []}], "colliderGroups": []},
            "materialProperties": [{"name": "Red"}, {"name": "Blue"}],
        },
        "VRMC_vrm": {
            "specVersion": "1.0",
            "meta": {"name": "A", "authors": ["B"], "thumbnailImage": 0},
            "humanoid": {"humanBones": {"hips": {"node": 1}}},
            "firstPerson": {"meshAnnotations": [{"node": 3, "type": "both"}]},
            "expressions": {"preset": {"blink": expression}, "custom": {"Red": expression}},
        },
        "VRMC_springBone": {"specVersion": "1.0", "springs": [{"name": "A", "joints": [{"node": 1}, {"node": 2}]}]},
    }


def _read_and_write(path: Path) -> None:
    """Read an asset, and write it in the formats that refer to other files, and as the mesh of another file."""
    asset = read_asset(path)
    read_avatar(asset.document)
    with tempfile.TemporaryDirectory() as folder:
        for ending in (".glb", ".gltf", ".obj"):
            write_asset(asset, Path(folder) / f"a{ending}")
        write_asset(replace(asset, nodes=(), attributes=asset.attributes[:1]), Path(folder) / "b.glb")


def _write(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path
