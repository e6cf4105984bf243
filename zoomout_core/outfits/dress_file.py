# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress one avatar in one outfit, from file to file, with a picture and a record of the result."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from zoomout_core.arrays import Integers
from zoomout_core.assets.files import inputs_of
from zoomout_core.collection.shapes import content_key
from zoomout_core.drawing import encode_png
from zoomout_core.matching.report.verdict import GREEN, Verdict, check_verdict, worst
from zoomout_core.mesh.formats.opening import existing, file_bytes
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import from_json, sentences, to_json
from zoomout_core.outfits.check import CheckedOutfit
from zoomout_core.outfits.pictures import draw_outfit
from zoomout_core.runtime.outputs import check_no_input, make_folder, write_whole
from zoomout_core.runtime.version import package_version
from zoomout_core.transfer.rigging.joint_map import RiggedBody

# Folders of the results: dressed avatars, pictures, and records of these.
DRESSED, PICTURES, RECORDS = "dressed", "pictures", "records"


class DressedFile(NamedTuple):
    """An avatar that was dressed, and written to a file."""

    checked: CheckedOutfit  # its clothes
    triangles: tuple[Integers, Integers]  # triangles of the body and of the clothes, see `draw_outfit`
    objects: tuple[tuple[str, int], ...]  # the name of each worn mesh, and the number of its vertices
    joints: int  # number of the outfit's own joints
    notes: tuple[str, ...]  # sentences for the user
    missing_skin: str | None = None  # how clothes without skin below them were placed
    front: float = 0.0  # degrees about the vertical axis from z to the direction that the avatar faces


class AvatarFiles(Protocol):
    """Reads, dresses and writes avatars in files of some formats; its `repr` includes the settings."""

    @property
    def force(self) -> bool:
        """Whether to write avatars even if the match is probably wrong."""
        ...

    def read_body(self, path: Path, wears: bool) -> Surface:
        """Read the body of an avatar, without the parts that it wears.

        Raises:
            MeshError: the file cannot be read, or its body and clothes cannot be distinguished.
        """
        ...

    def read_rigged(self, path: Path, wears: bool) -> RiggedBody | None:
        """Read the same body with its bones; None without any.

        Raises:
            MeshError: as for `read_body`.
        """
        ...

    def ending(self, avatar: Path) -> str:
        """The extension of the file to write for an avatar."""
        ...

    def dress(self, outfit: Path, avatar: Path, map_file: Path, output: Path) -> DressedFile:
        """Dress an avatar in the outfit of another one, along the map of their bodies, and write it.

        Raises:
            MeshError: a file cannot be read or written.
        """
        ...


class OutfitName(NamedTuple):
    """An outfit on an avatar, by the names of their files."""

    outfit: str
    avatar: str

    def __str__(self) -> str:
        return f"{self.outfit} on {self.avatar}"


@dataclass(frozen=True)
class Worn:
    """An outfit on an avatar, as values that JSON can store.

    Attributes:
        key: a hash of the files, the map, the fitting and the version of this package.
        output: the written file, relative to the folder of the results.
        level: level of the verdict.
        sentence: its reason.
        advice: advice for the user.
        inside: the share of the cloth that is in the skin, in each pose.
        stretched: the share of its edges that are stretched.
        objects: names of the worn meshes.
        joints: number of the outfit's own joints.
        notes: sentences for the user.
    """

    key: str
    output: str
    level: str
    sentence: str
    advice: str
    inside: Mapping[str, float]
    stretched: float
    objects: tuple[str, ...]
    joints: int
    notes: tuple[str, ...]

    @property
    def verdict(self) -> Verdict:
        """The verdict on the match and on the clothes."""
        return Verdict(self.level, self.sentence, self.advice)


def dress_file(
    outfit: Path,
    avatar: Path,
    map_file: Path,
    folder: Path,
    name: OutfitName,
    files: AvatarFiles,
    verdict: Verdict,
) -> tuple[Worn, bool]:
    """Dress an avatar in an outfit, and write it with a picture, unless both exist. Returns whether it was new.

    Args:
        outfit: the file of a dressed avatar.
        avatar: the file of the avatar to dress.
        map_file: the map of their bodies.
        folder: folder of the results.
        name: names of both.
        files: their format, and options of the fit.
        verdict: the verdict on the match of the bodies.

    Raises:
        MeshError: a file cannot be read or written, or the match is probably wrong.
    """
    check_verdict(verdict, files.force)
    contents = [content_key(file_bytes(existing(path))) for path in (outfit, avatar, map_file)]
    key = content_key(repr((contents, files, package_version())).encode())
    output = Path(DRESSED) / name.avatar / f"{name.outfit}{files.ending(avatar)}"
    record = folder / RECORDS / name.avatar / f"{name.outfit}.json"
    picture = folder / place_of_picture(name)
    earlier = _read_record(record)
    if earlier is not None and earlier.key == key and (folder / output).is_file() and picture.is_file():
        return earlier, False
    check_no_input(folder / output, inputs_of(outfit, avatar))
    record.unlink(missing_ok=True)  # an interrupted run would leave it beside other files
    make_folder((folder / output).parent)
    made = files.dress(outfit, avatar, map_file, folder / output)
    image = draw_outfit(made.checked, made.triangles, [count for _, count in made.objects], made.front)
    write_whole(picture, encode_png(image))
    level, sentence, advice = worst([verdict, made.checked.verdict])
    if made.missing_skin is not None and level != GREEN:
        sentence = sentences(sentence, made.missing_skin)
    found = Worn(
        key,
        output.as_posix(),
        level,
        str(sentence),
        str(advice),
        made.checked.inside,
        made.checked.stretched,
        tuple(each for each, _ in made.objects),
        made.joints,
        tuple(dict.fromkeys(made.notes)),
    )
    write_whole(record, json.dumps(to_json(asdict(found)), indent=1).encode())
    return found, True


def place_of_picture(name: OutfitName) -> Path:
    """Path of the picture of an outfit on an avatar, in the results."""
    return Path(PICTURES) / name.avatar / f"{name.outfit}.png"


def _read_record(path: Path) -> Worn | None:
    """The record of an earlier run; None if there is none, or it cannot be read."""
    try:
        held: dict[str, Any] = from_json(json.loads(path.read_bytes()))
        return Worn(**{**held, "objects": tuple(held["objects"]), "notes": tuple(held["notes"])})
    except (OSError, ValueError, KeyError, TypeError):
        return None
