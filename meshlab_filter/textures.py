# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of a layer: their images, and texture coordinates that identify the image they refer to."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from zoomout_core.arrays import Bytes, Floats, Integers
from zoomout_core.mesh.ply_files import ply_columns

if TYPE_CHECKING:
    from pymeshlab import Image, Mesh


@dataclass(frozen=True, eq=False)
class Textures:
    """Textures, placed side by side, so that one coordinate identifies both the texture and the place in it.

    The core maps each target face into one island, and so into one texture.

    Attributes:
        names: by number.
        images: by name; what the MeshSet does not hold is missing.
        numbers: (t,) the numbers that are in use, rising; -1 stands for no texture.
        lowest: smallest u of any texture.
        width: distance from one texture to the next: whole tiles, and twice what is in use, so that
            coordinates that are continued beyond an island do not reach the next texture.
    """

    names: tuple[str, ...]
    images: dict[str, Image]
    numbers: Integers
    lowest: float
    width: float

    @classmethod
    def of(cls, names: Sequence[str], images: dict[str, Image], uv: Floats, number: Integers) -> Textures:
        """Textures whose coordinates (3 m, 2) and numbers, of each triangle (m,), are these."""
        lowest, highest = float(np.nanmin(uv[:, 0])), float(np.nanmax(uv[:, 0]))
        return cls(tuple(names), images, np.unique(number), lowest, float(2 * np.ceil(highest - lowest + 1)))

    def in_one_texture(self, uv: Floats, number: Integers) -> Floats:
        """(3 m, 2) coordinates that identify the texture as well."""
        return uv + np.repeat(np.searchsorted(self.numbers, number), 3)[:, None] * [self.width, 0]

    def by_texture(self, in_one_texture: Floats) -> tuple[Floats, Integers]:
        """(3 m, 2) coordinates within their textures, and (m,) the numbers of these."""
        middle = in_one_texture.reshape(-1, 3, 2)[:, :, 0].mean(axis=1)
        place = np.nan_to_num(np.floor((middle - self.lowest) / self.width + 0.25))
        place = np.clip(place, 0, len(self.numbers) - 1).astype(np.int64)
        return in_one_texture - np.repeat(place, 3)[:, None] * [self.width, 0], self.numbers[place]


def texture_coordinates(mesh: Mesh) -> Floats | None:
    """(3 m, 2) of the corners of triangles, those of vertices if need be; nothing where all are zero."""
    if mesh.has_wedge_tex_coord():
        coordinates = mesh.wedge_tex_coord_matrix()
    elif mesh.has_vertex_tex_coord():
        coordinates = mesh.vertex_tex_coord_matrix()[mesh.face_matrix().ravel()]
    else:
        return None
    return coordinates if coordinates.any() else None


def texture_numbers(mesh: Mesh) -> tuple[list[str], Integers]:
    """The names of the textures in order, and (m,) the number of each triangle's: to be had from a file only."""
    import pymeshlab

    scratch = pymeshlab.MeshSet()  # saving from the mesh's own MeshSet would rename it
    scratch.add_mesh(mesh)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "textures.ply"
        scratch.save_current_mesh(str(path), save_textures=False)
        content = path.read_bytes()
    header = content.partition(b"end_header")[0].decode("utf-8", errors="replace")
    names = re.findall(r"^comment TextureFile (.*?)\r?$", header, re.MULTILINE)
    number = ply_columns(content)["face"].get("texnumber", np.zeros(mesh.face_number()))
    return names, np.asarray(number, dtype=np.int64)


def pixels(images: Sequence[Image]) -> list[Bytes]:
    """Images as arrays (height, width, channels), from the top row to the bottom one, of as many channels all."""
    import PIL.Image

    opened = []
    for image in images:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "image.png"
            image.save(str(path))
            with PIL.Image.open(path) as read:
                read.load()
                opened.append(read)
    see_through = any(image.has_transparency_data for image in opened)
    return [np.asarray(image.convert("RGBA" if see_through else "RGB")) for image in opened]


def image_of(values: Bytes) -> Any:
    """An image of an array (height, width, channels), to be saved as those of pymeshlab are."""
    import PIL.Image

    return PIL.Image.fromarray(values)


def save_images(textures: Textures, folder: Path) -> list[str]:
    """Write the images without loss, and return their names, free of what MeshLab cannot read in a PLY file."""
    names: list[str] = []
    for name in textures.names:
        stem = re.sub(r"[^A-Za-z0-9_.-]", "_", Path(name).stem) or "texture"
        while f"{stem}.png" in names:
            stem += "_"
        names.append(f"{stem}.png")
        if name in textures.images:
            textures.images[name].save(str(folder / names[-1]))
    return names
