# SPDX-License-Identifier: GPL-3.0-or-later
"""OBJ files as assets: texture coordinates, vertex colours and materials, with their images beside them."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from contextlib import suppress
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
    one_line,
    to_srgb,
)
from zoomout_core.mesh.formats.files import drop_broken_faces, surface_of
from zoomout_core.mesh.formats.image_types import image_type
from zoomout_core.mesh.formats.obj_files import parse_obj, statements
from zoomout_core.mesh.formats.opening import file_bytes, shown
from zoomout_core.runtime.input_files import FormatError, OutsideError, beside, read_whole
from zoomout_core.transfer.attribute import Attribute, Domain, Kind


def read_obj(path: Path, folders: Iterable[Path] = ()) -> Asset:
    """Read an OBJ file with its .mtl files.

    Args:
        path: the file.
        folders: further folders in which its materials and images may be.

    Raises:
        MeshError: it cannot be read, or has no faces.
    """
    content = parse_obj(file_bytes(path))
    given = content.polygons()
    polygons, kept = drop_broken_faces(given)
    surface = surface_of(polygons, {}, path)
    uvs, colors = content.coordinates(), content.colors()
    coordinate = np.array(content.corner_coordinates(), dtype=np.int64)[np.repeat(kept, np.diff(given[2]))]
    if coordinate.max(initial=-1) >= len(uvs) or coordinate.min(initial=0) < -1:
        raise FormatError(f"a face refers to a texture coordinate that is none of its {len(uvs)}")
    reader = _MaterialReader(tuple(folders))
    for library in content.libraries:
        reader.read(library, path.parent)
    attributes = []
    if uvs and coordinate.max(initial=-1) >= 0:
        table = np.vstack([uvs, [[0.0, 0.0]]])  # corners without coordinates use the last row
        attributes.append(Attribute(f"{UV} 0", Domain.CORNER, Kind.UV, table[coordinate]))
    if len(colors) == len(surface.vertices):
        attributes.append(Attribute(f"{COLOR} 0", Domain.POINT, Kind.COLOR, from_srgb(np.array(colors))))
    if content.materials:
        attributes.append(material_numbers(np.array(content.face_materials)[kept]))
    materials = tuple(reader.materials.get(name, Material(name)) for name in content.materials)
    notes = [*reader.notes]
    if content.loose_lines:
        notes.append(f"{path.name} contains points or lines, which are left out.")
    if 0 < len(colors) < len(surface.vertices):
        notes.append(
            f"{path.name} has colors for only {len(colors):,} of {len(surface.vertices):,} vertices: they are left out."
        )
    return Asset(surface, tuple(attributes), materials, notes=tuple(notes))


class _MaterialReader:
    """Reads .mtl files and their images.

    Args:
        folders: further folders in which they may be.

    Attributes:
        materials: the materials by name.
        notes: sentences about files that could not be read.
    """

    def __init__(self, folders: tuple[Path, ...]) -> None:
        self.materials: dict[str, Material] = {}
        self.notes: list[str] = []
        self._folders, self._images = folders, dict[Path, bytes | None]()

    def read(self, name: str, folder: Path) -> None:
        """Read a .mtl file by the name that an OBJ file in a folder gives it."""
        try:
            path = beside(name, folder, self._folders)
            content = read_whole(path)
        except OutsideError:
            self._note(f"The material file {shown(name)} is outside the folder of the file, and was not read.")
            return
        except OSError as error:
            self._note(f"The material file {shown(name)} could not be opened ({error.strerror}), and was left out.")
            return
        material, color, image = None, [1.0, 1.0, 1.0, 1.0], None
        for keyword, line in [*statements(content), ("newmtl", "")]:
            words = line.split()[1:]
            if keyword == "newmtl":
                if material is not None:
                    rgba = color[0], color[1], color[2], color[3]
                    self.materials[material] = Material(material, rgba, image)
                material, color, image = " ".join(words), [1.0, 1.0, 1.0, 1.0], None
            elif keyword == "Kd" and len(words) >= 3:
                color[:3] = self._numbers(words[:3], material) or color[:3]
            elif keyword == "d" and words:
                color[3:] = self._numbers(words[-1:], material) or color[3:]
            elif keyword == "map_Kd" and words:
                image = self._image(words, path.parent)

    def _numbers(self, words: list[str], material: str | None) -> list[float]:
        """The numbers of a statement; none, with a note, if it has others, such as the name of a spectrum."""
        with suppress(ValueError):
            found = [float(word) for word in words]
            if np.isfinite(found).all():
                return found
        self._note(f"The colour of the material {shown(material or '')} is not made of numbers, and was left out.")
        return []

    def _image(self, words: list[str], folder: Path) -> bytes | None:
        """The image that a statement names; options precede the name, which may have spaces."""
        for name in dict.fromkeys((" ".join(words), words[-1])):
            try:
                path = beside(name, folder, self._folders)
                if path not in self._images:
                    self._images[path] = self._check(name, read_whole(path))
                return self._images[path]
            except OutsideError:
                why = "is outside the folder of the file, and was not read"
            except OSError as error:
                why = f"could not be opened ({error.strerror}), and was left out"
        self._note(f"The image {shown(words[-1])} {why}.")
        return None

    def _check(self, name: str, content: bytes) -> bytes | None:
        if image_type(content) is not None:
            return content
        self._note(f"The image {shown(name)} is not an image of a known type, and was left out.")
        return None

    def _note(self, sentence: str) -> None:
        if sentence not in self.notes:
            self.notes.append(sentence)


def write_obj(asset: Asset, path: Path) -> tuple[str, ...]:
    """Write an OBJ file with its .mtl file and images; data that the format cannot store is reported in the notes."""
    surface, text = asset.surface, io.StringIO()
    uv, color, normals = (asset.find(name) for name in (f"{UV} 0", f"{COLOR} 0", NORMALS))
    materials = asset.find(MATERIALS) if asset.materials else None
    names = _distinct([material.name for material in asset.materials])
    place = path.with_name(f"{one_line(path.stem)}.mtl")
    if materials is not None:
        text.write(f"mtllib {place.name}\n")
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
    _write_faces(text, surface.face_start, np.stack(indices, axis=1), names, materials)
    _write_lines(path, text.getvalue())
    if materials is not None:
        _write_mtl(asset.materials, names, place)
    return _notes(asset, names if materials is not None else [])


def _write_lines(path: Path, text: str) -> None:
    """Write text, the same in each locale and system."""
    path.write_text(text, encoding="utf-8", newline="\n")


def _distinct(names: Sequence[str]) -> list[str]:
    """The names of materials as the format can store them: each on one line, and no two alike."""
    found: dict[str, None] = {}
    for name in map(one_line, names):
        other, number = name, 1
        while other in found:
            other, number = f"{name}.{number:03}", number + 1
        found[other] = None
    return list(found)


def _write_faces(
    text: io.StringIO, face_start: Integers, indices: Integers, names: Sequence[str], materials: Attribute | None
) -> None:
    """Write the faces with their corners (c, 3), grouped by material."""
    corners = ["/".join(str(each + 1) if each >= 0 else "" for each in row).rstrip("/") for row in indices.tolist()]
    faces = [" ".join(corners[start:end]) for start, end in pairwise(face_start)]
    number = np.full(len(faces), -1) if materials is None else np.asarray(materials.values)
    for material in np.unique(number):
        if material >= 0:
            text.write(f"usemtl {names[material]}\n")
        text.writelines(f"f {faces[face]}\n" for face in np.flatnonzero(number == material))


def _write_mtl(materials: Sequence[Material], names: Sequence[str], path: Path) -> None:
    lines = []
    for number, (material, name) in enumerate(zip(materials, names, strict=True)):
        lines += [
            f"newmtl {name}",
            "Kd {:.6g} {:.6g} {:.6g}".format(*material.color),
            f"d {material.color[3]:.6g}",
        ]
        kind = None if material.image is None else image_type(material.image)
        if material.image is not None and kind is not None:
            image = path.with_name(f"{path.stem}_{number}{kind.suffix}")
            image.write_bytes(material.image)
            lines.append(f"map_Kd {image.name}")
    _write_lines(path, "\n".join(lines) + "\n")


def _notes(asset: Asset, names: Sequence[str]) -> tuple[str, ...]:
    several = [
        each.name for each in asset.attributes if each.name.startswith((UV, COLOR)) and not each.name.endswith(" 0")
    ]
    left = [
        *several,
        *(["skin weights"] if asset.skin is not None else []),
        *([SHAPE_KEYS] if asset.find(SHAPE_KEYS) else []),
    ]
    notes = []
    if left:
        notes.append(
            f"OBJ files cannot store {' or '.join(left)}, which were left out: write a .glb file to keep them."
        )
    renamed = [new for material, new in zip(asset.materials, names, strict=False) if material.name != new]
    if renamed:
        notes.append(f"Some names of materials cannot be stored in OBJ files and were changed: {', '.join(renamed)}.")
    return tuple(notes)
