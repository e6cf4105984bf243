# SPDX-License-Identifier: GPL-3.0-or-later
"""Images as arrays of texels, and new images from arrays.

Rows go from top to bottom, and there are always four channels. Images of eight bits are bytes, others floats.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np
from bpy.types import Image

import zoomout_core as zo
from zoomout_core.arrays import SingleFloats
from zoomout_core.transfer.uv.texels import Pixels

# The number of the first UDIM tile, and the tiles of a row.
FIRST_TILE, TILES_OF_ROW = 1001, 10
CHANNELS = 4


@dataclass(frozen=True)
class ImageFormat:
    """How the values of an image are stored and read.

    Attributes:
        is_float: whether it has more than eight bits.
        color_space: the name of its color space.
        alpha_mode: how its alpha is read.
    """

    is_float: bool
    color_space: str
    alpha_mode: str


def format_of(image: Image) -> ImageFormat:
    """The format of an image."""
    return ImageFormat(image.is_float, image.colorspace_settings.name, image.alpha_mode)


def read_tiles(image: Image) -> dict[tuple[int, int], Pixels]:
    """The texels (height, width, 4) of each UDIM tile of an image, by its column and row; (0, 0) without tiles.

    Raises:
        MeshError: the image cannot be read.
    """
    if image.source != "TILED":
        return {(0, 0): _read(image)}
    with TemporaryDirectory() as folder:
        found = {}
        for tile in image.tiles:
            loaded = bpy.data.images.load(str(_file_of(image, tile.number, Path(folder))))
            try:
                loaded.colorspace_settings.name = image.colorspace_settings.name
                row, column = divmod(tile.number - FIRST_TILE, TILES_OF_ROW)
                found[column, row] = _read(loaded)
            finally:
                bpy.data.images.remove(loaded)
    return found


def write_image(
    name: str, tiles: Mapping[tuple[int, int], Pixels], form: ImageFormat, folder: Path | None = None
) -> Image:
    """Add an image to the file.

    Args:
        name: its name.
        tiles: texels (height, width, 4) of each tile, by its column and row; an image with (0, 0) alone has no tiles.
        form: its format.
        folder: where to save it; it is packed into the .blend file when not given.

    Raises:
        MeshError: it cannot be saved.
    """
    ending = ".exr" if form.is_float else ".png"
    stem = bpy.path.clean_name(name)
    with TemporaryDirectory() as temporary:
        place = Path(temporary) if folder is None else folder
        if list(tiles) == [(0, 0)]:
            image = _new(name, tiles[0, 0], form)
            if folder is None:
                image.pack()
            else:
                _save(image, place / f"{stem}{ending}")
            return image
        for (column, row), texels in tiles.items():
            number = FIRST_TILE + TILES_OF_ROW * row + column
            tile = _new(name, texels, form)
            _save(tile, place / f"{stem}.{number}{ending}")
            bpy.data.images.remove(tile)
        first, *others = sorted(FIRST_TILE + TILES_OF_ROW * row + column for column, row in tiles)
        image = bpy.data.images.load(str(place / f"{stem}.{first}{ending}"))
        image.name, image.source = name, "TILED"
        image.filepath_raw = str(place / f"{stem}.<UDIM>{ending}")
        image.tiles[0].number = first
        for number in others:
            image.tiles.new(number)
        _apply(image, form)
        if folder is None:
            image.pack()
    return image


def move_images(images: Iterable[Image], folder: Path) -> None:
    """Move the files of images, all in one folder with no others, to another one, which is made if it is missing.

    Raises:
        MeshError: they cannot be moved; nothing was.
    """
    images = list(images)
    files = [*Path(images[0].filepath_raw).parent.iterdir()]
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise folder_error(folder) from error
    for name in sorted(file.name for file in files if (folder / file.name).is_dir()):
        raise _save_error(name, folder)
    for file in files:
        os.replace(file, folder / file.name)
    for image in images:
        image.filepath_raw = str(folder / Path(image.filepath_raw).name)


def folder_error(folder: Path) -> zo.MeshError:
    """The error that a folder for images cannot be made."""
    return zo.MeshError("The folder {folder} cannot be made: pack the images instead.", folder=str(folder))


def _save_error(name: str, folder: Path) -> zo.MeshError:
    return zo.MeshError(
        "The image '{name}' cannot be saved: check its folder, {folder}.", name=name, folder=str(folder)
    )


def _read(image: Image) -> Pixels:
    width, height = image.size
    channels = image.channels
    if not width or not height or not channels:
        raise zo.MeshError("The image '{name}' has no data: find its missing file, or remove it.", name=image.name)
    values: SingleFloats = np.empty(width * height * channels, dtype=np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(height, width, channels)[::-1]
    whole: Pixels = np.ones((height, width, CHANNELS), dtype=np.float32 if image.is_float else np.uint8)
    if not image.is_float:
        whole *= 255
        values = np.rint(255 * np.clip(values, 0, 1))
    color = channels if channels >= 3 else 1
    whole[:, :, : max(color, 3)] = values[:, :, :color]
    return whole


def _file_of(image: Image, number: int, folder: Path) -> Path:
    """The file of a tile; that of a packed one is written to a folder."""
    row, column = divmod(number - FIRST_TILE, TILES_OF_ROW)
    for packed in image.packed_files:
        if str(number) in Path(packed.filepath).name or len(image.tiles) == 1:
            path = folder / Path(packed.filepath.replace("\\", "/")).name
            path.write_bytes(packed.packed_file.data)
            return path
    named = bpy.path.abspath(image.filepath_raw, library=image.library)
    path = Path(named.replace("<UDIM>", str(number)).replace("<UVTILE>", f"u{column + 1}_v{row + 1}"))
    if not path.is_file():
        raise zo.MeshError(
            "The tile {number} of the image '{name}' has no file: save the image first.",
            number=str(number),
            name=image.name,
        )
    return path


def _new(name: str, texels: Pixels, form: ImageFormat) -> Image:
    height, width, _ = texels.shape
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=form.is_float)
    _apply(image, form)
    values = texels[::-1].astype(np.float32)
    if not form.is_float:
        values /= 255
    image.pixels.foreach_set(values.ravel())
    image.update()
    return image


def _apply(image: Image, form: ImageFormat) -> None:
    image.colorspace_settings.name = form.color_space
    image.alpha_mode = form.alpha_mode


def _save(image: Image, path: Path) -> None:
    image.filepath_raw = str(path)
    image.file_format = "OPEN_EXR" if path.suffix == ".exr" else "PNG"
    try:
        image.save()
    except RuntimeError as error:
        raise _save_error(image.name, path.parent) from error
