# SPDX-License-Identifier: GPL-3.0-or-later
"""Characters as cases of symmetry, with the true self-map by the names of bones or by places at rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from time import perf_counter

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.characters.cases import Case, Maker, is_broken, outfit, spread, surface_of
from benchmarks.characters.figures import dominant, figures
from benchmarks.characters.game import Character, read_character
from benchmarks.characters.table import Row, over
from benchmarks.characters.truth import Bones, Rest, bones_of
from zoomout_core.matching.report.verdict import VERDICT
from zoomout_core.symmetry.flip_name import partner_of

# The kinds of cases: a character at rest, posed, and the clothes of a body.
AT_REST, POSED, WORN = "at rest", "posed", "worn"
# A body faces -y, its left is +x.
MIRROR = np.array([-1.0, 1.0, 1.0])
# Places closer to the middle than this, in centimetres, have no side.
MIDDLE = 3.0


def mirror_cases(folder: Path, max_count: int | None) -> Iterator[Case]:
    """Characters and outfits, each a case of a self-map that exchanges left and right.

    Args:
        folder: with packs of characters under `game`, and outfits under `outfits`.
        max_count: approximate largest number of a kind; None for all.
    """
    characters = list(chain.from_iterable(sorted(pack.glob("*.glb")) for pack in sorted((folder / "game").glob("*"))))
    kinds: list[list[Maker]] = [
        [partial(_character, path, posed) for path in characters for posed in (False, True)],
        [partial(_worn_case, path) for path in sorted((folder / "outfits").glob("*.npz"))],
    ]
    for makers in kinds:
        for make in spread(makers, max_count):
            case = make()
            if case is not None:
                yield case


def mirrored_bones(character: Character) -> Bones:
    """The weights that a symmetry of a character should produce: those of each bone come from its partner.

    The truth is unknown at vertices moved by a sided bone without a partner, such as a weapon's.
    """
    truth = bones_of(character, character, character.rest)
    names = [partner_of(name, truth.names) for name in truth.names]
    partner = np.array([truth.names.index(name) if name in truth.names else i for i, name in enumerate(names)])
    lone = truth.side[partner] != -truth.side
    return replace(truth, target=np.where(lone[partner], 0, truth.source[:, partner]))


def _character(path: Path, posed: bool) -> Case | None:
    character = read_character(path)
    if is_broken(character):
        return None
    body, pose = (character.posed, character.pose) if posed else (character.rest, "rest")
    surface = surface_of(body)
    name = f"{character.pack} {character.name}, {pose}"
    return Case(POSED if posed else AT_REST, name, surface, surface, mirrored_bones(character))


def _worn_case(path: Path) -> Case:
    case = outfit(path)
    assert isinstance(case.truth, Rest)
    rest, part = case.truth.target, case.truth.target_part
    truth = replace(case.truth, source=rest, target=rest * MIRROR, source_part=part)
    return Case(WORN, case.name, case.target, case.target, truth)


# --- the table ----------------------------------------------------------------------------------------------


def symmetry_records(folder: Path, max_count: int | None) -> list[Row]:
    """A record for each case of `mirror_cases`."""
    return [symmetry_record(case) for case in tqdm(mirror_cases(folder, max_count), desc="characters", leave=False)]


def symmetry_record(case: Case) -> Row:
    """Figures and certainty of the first symmetry of a case."""
    zo.forget_shapes()
    begin = perf_counter()
    first = zo.detect_symmetry(case.source)[0]
    seconds = perf_counter() - begin
    found = figures(case, first.surface_map)
    return {
        "characters": case.kind,
        "case": case.name,
        "parts": int(case.source.components.max()) + 1,
        "certainty": first.certainty,
        "limb": found.limb,
        "dom": found.dom,
        "cm": found.error,
        "sides": _sides(case, first),
        "right": found.right and first.reverses_orientation,
        "seconds": seconds,
    }


def symmetry_rows(records: list[Row]) -> list[Row]:
    """For each kind of case: how many symmetries are right, and how many are announced as right, and rightly so.

    Also the worst and the median share of vertices on the mirrored limb, the median error of outfits, and the worst
    and median share of vertices on their own side.
    """
    rows = []
    for kind in dict.fromkeys(record["characters"] for record in records):
        chosen = [record for record in records if record["characters"] == kind]
        sure = [record for record in chosen if record["certainty"] >= VERDICT.certain]
        rows.append(
            {
                "characters": kind,
                "cases": len(chosen),
                "right": sum(record["right"] for record in chosen),
                "certain": len(sure),
                "certain and wrong": sum(not record["right"] for record in sure),
                "worst limb": over(min, chosen, "limb"),
                "median limb": over(np.median, chosen, "limb"),
                "median cm": over(np.median, chosen, "cm"),
                "worst sides": over(min, chosen, "sides"),
                "median sides": over(np.median, chosen, "sides"),
                "seconds": over(np.median, chosen, "seconds"),
            }
        )
    return rows


def _sides(case: Case, symmetry: zo.Symmetry) -> float | None:
    """The share of sided vertices on their own side, up to an exchange of left and right."""
    truth = case.truth
    if isinstance(truth, Bones):
        bone = dominant(truth.source)
        side = np.where(bone >= 0, truth.side[bone], 0)
    else:
        side = np.sign(truth.source[:, 0]) * (np.abs(truth.source[:, 0]) > MIDDLE * truth.unit)
    agrees = (symmetry.sides() == side)[side != 0]
    opposite = (symmetry.sides() == -side)[side != 0]
    return float(max(agrees.mean(), opposite.mean())) if len(agrees) else None
