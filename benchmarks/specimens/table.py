# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks of bones and teeth on other specimens, beside the map alone and the best rigid fit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import rankdata
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.datasets import evenly
from benchmarks.specimens.damage import DAMAGES, Specimen, intact, mirror_image
from benchmarks.tables import NOT_SHOWN, Record, Tables
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.matching.registration.smooth_warp import outward_normals
from zoomout_core.matching.report.verdict import LOW_CONFIDENCE
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.surface import Surface

# A landmark is wrong if it is off by more than this share of the mean error of the best rigid fit of its specimen.
WRONG = 0.5
# Among the small errors on intact specimens, those above this multiple of their kind's median are large.
LARGE = 2.0
# Rotation (seeded) and scale of a target that must not change the result.
SEED, SCALE = 5, 37.0
INTACT, MIRRORED = "intact", "mirror image"
# Ways to place landmarks (q, 3) along a match: (q, 3) points and (q,) confidence.
Methods = dict[str, Callable[[MatchResult, Floats], tuple[Floats, Floats]]]


def run(data: Path, pairs: int | None) -> Tables:
    """Place landmarks, and measure their distances from the true places, in millimetres.

    `rows`: for each kind of intact specimens and each method the mean and worst error, the error of the best rigid fit
    of the true landmarks, the share of landmarks whose confidence is below one half, the area under the ROC curve of
    confidence against errors above twice the median, the number of landmarks on a side that faces away from the true
    one, and seconds per pair.

    `confidence`: whether confidence tells wrong landmarks from right ones, on intact specimens and on the same ones
    damaged, for each kind and for each damage. A landmark is wrong if it is farther from where it is, or was, than half
    of the mean error of the best rigid fit.

    `mirror images`: errors if the target is mirrored, with and without the mirrored candidate.

    `invariance`: how far landmarks move, at most, if a target is turned and scaled.

    Args:
        data: a folder with the set `specimens`, or the set itself.
        pairs: use this many pairs, evenly spread.
    """
    folder = data / "specimens" if (data / "specimens").is_dir() else data
    listed = [line.split() for line in (folder / "pairs.txt").read_text().splitlines() if line.strip()]
    truth = dict(np.load(folder / "landmarks.npz"))
    records: list[Record] = []
    moved: list[Record] = []
    seen: dict[str, int] = {}
    for target_name, source_name in tqdm(evenly(listed, pairs), leave=False):
        kind = target_name.partition("_")[0]
        source, target = (zo.read_surface(folder / "shapes" / f"{name}.ply") for name in (source_name, target_name))
        on_source, on_target = truth[source_name], truth[target_name]
        about = {"kind": kind, "target": target_name, "source": source_name}
        number = seen[kind] = seen.get(kind, -1) + 1
        damage = list(DAMAGES)[number % len(DAMAGES)]
        specimens = {INTACT: intact(target, on_target), damage: DAMAGES[damage](target, on_target)}
        if number == 0:
            specimens[MIRRORED] = mirror_image(target, on_target)
        for condition, specimen in specimens.items():
            methods = MIRRORED_METHODS if condition == MIRRORED else METHODS
            for found in placements(source, on_source, specimen, methods):
                records.append(about | {"condition": condition} | found)
        if number == 0:
            intact_ones = [record for record in records if record["method"] == TRANSFER and record["kind"] == kind]
            change = change_if_turned(source, target, on_source, np.array(intact_ones[0]["points"]))
            moved.append({"kind": kind, "target": target_name, "source": source_name, "moved": change})
    return {
        "rows": _rows([record for record in records if record["condition"] == INTACT]),
        "confidence": _confidence_rows(records),
        "mirror images": _mirror_rows(records),
        "invariance": moved,
        NOT_SHOWN: records,
    }


def placements(source: Surface, landmarks: Floats, specimen: Specimen, methods: Methods) -> list[Record]:
    """The places of landmarks (q, 3) on a specimen by some methods, and their errors."""
    begin = process_time()
    result = zo.match(source, specimen.surface)
    matched = process_time() - begin
    found = []
    for method, place in methods.items():
        begin = process_time()
        points, confidence = place(result, landmarks)
        taken = matched + process_time() - begin
        errors = np.linalg.norm(points - specimen.landmarks, axis=1)
        record: Record = {"method": method, "points": points.tolist(), "errors": errors.tolist()}
        record |= {"rigid": float(rigid_errors(landmarks, specimen.landmarks).mean())}
        record |= {"confidence": confidence.tolist(), "present": specimen.present.tolist(), "seconds": taken}
        found.append(record | {"swaps": swapped_sides(points, specimen.landmarks, specimen.surface)})
    return found


def by_map(result: MatchResult, points: Floats) -> tuple[Floats, Floats]:
    """Places by the map alone, and its confidence there."""
    found = result.surface_map.preimages(result.source, result.target, points)
    return found.interpolate(result.target.vertices), found.interpolate(result.confidence)


def by_mirror_candidate(result: MatchResult, points: Floats) -> tuple[Floats, Floats]:
    """Places by `transfer_landmarks`, along a mirrored map if the target is a mirror image."""
    mirrored = zo.mirror_candidate(result)
    return zo.transfer_landmarks(result if mirrored is None else result.use(mirrored), points)


MAP, TRANSFER = "map", "transfer_landmarks"
METHODS: Methods = {MAP: by_map, TRANSFER: zo.transfer_landmarks}
MIRRORED_METHODS: Methods = {TRANSFER: zo.transfer_landmarks, "mirror_candidate": by_mirror_candidate}


def rigid_errors(source: Floats, target: Floats) -> Floats:
    """(q,) distances between landmarks (q, 3) after the best rigid motion of the source's (Kabsch 1976)."""
    centred, goal = source - source.mean(axis=0), target - target.mean(axis=0)
    rotation, _ = Rotation.align_vectors(goal, centred)
    return np.asarray(np.linalg.norm(rotation.apply(centred) - goal, axis=1))


def swapped_sides(points: Floats, truth: Floats, target: Surface) -> int:
    """How many places (q, 3) are on a side that faces away from the true places (q, 3), such as an inner wall."""
    mesh = target.working
    normals = outward_normals(mesh)
    facing = []
    for places in (points, truth):
        triangle, weights = closest_points(mesh.from_surface(places), mesh.vertices, mesh.triangles)
        facing.append(np.einsum("qc,qcx->qx", weights, normals[mesh.triangles[triangle]]))
    return int((np.einsum("qx,qx->q", *facing) < 0).sum())


def change_if_turned(source: Surface, target: Surface, landmarks: Floats, points: Floats) -> float:
    """The largest distance by which the places (q, 3) of landmarks (q, 3) move if the target is turned and scaled."""
    rotation = Rotation.random(random_state=SEED)
    turned = target.with_vertices(SCALE * rotation.apply(target.vertices))
    found = zo.transfer_landmarks(zo.match(source, turned), landmarks).points
    return float(np.linalg.norm(rotation.inv().apply(found) / SCALE - points, axis=1).max())


def area_under_curve(score: Floats, wrong: Booleans) -> float | None:
    """The probability that a wrong one of (n,) scores is above a right one (Hanley and McNeil 1982)."""
    count = int(wrong.sum())
    if not 0 < count < len(wrong):
        return None
    return float((rankdata(score)[wrong].sum() - count * (count + 1) / 2) / (count * (len(wrong) - count)))


def _rows(records: list[Record]) -> list[Record]:
    rows = []
    for kind in dict.fromkeys(record["kind"] for record in records):
        for method in (MAP, TRANSFER):
            chosen = [record for record in records if (record["kind"], record["method"]) == (kind, method)]
            errors, confidence = _join(chosen, "errors"), _join(chosen, "confidence")
            doubtful = confidence < LOW_CONFIDENCE
            row: Record = {"kind": kind, "method": method, "pairs": len(chosen), "mean": float(errors.mean())}
            row |= {"median": float(np.median(errors)), "worst": float(errors.max())}
            row |= {"worst unflagged": float(errors[~doubtful].max(initial=0))}
            row |= {"rigid": float(np.mean([each["rigid"] for each in chosen])), "flagged": float(doubtful.mean())}
            row |= {"AUC": area_under_curve(-confidence, errors > LARGE * np.median(errors))}
            row |= {"swaps": sum(each["swaps"] for each in chosen)}
            rows.append(row | {"seconds": float(np.mean([each["seconds"] for each in chosen]))})
    return rows


def _confidence_rows(records: list[Record]) -> list[Record]:
    used = [record for record in records if record["condition"] != MIRRORED]
    rows = []
    for group in ("kind", "condition"):
        for name in dict.fromkeys(record[group] for record in used):
            for method in (MAP, TRANSFER):
                chosen = [record for record in used if (record[group], record["method"]) == (name, method)]
                limits = [np.full(len(each["errors"]), WRONG * each["rigid"]) for each in chosen]
                errors, confidence = _join(chosen, "errors"), _join(chosen, "confidence")
                wrong, doubtful = errors > np.concatenate(limits), confidence < LOW_CONFIDENCE
                present = _join(chosen, "present")
                row: Record = {"specimens": name, "method": method, "landmarks": len(errors)}
                row |= {"missing": int((~present).sum()), "mean of present": float(errors[present].mean())}
                row |= {"wrong": int(wrong.sum()), "wrong flagged": _share(doubtful[wrong])}
                row |= {"right flagged": _share(doubtful[~wrong]), "AUC": area_under_curve(-confidence, wrong)}
                rows.append(row)
    return rows


def _mirror_rows(records: list[Record]) -> list[Record]:
    rows = []
    for record in records:
        if record["condition"] == MIRRORED:
            errors, confidence = np.array(record["errors"]), np.array(record["confidence"])
            row: Record = {name: record[name] for name in ("kind", "target", "source", "method")}
            row |= {"mean": float(errors.mean()), "worst": float(errors.max())}
            rows.append(row | {"flagged": float((confidence < LOW_CONFIDENCE).mean())})
    return rows


def _join(records: list[Record], name: str) -> Any:
    return np.concatenate([each[name] for each in records])


def _share(chosen: Booleans) -> float | None:
    return float(chosen.mean()) if len(chosen) else None
