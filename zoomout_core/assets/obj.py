# SPDX-License-Identifier: GPL-3.0-or-later
"""OBJ files as assets: texture coordinates, vertex colours and materials, with their images beside them."""

from __future__ import annotations

import io
from itertools import pairwise
from pathlib import Path

import numpy as np

from zoomout_core.arrays import Integers
from zoomout_core.assets.asset import (
    COLOR,
    MATERIALS,
    NORMALS,
    SHAPE_KEYS,
    UV,
    Asset,
    Material,
    from_srgb,
    material_numbers,
    on_points,
    suffix_of,
    to_srgb,
)
from zoomout_core.mesh.files import file_bytes, surface_of
from zoomout_core.mesh.obj_files import parse_obj, statements
from zoomout_core.transfer.attribute import Attribute, Domain, Kind


def read_obj(path: Path) -> Asset:
    """Read an OBJ file with its .mtl files.

    Raises:
        MeshError: it cannot be read, or has no faces.
    """
    content = parse_obj(file_bytes(path))
    surface = surface_of(content.polygons(), {}, path)
    uvs, colors = content.coordinates(), content.colors()
    coordinate = content.corner_coordinates()
    materials: dict[str, Material] = {}
    for library in content.libraries:
        materials |= _read_mtl(path.parent / library)
    attributes = []
    if uvs and max(coordinate, default=-1) >= 0:
        table = np.vstack([uvs, [[0.0, 0.0]]])  # corners without coordinates use the last row
        attributes.append(Attribute(f"{UV} 0", Domain.CORNER, Kind.UV, table[coordinate]))
    if len(colors) == len(surface.vertices):
        attributes.append(Attribute(f"{COLOR} 0", Domain.POINT, Kind.COLOR, from_srgb(np.array(colors))))
    if content.materials:
        attributes.append(material_numbers(np.array(content.face_materials)))
    return Asset(surface, tuple(attributes), tuple(materials.get(name, Material(name)) for name in content.materials))


def _read_mtl(path: Path) -> dict[str, Material]:
    """The materials of a file by name; none if the file is missing."""
    if not path.is_file():
        return {}
    found: dict[str, Material] = {}
    name, color, image = None, [1.0, 1.0, 1.0, 1.0], None
    for keyword, line in [*statements(path.read_bytes()), ("newmtl", "")]:
        words = line.split()[1:]
        if keyword == "newmtl":
            if name is not None:
                found[name] = Material(name, (color[0], color[1], color[2], color[3]), image)
            name, color, image = " ".join(words), [1.0, 1.0, 1.0, 1.0], None
        elif keyword == "Kd" and len(words) >= 3:
            color[:3] = [float(word) for word in words[:3]]
        elif keyword == "d" and words:
            color[3] = float(words[-1])
        elif keyword == "map_Kd" and words:
            # Options precede the name, which may have spaces.
            places = [path.parent / name for name in (" ".join(words), words[-1])]
            image = next((place.read_bytes() for place in places if place.is_file()), None)
    return found


def write_obj(asset: Asset, path: Path) -> tuple[str, ...]:
    """Write an OBJ file with its .mtl file and images; data that the format cannot store is reported in the notes."""
    surface, text = asset.surface, io.StringIO()
    uv, color, normals = (asset.find(name) for name in (f"{UV} 0", f"{COLOR} 0", NORMALS))
    materials = asset.find(MATERIALS) if asset.materials else None
    if materials is not None:
        text.write(f"mtllib {path.stem}.mtl\n")
    columns = [surface.vertices]
    if color is not None:
        columns.append(to_srgb(np.asarray(on_points(color, surface))[:, :3]))
    np.savetxt(text, np.hstack(columns), fmt="v" + " %.9g" * sum(each.shape[1] for each in columns))
    indices = [surface.corner_vertex]
    for letters, attribute in (("vt", uv), ("vn", normals)):
        if attribute is None:
            indices.append(np.full(len(surface.corner_vertex), -1))
            continue
        values, index = np.unique(np.asarray(attribute.values, dtype=np.float64), axis=0, return_inverse=True)
        np.savetxt(text, values, fmt=letters + " %.9g" * values.shape[1])
        indices.append(index.ravel())
    _write_faces(text, surface.face_start, np.stack(indices, axis=1), asset, materials)
    path.write_text(text.getvalue())
    if materials is not None:
        _write_mtl(asset.materials, path)
    return _notes(asset)


def _write_faces(
    text: io.StringIO, face_start: Integers, indices: Integers, asset: Asset, materials: Attribute | None
) -> None:
    """Write the faces with their corners (c, 3), grouped by material."""
    corners = ["/".join(str(each + 1) if each >= 0 else "" for each in row).rstrip("/") for row in indices.tolist()]
    faces = [" ".join(corners[start:end]) for start, end in pairwise(face_start)]
    number = np.full(len(faces), -1) if materials is None else np.asarray(materials.values)
    for material in np.unique(number):
        if material >= 0:
            text.write(f"usemtl {asset.materials[material].name}\n")
        text.writelines(f"f {faces[face]}\n" for face in np.flatnonzero(number == material))


def _write_mtl(materials: tuple[Material, ...], path: Path) -> None:
    lines = []
    for number, material in enumerate(materials):
        lines += [
            f"newmtl {material.name}",
            "Kd {:.6g} {:.6g} {:.6g}".format(*material.color),
            f"d {material.color[3]:.6g}",
        ]
        if material.image is not None:
            image = path.with_name(f"{path.stem}_{number}{suffix_of(material.image)}")
            image.write_bytes(material.image)
            lines.append(f"map_Kd {image.name}")
    path.with_suffix(".mtl").write_text("\n".join(lines) + "\n")


def _notes(asset: Asset) -> tuple[str, ...]:
    several = [
        each.name for each in asset.attributes if each.name.startswith((UV, COLOR)) and not each.name.endswith(" 0")
    ]
    left = [
        *several,
        *(["skin weights"] if asset.skin is not None else []),
        *([SHAPE_KEYS] if asset.find(SHAPE_KEYS) else []),
    ]
    if not left:
        return ()
    return (f"OBJ files cannot store {' or '.join(left)}, which were left out: write a .glb file to keep them.",)
