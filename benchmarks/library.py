# SPDX-License-Identifier: GPL-3.0-or-later
"""Search in a library of game characters and bodies: the right asset and family for posed and remeshed queries."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.characters.cases import is_broken, surface_of
from benchmarks.characters.game import Body, one_skin, read_character, shuffle
from benchmarks.characters.skeleton import Skeleton
from benchmarks.datasets import evenly
from benchmarks.generate.things import THINGS, thing
from benchmarks.outfits.clothes import Wardrobe
from benchmarks.tables import NOT_SHOWN, Record, Tables, over
from zoomout_core.assets.files import read_asset
from zoomout_core.library.bodies import LibraryAsset
from zoomout_core.library.library import Library
from zoomout_core.library.search import search
from zoomout_core.matching.report.verdict import VERDICT
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.mesh.surface import Surface
from zoomout_core.outfits.parts import keep_faces, mask_of
from zoomout_core.transfer.rigging.poses import POSES, extreme_poses
from zoomout_core.tuning import retune

# The families of characters, by pack or by file; each other character is a separate family.
PEOPLE, ANIMALS, DINOSAURS, ROBOTS, THING = "people", "animals", "dinosaurs", "robots", "things"
FAMILIES = {
    "modular_men": PEOPLE,
    "modular_women": PEOPLE,
    "single_knight_pack": PEOPLE,
    "ultimate_space_pack": PEOPLE,
    "clothes": PEOPLE,
    "cyberpunk_pack/Character": PEOPLE,
    "cyberpunk_pack": ROBOTS,
    "mech_pack": ROBOTS,
    "animals_pack": ANIMALS,
    "dinosaurs_pack": DINOSAURS,
}
# Packs whose queries set the numbers of the search; all others judge them.
TUNING_PACKS = ("animals_pack", "easy_enemies_pack", "modular_men")
# Kinds of queries: an asset in another pose with fewer faces; the same as one skin of voxels; a body whose own asset is
# left out; a thing, and a character among others than its family, both of which are to be refused; a character with
# the head of another one of its pack; a head, and an upper body, cut out of one skin.
POSED, SKIN, BUILD, STRANGER, TWO = "posed", "one skin", "other build", "stranger", "two sources"
HEAD, UPPER = "head", "upper body"
# Joints that move these parts, with all below them.
PARTS = {HEAD: re.compile(r"(neck|head)\d*", re.IGNORECASE), UPPER: re.compile(r"torso|thorax", re.IGNORECASE)}
# Shares of the vertices of a skin that a part may have; joints without weights, or of the whole body, move none.
PART_SHARES = 0.02, 0.9
# Packs of characters that can exchange heads, which are separate meshes, and the number of files between the two.
MODULAR, HEADS, STEP = ("modular_men", "modular_women"), ("*_Head",), 3
# Degrees by which the joints of these characters rotate.
BEND = 15.0


@dataclass(frozen=True, eq=False)
class Query:
    """A target with the names of its own asset and of that of its head, and the assets to search."""

    kind: str
    name: str
    surface: Surface
    among: Sequence[LibraryAsset]
    head: str = ""


def run(data: Path, pairs: int | None, judging: bool) -> Tables:
    """Search for characters and bodies in a library of all of them.

    `summary`: for each kind of queries, those that set the numbers and those that judge them: the shares whose first
    asset is of the right family, and is the right asset; the share that is refused; how many are wrong with a certainty
    of at least 90 %; seconds per query, of the clock and of the processor. `own part` is the share for which the
    second of two sources is proposed, that of the head or of the body, and `other parts` the number of other proposals.

    `pairs`: a row for each query.

    Args:
        data: a folder with `characters/game` and `clothes`.
        pairs: use this many characters, bodies and things, evenly spread.
        judging: leave out the packs that set the numbers.
    """
    rows: list[Record] = []
    with tempfile.TemporaryDirectory(prefix="zoomout-") as folder:
        assets, preparation = _library(data, Path(folder))
        for query in tqdm(_queries(data, assets, pairs, judging), desc="library", leave=False):
            rows.append(_search(query))
    return {"summary": _summary(rows), "preparation": [preparation], NOT_SHOWN: rows}


def _library(data: Path, folder: Path) -> tuple[list[LibraryAsset], Record]:
    """The prepared assets, and figures of the preparation."""
    bodies = folder / "clothes"
    bodies.mkdir()
    wardrobe = Wardrobe(data / "clothes")
    for build in wardrobe.is_strict:
        write_shape(wardrobe.body(build).surface, bodies / f"{build}.ply")
    libraries = Library(data / "characters" / "game", folder / "index"), Library(bodies)
    begin = perf_counter(), process_time()
    reports = [library.prepare() for library in libraries]
    took = perf_counter() - begin[0], process_time() - begin[1]
    count = sum(report.assets for report in reports)
    size = sum(path.stat().st_size for library in libraries for path in library.index_folder.iterdir())
    figures: Record = {"assets": count, "skipped": sum(len(report.failures) for report in reports)}
    figures |= {"seconds per asset": took[0] / count, "CPU": took[1] / count, "kB per asset": size / count / 1000}
    return [asset for library in libraries for asset in library.assets()], figures


def name_of(path: Path) -> str:
    """The name of an asset or a query: its pack and its file."""
    return f"{path.parent.name}/{path.stem}"


def family_of(name: str) -> str:
    """The family of an asset, by its name."""
    return FAMILIES.get(name, FAMILIES.get(name.partition("/")[0], name))


def _queries(data: Path, assets: list[LibraryAsset], count: int | None, judging: bool) -> Iterator[Query]:
    files = sorted((data / "characters" / "game").glob("*/*.glb"))
    files = [path for path in files if not (judging and path.parent.name in TUNING_PACKS)]
    for path in evenly(files, count):
        character = read_character(path)
        if not is_broken(character):
            yield Query(POSED, name_of(path), surface_of(shuffle(character.thinned)), assets)
            skin = one_skin(character.posed)
            yield Query(SKIN, name_of(path), surface_of(shuffle(skin)), assets)
            for kind, part in _parts(skin, character.skeleton):
                yield Query(kind, name_of(path), part, assets)
            strangers = [asset for asset in assets if family_of(name_of(asset.path)) != family_of(name_of(path))]
            yield Query(STRANGER, name_of(path), surface_of(character.posed), strangers)
    for pack in MODULAR:
        if judging and pack in TUNING_PACKS:
            continue
        pool = sorted((data / "characters" / "game" / pack).glob("*.glb"))
        for number, path in enumerate(evenly(pool, count)):
            head = pool[(pool.index(path) + STEP) % len(pool)]
            yield Query(TWO, name_of(path), _with_head(path, head, number), assets, name_of(head))
    wardrobe = Wardrobe(data / "clothes")
    for number, build in enumerate(evenly(list(wardrobe.is_strict), count)):
        topology = wardrobe.topologies[number % len(wardrobe.topologies)]
        body = wardrobe.body(build, topology)
        pose = body.in_pose(number % len(body.poses), body.surface.vertices, body.weights)
        name, surface = f"clothes/{build}", body.surface.with_vertices(pose)
        yield Query(POSED, name, surface, assets)
        yield Query(BUILD, name, surface, [asset for asset in assets if name_of(asset.path) != name])
    for name in evenly(list(THINGS), count):
        yield Query(STRANGER, f"{THING}/{name}", thing(name), assets)


def _parts(skin: Body, skeleton: Skeleton) -> Iterator[tuple[str, Surface]]:
    """The open parts of a skin by which its character is to be found, as far as it has them."""
    for kind, pattern in PARTS.items():
        moved = np.array([bool(pattern.fullmatch(name)) for name in skeleton.names])
        for bone, parent in enumerate(skeleton.parent):
            moved[bone] |= parent >= 0 and moved[parent]
        inside = skin.weights[:, moved].sum(axis=1) > 0.5
        if PART_SHARES[0] < inside.mean() < PART_SHARES[1]:
            cut = Surface(skin.vertices, skin.triangles[inside[skin.triangles].all(axis=1)])
            largest = cut.components == 0
            kept = cut.triangles[largest[cut.triangles[:, 0]]]
            used, corner = np.unique(kept, return_inverse=True)
            yield kind, Surface(cut.vertices[used], corner.reshape(-1, 3))


def _with_head(body: Path, head: Path, number: int) -> Surface:
    """A character with the head of another one with the same joints, in one of the poses of extreme joints."""
    parts = []
    for path, is_head in ((body, False), (head, True)):
        asset = read_asset(path)
        first = asset.surface.corner_vertex[asset.surface.face_start[:-1]]
        parts.append(keep_faces(asset, (mask_of(asset, HEADS)[first] > 0) == is_head))
    skins = [part.skin for part in parts if part.skin is not None]
    with retune(POSES, angle=BEND):
        poses = extreme_poses(np.linalg.inv(skins[0].inverse_bind)[:, :3, 3], skins[0].parents)
    posed = [
        part.surface.with_vertices(
            transform_points(blend_matrices(poses[number % len(poses)], skin.weights), skin.rest)
        )
        for part, skin in zip(parts, skins, strict=True)
    ]
    return Surface.joined(posed)


def _search(query: Query) -> Record:
    zo.forget_shapes()
    begin = perf_counter(), process_time()
    found = search(query.surface, query.among)
    took = perf_counter() - begin[0], process_time() - begin[1]
    first = found.ranked[0] if found.ranked else None
    name = "" if first is None else name_of(first.path)
    right = bool(name) and family_of(name) == family_of(query.name)
    sure = found.best is not None and found.best.certainty >= VERDICT.certain
    own = any(name_of(asset.path) == query.name for asset in query.among)
    row: Record = {"kind": query.kind, "query": query.name, "first": name, "refused": bool(found.refusal)}
    part = "" if found.part is None else name_of(found.part.path)
    sources = {query.name, query.head} - {name}
    row |= {"own part": part in sources if query.head else None, "other parts": bool(part) and part not in sources}
    row |= {"set": "tuning" if query.name.partition("/")[0] in TUNING_PACKS else "judging"}
    row |= {"family": right, "asset": name == query.name if own else None, "certain and wrong": sure and not right}
    row |= {"misfit": None if first is None else first.misfit, "certainty": None if first is None else first.certainty}
    return row | {"difference": None if first is None else first.difference, "seconds": took[0], "CPU": took[1]}


def _summary(rows: list[Record]) -> list[Record]:
    found = []
    for kind in (POSED, SKIN, HEAD, UPPER, BUILD, STRANGER, TWO):
        for role in ("tuning", "judging"):
            chosen = [row for row in rows if (row["kind"], row["set"]) == (kind, role)]
            if not chosen:
                continue
            shares = {name: over(np.mean, chosen, name) for name in ("family", "asset", "refused", "own part")}
            row: Record = {"queries": f"{kind}, {role}", "count": len(chosen)}
            row |= shares if kind != STRANGER else {"refused": shares["refused"]}
            row |= {name: sum(row[name] for row in chosen) for name in ("certain and wrong", "other parts")}
            found.append(row | {name: float(np.mean([row[name] for row in chosen])) for name in ("seconds", "CPU")})
    return found
