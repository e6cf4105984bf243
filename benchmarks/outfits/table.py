# SPDX-License-Identifier: GPL-3.0-or-later
"""Outfits moved to other bodies: error, intersections with the skin, distortion, body keys and bones of their own."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.outfits.cases import KINDS, WITHIN, Case, cases
from benchmarks.outfits.clothes import Wardrobe, move
from benchmarks.outfits.layers import Layers
from benchmarks.outfits.measure import DEEP, Expected, Skin, sample_places
from benchmarks.outfits.methods import BY_TRUE_MAP, TRUE, WAYS, Fitted, bind_to_nearest
from benchmarks.outfits.pictures import picture_of_case
from benchmarks.stored import read_or_compute, storing
from benchmarks.tables import NOT_SHOWN, Record, Tables
from zoomout_core.arrays import Floats
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer import shape_of_source

EVERY_WAY = (*WAYS, BY_TRUE_MAP, TRUE)
# A key that moves a garment by less, in centimetres, is left out.
MOVED = 0.1
CLOTHES, EYES = WORN = "clothes, hair", "eyes, teeth"


def run(
    data: Path,
    pairs: int | None,
    pictures: Path | None = None,
    kinds: Collection[str] = KINDS,
    ways: Collection[str] = EVERY_WAY,
    records: Path | None = None,
) -> Tables:
    """Match bodies, and dress one in the clothes of the other.

    `rows`: for each kind, method and class of worn objects the means over its objects: clothes and hair, and separately
    eyes and teeth, which are inside the head.

    Args:
        data: a folder with the sets `clothes`, and `characters` with `faust_r` and `shrec19_r`, as far as they are
            there.
        pairs: largest number of each kind; all when not given.
        pictures: for a picture of each case that is computed.
        kinds: of the cases.
        ways: methods to compare.
        records: file of the cases that are done; a run of the same code resumes from it.
    """
    strict_keys, found = _strict_keys(data / "clothes"), list[Record]()
    with nullcontext() if records is None else storing(records, [Path(__file__).parent]):
        for case in tqdm([each for each in cases(data, pairs) if each.kind in kinds], leave=False):
            names = (case.kind, case.name, *ways)
            found += read_or_compute(names, partial(_records, case, strict_keys, ways, pictures))
    return {"rows": _rows(found), NOT_SHOWN: found}


def _records(case: Case, strict_keys: frozenset[str], ways: Collection[str], pictures: Path | None) -> list[Record]:
    """A record for each worn object of a case, fitted by each method; CPU seconds."""
    begin = process_time()
    match = zo.match(case.source, case.target)
    matched = process_time()
    shape = shape_of_source(match, case.source, case.target)
    about = {"kind": case.kind, "case": case.name, "match s": matched - begin, "shape s": process_time() - matched}
    found, measure, records = dict[str, Fitted](), _Measure(case, strict_keys), list[Record]()
    fits: dict[str, Callable[[], Fitted]] = {name: partial(way, case, shape) for name, way in WAYS.items()}
    if case.true_shape is not None:
        fits[BY_TRUE_MAP] = partial(bind_to_nearest, case, case.true_shape)
    if case.truth:
        fits[TRUE] = partial(_truth, case)
    for way, fit in fits.items():
        if way in ways:
            begin = process_time()
            found[way] = fit()
            seconds = (process_time() - begin) / len(case.things)
            records += (about | {"way": way, "s": seconds} | row for row in measure.rows(found[way]))
    if pictures is not None:
        picture_of_case(pictures / f"{case.name.replace(' ', '_')}.png", case, shape, found)
    return records


def _strict_keys(folder: Path) -> frozenset[str]:
    """The keys whose effect on garments is not a matter of taste."""
    if not folder.is_dir():
        return frozenset()
    return frozenset(name for name, is_strict in Wardrobe(folder).key_is_strict.items() if is_strict)


def _truth(case: Case) -> Fitted:
    return Fitted(
        [case.truth[name] for name in case.things],
        [garment.keys for garment in case.garments.values()],
        [garment.true_joints for garment in case.garments.values()],
    )


class _Measure:
    """The figures of one case."""

    def __init__(self, case: Case, strict_keys: frozenset[str]) -> None:
        self._case, self._strict_keys = case, strict_keys
        self._expected = _at_rest(case)
        self._layers = {name: Layers(thing, case.source, case.centimetre) for name, thing in case.things.items()}
        self._poses = {} if case.body is None else {"posed": case.body.poses, "extreme": case.body.extremes}
        self._posed = {name: [_in_pose(case, pose) for pose in poses] for name, poses in self._poses.items()}
        keys = {} if case.body is None else case.body.keys
        self._skin = Skin(case.target)
        self._keyed = {
            name: Skin(case.target.with_vertices(case.target.vertices + offsets))
            for name, offsets in keys.items()
            if name in strict_keys
        }

    def rows(self, fitted: Fitted) -> Iterator[Record]:
        """A record for each worn object."""
        case = self._case
        for number, name in enumerate(case.things):
            found = fitted.vertices[number]
            record: Record = {"thing": name, "worn": EYES if name in WITHIN else CLOTHES, "vertices": len(found)}
            record |= self._expected[name].figures(found) | self._layers[name].figures(found)
            if case.body is not None:
                garment = case.garments[name]
                weights = fitted.weights[number] if fitted.weights else garment.weights
                for kind, poses in self._poses.items():
                    figures = [
                        posed[name].in_pose(move(found, weights, pose))
                        for pose, posed in zip(poses, self._posed[kind], strict=True)
                    ]
                    for figure in figures[0] if figures else ():
                        record[f"{kind} {figure}"] = max(each[figure] for each in figures)
            if fitted.keys:
                record |= key_figures(fitted.keys[number], case.garments[name].keys, self._strict_keys)
                record["keyed in skin"] = self._in_keyed_skin(case.things[name], found, fitted.keys[number])
            if fitted.joints and len(fitted.joints[number]):
                off = np.linalg.norm(fitted.joints[number] - case.garments[name].true_joints, axis=1)
                record["bones"] = float(off.mean())
            yield record

    def _in_keyed_skin(self, thing: Surface, found: Floats, keys: dict[str, Floats]) -> float:
        """The percentage of places in the skin with some strict key at 1 but not without; the mean over the keys."""
        deepest = -DEEP * self._case.centimetre
        still = self._skin.distances(sample_places(thing, found)) >= deepest
        shares = [
            100 * float((still & (skin.distances(sample_places(thing, found + keys[key])) < deepest)).mean())
            for key, skin in self._keyed.items()
            if np.linalg.norm(keys[key], axis=1).max() >= MOVED
        ]
        return _mean(shares)


def _at_rest(case: Case) -> dict[str, Expected]:
    """The things by name, expected like the truth or, if that is unknown, like they are on the source."""
    skins = Skin(case.source), Skin(case.target)
    return {name: Expected(thing, skins, case.centimetre, case.truth.get(name)) for name, thing in case.things.items()}


def _in_pose(case: Case, pose: Floats) -> dict[str, Expected]:
    """The things by name, expected like the author's refit in the same pose, by transforms (b, 3, 4) of the bones."""
    assert case.body is not None
    skin = Skin(case.target.with_vertices(move(case.target.vertices, case.body.weights, pose)))
    places = {name: move(each.refitted, each.weights, pose) for name, each in case.garments.items()}
    return {
        name: Expected(case.things[name].with_vertices(points), (skin, skin), case.centimetre)
        for name, points in places.items()
    }


def key_figures(found: dict[str, Floats], true: dict[str, Floats], strict: frozenset[str]) -> dict[str, float]:
    """How well offsets (n, 3) of keys agree with the author's, over the keys that move the garment.

    `cosine`: of the offsets of all vertices as one vector; `key error`: sum of distances from the true offsets,
    relative to the sum of these; both over the strict keys. `other key error`: over the others.
    """
    moving = [name for name in true if np.linalg.norm(true[name], axis=1).max() >= MOVED]
    errors = {
        name: np.linalg.norm(found[name] - true[name], axis=1).sum() / np.linalg.norm(true[name], axis=1).sum()
        for name in moving
    }
    cosines = [
        (found[name] * true[name]).sum() / max(np.linalg.norm(found[name]) * np.linalg.norm(true[name]), 1e-12)
        for name in moving
        if name in strict
    ]
    return {
        "cosine": _mean(cosines),
        "key error": _mean([error for name, error in errors.items() if name in strict]),
        "other key error": _mean([error for name, error in errors.items() if name not in strict]),
    }


def _mean(numbers: list[float]) -> float:
    """The mean of the known numbers."""
    known = [number for number in numbers if not np.isnan(number)]
    return float(np.mean(known)) if known else np.nan


def _rows(records: list[Record]) -> list[Record]:
    """Means over the objects of each kind, of known values only."""
    rows, of = [], ("kind", "worn", "way")
    for group in dict.fromkeys(tuple(record[name] for name in of) for record in records):
        chosen = [record for record in records if tuple(record[name] for name in of) == group]
        names = dict.fromkeys(name for record in chosen for name in record if name not in (*of, "case", "thing"))
        means = {name: _mean([record.get(name, np.nan) for record in chosen]) for name in names}
        known = {name: None if np.isnan(mean) else mean for name, mean in means.items()}
        rows.append({**dict(zip(of, group, strict=True)), "things": len(chosen), **known})
    return sorted(rows, key=lambda row: (KINDS.index(row["kind"]), WORN.index(row["worn"])))
