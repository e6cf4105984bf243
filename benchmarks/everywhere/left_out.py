# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs that set no number of a verdict: other characters, bodies, poses, frames, voxels and species.

`frames`: a character of many parts, and one skin around it in another frame, of other voxels.
`bodies`: bodies whose limbs touch, of other builds.
`builds`: a game character as one skin, and a MakeHuman body of another build or topology.
`crossed`: two game characters, both as one skin.
`animals`: animals and dinosaurs as one skin.
`whole`: scanned people and animals, and gorillas with men, in pairs that no list has.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.characters.cases import spread, surface_of
from benchmarks.datasets import CORRESPONDENCE, load_pair, pair_names
from benchmarks.everywhere.cases import (
    Case,
    Maker,
    case_of_bodies,
    character_as_skin,
    limbs_of_body,
    other_case,
    read_module,
    rig_of_body,
    skin_case,
    touching_case,
)
from benchmarks.everywhere.touching import ALL_POSES

LEFT_OUT = FRAMES, BODIES, BUILDS, CROSSED, ANIMALS, WHOLE = "frames", "bodies", "builds", "crossed", "animals", "whole"
# Ranks of frames by their bend, each with the widths of a voxel over the longest extent.
IN_FRAMES = ((0.5, (1 / 120, 1 / 85)), (0.8, (1 / 160, 1 / 85)))
# Builds that are posed, and the builds and topologies that bodies and characters are matched with.
POSED = ("man", "slim_woman", "muscular_man", "curvy_woman")
ONTO = (
    ("broad_man", "base"),
    ("child", "male1591"),
    ("curvy_woman", "female_generic"),
    ("man", "base"),
    ("heavy_man", "female_generic"),
    ("slim_woman", "male1591"),
)
PEOPLE = "modular_men", "modular_women", "single_knight_pack", "ultimate_space_pack", "cyberpunk_pack"
BEASTS = "animals_pack", "dinosaurs_pack"
# Places in the list of people, or of beasts, between the two of a pair.
FAR, STEPS = 8, (1, 4)
# Sets, the number of their pairs, and the seed that draws these.
SETS, SEED = (("faust_r", 6), ("shrec19_r", 8), ("smal_r", 10), ("tosca_nonisometric", 6)), 35


def cases_left_out(data: Path, max_count: int | None) -> Iterator[Case]:
    """All cases whose files a data folder has, or about `max_count` of each kind, evenly spread."""
    packs = data / "characters" / "game"
    moving = [path for path in sorted(packs.glob("*/*.glb")) if not path.parent.name.startswith("modular")]
    people = [path for pack in PEOPLE for path in sorted((packs / pack).glob("*.glb")) if "Enemy" not in path.name]
    beasts = [path for pack in BEASTS for path in sorted((packs / pack).glob("*.glb"))]
    sets = [(data / name, count) for name, count in SETS if (data / name / CORRESPONDENCE).is_file()]
    kinds: dict[str, list[Maker]] = {
        FRAMES: [partial(skin_case, path, True, voxels, bend) for path, (bend, voxels) in product(moving, IN_FRAMES)],
        CROSSED: [partial(_cross, path, people[(i + FAR) % len(people)]) for i, path in enumerate(people)],
        ANIMALS: [
            partial(_cross, path, beasts[(i + step) % len(beasts)])
            for step, (i, path) in product(STEPS, enumerate(beasts))
        ],
        WHOLE: [partial(_whole, folder, *pair) for folder, count in sets for pair in _draw_unlisted(folder, count)],
    }
    if (data / "clothes" / "bodies.npz").exists():
        clothes = read_module(data / "clothes" / "clothes.py")
        kinds[BODIES] = [
            partial(touching_case, clothes, pose, build, *ONTO[(3 * i + j) % len(ONTO)], is_source=bool(i % 2))
            for (i, pose), (j, build) in product(enumerate(ALL_POSES), enumerate(POSED))
        ]
        kinds[BUILDS] = [
            partial(other_case, clothes, path, *ONTO[(2 * i + j) % len(ONTO)])
            for (i, path), j in product(enumerate(people), range(2))
        ]
    for kind, makers in kinds.items():
        for make in spread(makers, max_count):
            case = make()
            if case is not None:
                yield replace(case, kind=kind)


def _cross(source_path: Path, target_path: Path) -> Case | None:
    source, target = character_as_skin(source_path), character_as_skin(target_path)
    if source is None or target is None:
        return None
    source_skin, target_skin = surface_of(source[1]), surface_of(target[1])
    limbs = limbs_of_body(*source), limbs_of_body(*target)
    name = " to ".join(f"{character.pack} {character.name}" for character, _ in (source, target))
    return case_of_bodies(CROSSED, name, source_skin, target_skin, *limbs, rig_of_body(*source))


def _whole(folder: Path, target_name: str, source_name: str) -> Case:
    pair = load_pair(folder, target_name, source_name)
    limbs = (np.zeros(len(pair.source.vertices), dtype=np.int64), np.zeros(len(pair.target.vertices), dtype=np.int64))
    image = np.full(len(pair.target.vertices), -1)
    image[pair.target_vertex] = pair.source_vertex
    name = f"{folder.name} {source_name} to {target_name}"
    return replace(case_of_bodies(WHOLE, name, pair.source, pair.target, *limbs, None), image=image)


def _draw_unlisted(folder: Path, count: int) -> list[tuple[str, str]]:
    """Random pairs of a set's shapes of one correspondence that its list lacks."""
    listed = set(pair_names(folder, None))
    names = sorted({name for pair in listed for name in pair})
    others = [pair for pair in product(names, names) if pair[0] != pair[1] and pair not in listed]
    chosen = np.random.default_rng(SEED).choice(len(others), min(count, len(others)), replace=False)
    return [others[i] for i in sorted(chosen.tolist())]
