# SPDX-License-Identifier: GPL-3.0-or-later
"""Avatars in glTF and VRM files, for `dress_all`."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import Asset
from zoomout_core.assets.files import AVATAR, read_asset
from zoomout_core.assets.gltf.append import append_to_gltf
from zoomout_core.assets.gltf.compress import compress_gltf
from zoomout_core.collection.shapes import content_key
from zoomout_core.maps.known_match import KnownMatch
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.gltf_document import VRM_0
from zoomout_core.mesh.formats.opening import file_bytes
from zoomout_core.mesh.surface import Surface
from zoomout_core.outfits.batch import FITS
from zoomout_core.outfits.check import check_outfit
from zoomout_core.outfits.dress_avatar import dress_avatar
from zoomout_core.outfits.dress_file import DressedFile
from zoomout_core.outfits.parts import split_avatar
from zoomout_core.outfits.rigged_avatar import complete_avatar, rigged_body
from zoomout_core.runtime.array_files import ArrayFileError, read_arrays, write_arrays
from zoomout_core.runtime.outputs import atomic_write, make_folder
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.version import package_version
from zoomout_core.transfer.dressing.dress import check_fit, shape_of_source
from zoomout_core.transfer.dressing.missing_skin import DEPTH
from zoomout_core.transfer.rigging.joint_map import RiggedBody

# Extensions of avatar files.
ENDINGS = (".glb", ".gltf", ".vrm")
# Avatars in VRM 0 face -z, others z: degrees between both.
BACKWARDS = 180.0
# Fraction of the progress of dressing an avatar at the end of shaping the body.
SHAPED = 0.4


@dataclass(frozen=True)
class GltfFiles:
    """`AvatarFiles` for glTF and VRM, and the options of the fit.

    Attributes:
        body: patterns of the names of the parts of bodies, see `split_avatar`.
        keep: patterns of the names of worn parts that keep their form, see `dress_avatar`.
        stiffness: see `dress`.
        gap: see `dress`.
        force: write avatars even if the match is probably wrong.
        compression: how to compress avatars, see `compress_gltf`; VRM files are not compressed.

    Raises:
        ValueError: `stiffness` or `gap` is out of range.
    """

    body: tuple[str, ...] = ()
    keep: tuple[str, ...] = ()
    stiffness: float = 0.5
    gap: float = 0.0
    force: bool = False
    compression: str | None = None

    def __post_init__(self) -> None:
        check_fit(self.stiffness, self.gap)

    def read_body(self, path: Path, wears: bool) -> Surface:
        """See `AvatarFiles`."""
        return self._read_body(path, wears).surface

    def read_rigged(self, path: Path, wears: bool) -> RiggedBody | None:
        """See `AvatarFiles`."""
        return rigged_body(self._read_body(path, wears))

    def ending(self, avatar: Path) -> str:
        """See `AvatarFiles`."""
        return AVATAR if avatar.suffix.lower() == AVATAR else ENDINGS[0]

    def dress(self, outfit: Path, avatar: Path, map_file: Path, output: Path) -> DressedFile:
        """See `AvatarFiles`."""
        source, target = split_avatar(_read(outfit), self.body), _read(avatar)
        body, _ = complete_avatar(split_avatar(target, self.body, wears=False), 0.0)
        wearer, clothed = complete_avatar(source)
        assert source.worn is not None
        assert target.document is not None
        with portion(0, SHAPED):
            shape = _shape_of_source(map_file, wearer.surface, body.surface)
        with portion(SHAPED, 1):
            made = dress_avatar(
                shape,
                wearer,
                source.worn,
                body,
                clothed=clothed,
                keep=self.keep,
                stiffness=self.stiffness,
                gap=self.gap,
            )
        with atomic_write(output) as part:
            left_out = append_to_gltf(target.document, made.joints, made.clothes, part, made.partners)
            if self.compression is not None and output.suffix != AVATAR:
                compress_gltf(part, self.compression)
        return DressedFile(
            check_outfit(wearer.surface, source.worn.surface, made, body),
            (body.surface.triangles, made.clothes.surface.triangles),
            made.clothes.objects,
            len(made.joints),
            (*made.notes, *left_out),
            made.missing_skin,
            BACKWARDS if VRM_0 in (target.document.gltf.extensions or {}) else 0.0,
        )

    def _read_body(self, path: Path, wears: bool) -> Asset:
        """Read the body of an avatar, completed by clothes without skin below them."""
        parts = split_avatar(_read(path), self.body, wears=wears)
        return complete_avatar(parts, DEPTH if wears else 0.0)[0]


def _read(path: Path) -> Asset:
    """Read an avatar.

    Raises:
        MeshError: it cannot be read, or is of another format.
    """
    if path.suffix.lower() not in ENDINGS:
        raise MeshError(f"{path} is no glTF or VRM file: export it as one, or run blender --command zoomout outfits.")
    return read_asset(path)


def _shape_of_source(map_file: Path, source: Surface, target: Surface) -> Floats:
    """(n, 3) the vertices of a body in the shape of another one, computed once for each map and cached in a file."""
    place = map_file.parents[2] / FITS / map_file.parent.name / map_file.name
    key = bytes.fromhex(content_key(repr((file_bytes(map_file), package_version())).encode()))
    with suppress(FileNotFoundError, ArrayFileError, KeyError):
        known = read_arrays(place)
        if known["key"].tobytes() == key and known["shape"].shape == source.vertices.shape:
            return np.asarray(known["shape"])
    shape = shape_of_source(KnownMatch.load(map_file, source, target), source, target)
    make_folder(place.parent)
    with atomic_write(place) as part:
        write_arrays(part, {"key": np.frombuffer(key, np.uint8), "shape": shape})
    return shape
