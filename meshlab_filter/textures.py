# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of a layer: images, and texture coordinates that also identify their image."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from zoomout_core.arrays import Bytes, Floats, Integers
from zoomout_core.mesh.formats.ply_files import ply_columns

if TYPE_CHECKING:
    from pymeshlab import Image, Mesh


@dataclass(frozen=True, eq=False)
class Textures:
    """Textures placed side by side, so that a coordinate identifies both the texture and the point in it.

    The core maps each target face to one island, and so to one texture.

    Attributes:
        names: names by index.
        images: images by name; those that are not in the MeshSet are missing.
        numbers: (t,) the indices in use, sorted; -1 for no texture.
        lowest: minimum u of all textures.
        width: distance from one texture to the next: an integer, at least twice the range in use, so that
            coordinates extrapolated beyond an island do not reach the next texture.
    """

    names: tuple[str, ...]
    images: dict[str, Image]
    numbers: Integers
    lowest: float
    width: float

    @classmethod
    def of(cls, names: Sequence[str], images: dict[str, Image], uv: Floats, number: Integers) -> Textures:
        """Build textures from coordinates (3 m, 2) and each triangle's texture index (m,)."""
        lowest, highest = float(np.nanmin(uv[:, 0])), float(np.nanmax(uv[:, 0]))
        return cls(tuple(names), images, np.unique(number), lowest, float(2 * np.ceil(highest - lowest + 1)))

    def in_one_texture(self, uv: Floats, number: Integers) -> Floats:
        """(3 m, 2) coordinates in the row of textures."""
        return uv + np.repeat(np.searchsorted(self.numbers, number), 3)[:, None] * [self.width, 0]

    def by_texture(self, in_one_texture: Floats) -> tuple[Floats, Integers]:
        """(3 m, 2) coordinates within their textures, and (m,) the textures' indices."""
        middle = in_one_texture.reshape(-1, 3, 2)[:, :, 0].mean(axis=1)
        place = np.nan_to_num(np.floor((middle - self.lowest) / self.width + 0.25))
        place = np.clip(place, 0, len(self.numbers) - 1).astype(np.int64)
        return in_one_texture - np.repeat(place, 3)[:, None] * [self.width, 0], self.numbers[place]


def texture_coordinates(mesh: Mesh) -> Floats | None:
    """(3 m, 2) coordinates of the corners of triangles, if need be from vertices; None if all are zero."""
    if mesh.has_wedge_tex_coord():
        coordinates = mesh.wedge_tex_coord_matrix()
    elif mesh.has_vertex_tex_coord():
        coordinates = mesh.vertex_tex_coord_matrix()[mesh.face_matrix().ravel()]
    else:
        return None
    return coordinates if coordinates.any() else None


def texture_numbers(mesh: Mesh) -> tuple[list[str], Integers]:
    """The names of the textures in order, and (m,) the index of each triangle's; only a file has them."""
    import pymeshlab

    scratch = pymeshlab.MeshSet()  # saving from the mesh's own MeshSet would rename the image
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
    """Images as arrays (height, width, channels), top row first, with equal numbers of channels."""
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
    """Convert an array (height, width, channels) to an image of pymeshlab's type."""
    import PIL.Image

    return PIL.Image.fromarray(values)


def save_images(textures: Textures, folder: Path) -> list[str]:
    """Write the images losslessly, and return their names without characters that MeshLab cannot read in a PLY file."""
    names: list[str] = []
    for name in textures.names:
        stem = re.sub(r"[^A-Za-z0-9_.-]", "_", Path(name).stem) or "texture"
        while f"{stem}.png" in names:
            stem += "_"
        names.append(f"{stem}.png")
        if name in textures.images:
            textures.images[name].save(str(folder / names[-1]))
    return names
