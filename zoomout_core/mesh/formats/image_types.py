# SPDX-License-Identifier: GPL-3.0-or-later
"""Types of image files, recognised by their content, and how glTF stores them."""

from __future__ import annotations

from typing import NamedTuple


class ImageType(NamedTuple):
    """A type of image file.

    Attributes:
        suffix: extension of its files.
        mime: its name in glTF; empty if glTF cannot store it.
        extension: the extension of glTF that textures with such images need; empty for none.
    """

    suffix: str
    mime: str = ""
    extension: str = ""


# The first bytes of each type.
BY_START = {
    b"\x89PNG\r\n\x1a\n": ImageType(".png", "image/png"),
    b"\xff\xd8\xff": ImageType(".jpg", "image/jpeg"),
    b"\xabKTX 20\xbb\r\n\x1a\n": ImageType(".ktx2", "image/ktx2", "KHR_texture_basisu"),
    b"DDS ": ImageType(".dds", "image/vnd-ms.dds", "MSFT_texture_dds"),
    b"GIF8": ImageType(".gif"),
    b"BM": ImageType(".bmp"),
    b"II*\0": ImageType(".tif"),
    b"MM\0*": ImageType(".tif"),
    b"v/1\x01": ImageType(".exr"),
    b"#?RADIANCE": ImageType(".hdr"),
}
WEBP = ImageType(".webp", "image/webp", "EXT_texture_webp")
AVIF = ImageType(".avif", "image/avif", "EXT_texture_avif")
TGA = ImageType(".tga")
# Extensions of glTF's textures that refer to an image which programs without the extension cannot read.
TEXTURE_EXTENSIONS = ("EXT_texture_webp", "EXT_texture_avif", "KHR_texture_basisu", "MSFT_texture_dds")


def image_type(content: bytes) -> ImageType | None:
    """The type of an image by its file content; None if it is not an image of a known type."""
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        return WEBP
    if content[4:12] in (b"ftypavif", b"ftypavis"):
        return AVIF
    for start, found in BY_START.items():
        if content.startswith(start):
            return found
    return TGA if _is_targa(content) else None


def _is_targa(content: bytes) -> bool:
    """Whether content has the header of a Targa image.

    This format has no signature, so the ranges of its fields are checked.
    """
    if len(content) < 18:
        return False
    color_map, kind, width, height = content[1], content[2], content[12:14], content[14:16]
    return (
        color_map < 2
        and kind in (1, 2, 3, 9, 10, 11)
        and any(width)
        and any(height)
        and content[16] % 8 == 0 < content[16] <= 32
    )
