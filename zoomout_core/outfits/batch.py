# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress many avatars in many outfits. Each pair of bodies is matched once, and an interrupted run resumes."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from zoomout_core.collection.collection import CollectionResult, match_collection
from zoomout_core.collection.engine import Engine, Failure, InThisProcess, Task, run_tasks
from zoomout_core.collection.pair_map import PairName
from zoomout_core.collection.tasks import place_of_map
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.report.verdict import Verdict
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.messages import message_of
from zoomout_core.outfits.dress_file import AvatarFiles, OutfitName, Worn, dress_file
from zoomout_core.outfits.joint_match import match_by_joints
from zoomout_core.runtime.outputs import atomic_write, is_same_file, make_folder
from zoomout_core.runtime.progress import portion
from zoomout_core.transfer.rigging.joint_map import RiggedBody

# Folders of the results: bodies, and bodies in the shapes of others.
BODIES, FITS = "bodies", "fits"
# Folder of the maps of bodies that were matched by their joints, and of their fits.
BY_JOINTS = "by_joints"
# Fraction of the progress at the end of matching.
MATCHED = 0.4


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
        reasons = " ".join(_naming(name, each) for name, each in failures.items())
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


def _naming(name: str, reason: str) -> str:
    """A reason why a file failed, with the name of the file."""
    return reason if re.search(rf"(?<!\w){re.escape(name)}(?!\w)", reason) else f"{name}: {reason}"


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
