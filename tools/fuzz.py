# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged files for every reader: each must be read or refused in one sentence, within limits of time and memory.

    make fuzz ARGS="--count 100000"

A sample of each format is damaged at random and read in a process with limited memory. A refusal
is a MeshError, whose message a user sees. Anything else is a finding, and its file is kept. Bytes are damaged in every
format; in glTF also the structure: its JSON stays valid, but refers to what does not exist, in cycles, or by values of
another type.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
import time
import warnings
from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from tqdm import tqdm

from meshlab_filter.project import read_project
from meshlab_filter.script import read_script
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.gltf.avatars import read_avatar
from zoomout_core.assets.gltf.compress import METHODS
from zoomout_core.maps.surface_map import SurfaceMap, read_vertex_map
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import read_shape
from zoomout_core.mesh.surface import Surface
from zoomout_core.text_arguments import read_landmarks

# Maximum processor seconds for a file of some kilobytes, since the machine may be busy, and bytes that reading
# may need.
MAX_SECONDS, MAX_MEMORY = 5.0, 4 << 30
# The compressions of glTF whose packages are installed.
COMPRESSIONS = METHODS if find_spec("DracoPy") else ("meshopt",)
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
# Replacements of numbers.
NUMBERS = (b"0", b"-1", b"1e308", b"nan", b"inf", b"4294967295", b"2147483648", b"99999999999", b"1.5", b"x", b"")
# Replacements of values in JSON.
VALUES: tuple[Any, ...] = (
    *(None, True, False, -1, 0, 1, 2, 3, 7, 255, 5120, 5126, 1 << 16, 1 << 31, 1 << 53, 10**400, 0.5, -0.5, 1e308),
    *(
        float("nan"),
        float("inf"),
        "",
        "a",
        "0",
        "VEC3",
        "SCALAR",
        "MAT4",
        "../a",
        "missing.bin",
        "data:,",
        "data:;base64,A",
    ),
    *([], {}, [[]], [0], [0, 0], [0, 1, 2, 3], [-1], ["a"], [None], {"a": 0}, {"POSITION": 0}, {"index": 0}),
)
# Words of Python and its libraries, which tell a user neither the problem nor the solution.
INTERNAL = re.compile(
    r"list index|index \d+ is out|object (is not|has no)|could not convert|invalid literal|values to unpack|"
    r"NoneType|not supported between|codec can't|Expecting |buffer (is smaller|size)|argument (must|should)|dtype|\b__|"
    r"'\w+' object|read \('?\w*'?\)"
)
BYTES = (b"\x00", b"\xff", b"\n", b"\r\n", b" ", b"\xef\xbb\xbf", b"#", b"\xff\xff\xff\xff", b"\x00\x00\x00\x80")


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


def damage(content: bytes, random: np.random.Generator) -> bytes:
    """Damage a file in one or a few ways."""
    broken = bytearray(content)
    for _ in range(random.geometric(0.6)):
        at = int(random.integers(0, len(broken) + 1))
        match random.choice(7, p=[0.04, 0.1, 0.1, 0.2, 0.1, 0.16, 0.3]):
            case 0:
                del broken[at:]
            case 1:
                del broken[at : at + int(random.integers(1, 64))]
            case 2:
                broken[at:at] = BYTES[random.integers(len(BYTES))]
            case 3 if at < len(broken):
                broken[at] ^= 1 << int(random.integers(8))
            case 4:
                broken[at:at] = broken[at : at + int(random.integers(1, 200))]
            case 5 if at < len(broken):
                broken[at : at + 4] = random.bytes(4)
            case _:
                numbers = list(NUMBER.finditer(bytes(broken)))
                if numbers:
                    start, end = numbers[random.integers(len(numbers))].span()
                    broken[start:end] = NUMBERS[random.integers(len(NUMBERS))]
    return bytes(broken)


def damage_binary(content: bytes, random: np.random.Generator) -> bytes:
    """Damage the binary data of a GLB file in one or a few bytes: its JSON stays, so that its streams are decoded."""
    broken, start = bytearray(content), 20 + int.from_bytes(content[12:16], "little") + 8
    for at in random.integers(start, len(content), random.geometric(0.3)):
        broken[at] = random.integers(256) if random.random() < 0.5 else broken[at] ^ 1 << int(random.integers(8))
    return bytes(broken)


def damage_structure(content: bytes, random: np.random.Generator) -> bytes:
    """Damage the JSON of a file in one or a few places: it stays JSON."""
    tree = json.loads(content)
    for _ in range(random.geometric(0.6)):
        places = list(_places(tree))
        if not places:
            break
        part, key = places[random.integers(len(places))]
        other, other_key = places[random.integers(len(places))]
        match random.choice(6, p=[0.4, 0.2, 0.15, 0.1, 0.05, 0.1]):
            case 0:
                part[key] = deepcopy(VALUES[random.integers(len(VALUES))])
            case 1:
                part[key] = deepcopy(other[other_key])
            case 2:
                del part[key]
            case 3 if isinstance(part, list):
                part.extend(deepcopy(part[key]) for _ in range(int(random.integers(1, 40))))
            case 4:
                part[key] = [part[key]]
            case _ if isinstance(part[key], int):
                part[key] = int(part[key] + random.integers(-3, 4))
    return json.dumps(tree).encode()


def _places(part: Any) -> Iterator[tuple[Any, Any]]:
    """Each object or list within a part, with each key or index in it."""
    for key in part if isinstance(part, dict) else range(len(part)) if isinstance(part, list) else ():
        yield part, key
        yield from _places(part[key])


def cases(name: str, reader: Reader, count: int, seed: int) -> Iterator[bytes]:
    """Damaged files for a reader, the same for the same seed."""
    for number in range(count):
        random = np.random.default_rng([seed, number, *name.encode()])
        yield reader.damage(reader.samples[number % len(reader.samples)], random)


def fault_of(reader: Reader, path: Path) -> tuple[str, str]:
    """A reader's result on a file: "read", "refused", or "finding" with a description."""
    begin = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader.read(path)
        end = "read", ""
    except MeshError as error:
        sentence = str(error)
        one = "\n" not in sentence and sentence.strip().endswith((".", "?"))
        end = ("refused", "") if one and not INTERNAL.search(sentence) else ("finding", f"is no sentence: {sentence!r}")
    except MemoryError:
        end = "finding", "MemoryError"
    except Exception as error:  # any other exception is a finding
        end = "finding", f"{type(error).__name__}: {error}"
    took = time.process_time() - begin
    return ("finding", f"{took:.1f} s") if took > MAX_SECONDS else end


def run(
    count: int, seed: int, keep: Path | None = None, names: list[str] | None = None
) -> tuple[Counter[str], list[str]]:
    """Read damaged files of all formats.

    Args:
        count: total number of files.
        seed: for the damages.
        keep: the folder for files with findings.
        names: names of readers; all if empty.

    Returns:
        The numbers of files read, refused, and with findings; and a line for each finding.
    """
    known = {name: reader for name, reader in readers().items() if names is None or name in names}
    ends: Counter[str] = Counter()
    findings = []
    share = -(-count // len(known))
    with tempfile.TemporaryDirectory() as folder, tqdm(total=share * len(known), disable=None) as bar:
        for name, reader in known.items():
            path = Path(folder) / f"broken{reader.ending}"
            for number, content in enumerate(cases(name, reader, share, seed)):
                path.write_bytes(content)
                end, what = fault_of(reader, path)
                ends[end] += 1
                bar.update()
                if end == "finding":
                    findings.append(f"{name} {number}: {what}")
                    if keep is not None:
                        keep.mkdir(parents=True, exist_ok=True)
                        (keep / f"{name.replace(' ', '_')}_{number}{reader.ending}").write_bytes(content)
    return ends, findings


def limit_memory() -> None:
    """Limit this process to the memory that reading a small file may need."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))


def main() -> None:
    """Read damaged files, and exit with 1 if one was neither read nor refused in a sentence."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20_000, help="files in all (default: 20000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("dist/fuzz"), help="folder for files with findings")
    parser.add_argument("--reader", action="append", help="one of the readers; may be repeated")
    arguments = parser.parse_args()
    limit_memory()
    ends, findings = run(arguments.count, arguments.seed, arguments.keep, arguments.reader)
    print(json.dumps(ends))
    for line in findings[:50]:
        print(line)
    sys.exit(bool(findings))


if __name__ == "__main__":
    main()
