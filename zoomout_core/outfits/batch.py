# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress many avatars in many outfits. Each pair of bodies is matched once, and an interrupted run resumes."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from zoomout_core.arrays import Integers
from zoomout_core.assets.files import inputs_of
from zoomout_core.collection.collection import CollectionResult, match_collection
from zoomout_core.collection.engine import Engine, Failure, InThisProcess, Task, run_tasks
from zoomout_core.collection.pair_map import PairName
from zoomout_core.collection.shapes import content_key
from zoomout_core.collection.tasks import place_of_map
from zoomout_core.drawing import encode_png
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.report.verdict import Verdict, check_verdict, worst
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.mesh.formats.opening import existing, file_bytes
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import from_json, message_of, to_json
from zoomout_core.outfits.check import CheckedOutfit
from zoomout_core.outfits.joint_match import match_by_joints
from zoomout_core.outfits.pictures import draw_outfit
from zoomout_core.runtime.outputs import atomic_write, check_no_input, is_same_file, make_folder, write_whole
from zoomout_core.runtime.progress import portion
from zoomout_core.runtime.version import package_version
from zoomout_core.transfer.rigging.joint_map import RiggedBody

# Folders of the results: bodies, bodies in the shapes of others, dressed avatars, pictures, and records of these.
BODIES, FITS, DRESSED, PICTURES, RECORDS = "bodies", "fits", "dressed", "pictures", "records"
# Folder of the maps of bodies that were matched by their joints, and of their fits.
BY_JOINTS = "by_joints"
# Fraction of the progress at the end of matching.
MATCHED = 0.4


class DressedFile(NamedTuple):
    """An avatar that was dressed, and written to a file."""

    checked: CheckedOutfit  # its clothes
    triangles: tuple[Integers, Integers]  # triangles of the body and of the clothes, see `draw_outfit`
    objects: tuple[tuple[str, int], ...]  # the name of each worn mesh, and the number of its vertices
    joints: int  # number of the outfit's own joints
    notes: tuple[str, ...]  # sentences for the user
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


@dataclass(frozen=True, eq=False)
class OutfitsResult:
    """The outfits on avatars.

    Attributes:
        folder: folder of the results.
        worn: the fit of each outfit to each avatar.
        failures: reasons for failures, by the name of a file or of an outfit on an avatar.
        matched: the number of pairs of bodies that were matched in this run.
        dressed: the number of avatars that were written in this run.
    """

    folder: Path
    worn: dict[OutfitName, Worn]
    failures: dict[str, str]
    matched: int
    dressed: int


def dress_all(
    outfits: Sequence[Path],
    avatars: Sequence[Path],
    folder: Path,
    files: AvatarFiles,
    options: MatchOptions,
    *,
    cache: Path | None = None,
    engine: Engine | None = None,
) -> OutfitsResult:
    """Dress each avatar in each outfit, and write it to `dressed/AVATAR/OUTFIT` in a folder.

    Args:
        outfits: files of dressed avatars.
        avatars: files of avatars to dress; they keep their own clothes.
        folder: folder of the results, created if missing.
        files: their format, and options of the fit.
        options: options of every match.
        cache: folder of prepared bodies.
        engine: runs the tasks; None for this process.

    Raises:
        MeshError: no outfit can be put on any avatar.
    """
    engine = InThisProcess() if engine is None else engine
    names, failures = _names([*outfits, *avatars]), dict[str, str]()
    earlier = set((folder / BODIES).glob("*"))
    bodies = _write_bodies(outfits, avatars, names, folder, files, failures)
    wanted = [
        (outfit, avatar)
        for outfit in outfits
        for avatar in avatars
        if names[outfit] in bodies and names[avatar] in bodies and not is_same_file(outfit, avatar)
    ]
    if not wanted:
        _remove_bodies(folder / BODIES, earlier)
        reasons = " ".join(each if name in each else f"{name}: {each}" for name, each in failures.items())
        raise MeshError(reasons or "Every outfit is that of the only avatar: give other outfits or avatars.")
    with portion(0, MATCHED):
        matches = _match_bodies(wanted, names, bodies, folder, options, cache, engine)
        by_joints = _match_by_joints(wanted, names, bodies, folder, files, matches)
    tasks, pairs = [], dict[str, OutfitName]()
    for outfit, avatar in wanted:
        name = OutfitName(names[outfit], names[avatar])
        pair = PairName(bodies[name.outfit].stem, bodies[name.avatar].stem)
        place, verdict = by_joints.get(pair, (folder / place_of_map(pair), _verdict(matches, pair)))
        if isinstance(verdict, str):
            failures[str(name)] = verdict
            continue
        paths = outfit.absolute(), avatar.absolute(), place.absolute(), folder.absolute()
        arguments = *paths, name, files, verdict
        tasks.append(Task(str(name), dress_file, arguments))
        pairs[str(name)] = name
    worn, dressed = dict[OutfitName, Worn](), 0
    with portion(MATCHED, 1):
        for done in run_tasks(engine, tasks, lambda ended: f"Dressing {ended} of {len(tasks)}"):
            if isinstance(done.result, Failure):
                failures[done.key] = done.result.message
            else:
                worn[pairs[done.key]], is_new = done.result
                dressed += is_new
    return OutfitsResult(folder, worn, failures, matches.matched, dressed)


def _names(files: Iterable[Path]) -> dict[Path, str]:
    """A name for each file: without its extension, unless two names would be equal."""
    found: dict[Path, str] = {}
    for path in files:
        taken = set(found.values()) - {found.get(path)}
        name = path.stem if path.stem not in taken else path.name
        if path not in found and name in taken:
            raise MeshError(f"Two files are called {path.name}: rename one of them.")
        found.setdefault(path, name)
    return found


def _write_bodies(
    outfits: Sequence[Path],
    avatars: Sequence[Path],
    names: Mapping[Path, str],
    folder: Path,
    files: AvatarFiles,
    failures: dict[str, str],
) -> dict[str, Path]:
    """Write the body of each file; outfits or avatars with the same body share its file."""
    place = folder / BODIES
    found, known = dict[str, Path](), dict[tuple[bool, bytes], Path]()
    wearing = set(outfits)
    for path in dict.fromkeys([*outfits, *avatars]):
        try:
            body = files.read_body(path, path in wearing)
        except (MeshError, ImportError) as error:
            failures[names[path]] = message_of(error)
            continue
        made = place / f"{names[path]}.ply"
        make_folder(place)
        with atomic_write(made) as part:
            write_shape(body, part)
        first = known.setdefault((path in wearing, made.read_bytes()), made)
        if first != made:
            made.unlink()
        found[names[path]] = first
    return found


def _remove_bodies(place: Path, kept: Collection[Path]) -> None:
    """Remove the files of bodies that are not kept, and the folder if it is empty then."""
    for path in set(place.glob("*")).difference(kept):
        path.unlink()
    if not kept and place.exists():
        place.rmdir()


def _match_bodies(
    wanted: Sequence[tuple[Path, Path]],
    names: Mapping[Path, str],
    bodies: Mapping[str, Path],
    folder: Path,
    options: MatchOptions,
    cache: Path | None,
    engine: Engine,
) -> CollectionResult:
    """Match each pair of bodies once."""
    pairs = list(dict.fromkeys((bodies[names[outfit]].stem, bodies[names[avatar]].stem) for outfit, avatar in wanted))
    files = [path for path in dict.fromkeys(bodies.values()) if any(path.stem in pair for pair in pairs)]
    return match_collection(files, folder, pairs=pairs, options=options, engine=engine, cache=cache, agree=False)


def _match_by_joints(
    wanted: Sequence[tuple[Path, Path]],
    names: Mapping[Path, str],
    bodies: Mapping[str, Path],
    folder: Path,
    files: AvatarFiles,
    matches: CollectionResult,
) -> dict[PairName, tuple[Path, Verdict]]:
    """Match bodies by the joints of their rigs where the match of their shapes is uncertain and confuses limbs.

    Returns:
        For each of these pairs the file of the map, and the verdict on it.
    """
    found = dict[PairName, tuple[Path, Verdict]]()
    seen = set[PairName]()
    for outfit, avatar in wanted:
        pair = PairName(bodies[names[outfit]].stem, bodies[names[avatar]].stem)
        if pair in seen or pair not in matches.records:
            continue
        seen.add(pair)
        read = partial(_read_rigged, files, outfit, avatar)
        by_joints = match_by_joints(matches.surface_map(*pair), matches.verdict(pair).level, read)
        if by_joints is not None:
            place = folder / BY_JOINTS / place_of_map(pair)
            make_folder(place.parent)
            by_joints.surface_map.save(place)
            found[pair] = place, by_joints.verdict
    return found


def _read_rigged(files: AvatarFiles, outfit: Path, avatar: Path) -> tuple[RiggedBody | None, RiggedBody | None]:
    """The bodies of an outfit and of an avatar, with their bones."""
    return files.read_rigged(outfit, True), files.read_rigged(avatar, False)


def _verdict(matches: CollectionResult, bodies: PairName) -> Verdict | str:
    """The verdict on the match of two bodies, or the reason why there is no match."""
    if bodies in matches.records:
        return matches.verdict(bodies)
    names = (str(bodies), *bodies)
    return next((matches.failures[name] for name in names if name in matches.failures), "The bodies were not matched.")


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
