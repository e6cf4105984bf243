# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks of bones and teeth on other specimens, beside the map alone and the best rigid fit."""

from __future__ import annotations

from pathlib import Path
from time import process_time

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import rankdata
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.datasets import evenly
from benchmarks.tables import NOT_SHOWN, Record, Tables
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.cli.report import LOW
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.matching.registration.smooth_warp import outward_normals
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.surface import Surface

# An error counts as wrong if it exceeds this multiple of its kind's median.
WRONG = 2.0
# Rotation (seeded) and scale of a target that must not change the result.
SEED, SCALE = 5, 37.0


def run(data: Path, pairs: int | None) -> Tables:
    """Place landmarks, and measure their distances from the true places, in millimetres.

    `rows`: for each kind of specimen and each method the mean and worst error, the error of the best rigid fit of the
    true landmarks, the share of landmarks whose confidence is below one half, the area under the ROC curve of
    confidence against errors above twice the median, the number of landmarks on a side that faces away from the true
    one, and seconds per pair. `invariance`: how far landmarks move, at most, if a target is turned and scaled.

    Args:
        data: a folder with the set `specimens`, or the set itself.
        pairs: use this many pairs, evenly spread.
    """
    folder = data / "specimens" if (data / "specimens").is_dir() else data
    listed = [line.split() for line in (folder / "pairs.txt").read_text().splitlines() if line.strip()]
    truth = dict(np.load(folder / "landmarks.npz"))
    records: list[Record] = []
    moved: list[Record] = []
    for target_name, source_name in tqdm(evenly(listed, pairs), leave=False):
        kind = target_name.partition("_")[0]
        source, target = (zo.read_surface(folder / "shapes" / f"{name}.ply") for name in (source_name, target_name))
        on_source, on_target = truth[source_name], truth[target_name]
        begin = process_time()
        result = zo.match(source, target)
        matched = process_time() - begin
        about = {"kind": kind, "target": target_name, "source": source_name}
        about |= {"rigid": float(rigid_errors(on_source, on_target).mean())}
        for method, place in METHODS.items():
            begin = process_time()
            points, confidence = place(result, on_source)
            taken = matched + process_time() - begin
            errors = np.linalg.norm(points - on_target, axis=1)
            found = {"errors": errors.tolist(), "confidence": confidence.tolist(), "seconds": taken}
            records.append(about | {"method": method, "swaps": swapped_sides(points, on_target, target)} | found)
        if kind not in {row["kind"] for row in moved}:
            change = change_if_turned(source, target, on_source, zo.transfer_landmarks(result, on_source).points)
            moved.append({"kind": kind, "target": target_name, "source": source_name, "moved": change})
    return {"rows": _rows(records), "invariance": moved, NOT_SHOWN: records}


def by_map(result: MatchResult, points: Floats) -> tuple[Floats, Floats]:
    """Places by the map alone, and its confidence there."""
    found = result.surface_map.preimages(result.source, result.target, points)
    return found.interpolate(result.target.vertices), found.interpolate(result.confidence)


METHODS = {"map": by_map, "transfer_landmarks": zo.transfer_landmarks}


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
        for method in METHODS:
            chosen = [record for record in records if (record["kind"], record["method"]) == (kind, method)]
            errors, confidence = (np.concatenate([each[name] for each in chosen]) for name in ("errors", "confidence"))
            unsure = confidence < LOW
            row: Record = {"kind": kind, "method": method, "pairs": len(chosen), "mean": float(errors.mean())}
            row |= {"median": float(np.median(errors)), "worst": float(errors.max())}
            row |= {"worst unflagged": float(errors[~unsure].max(initial=0))}
            row |= {"rigid": float(np.mean([each["rigid"] for each in chosen])), "flagged": float(unsure.mean())}
            row |= {"AUC": area_under_curve(-confidence, errors > WRONG * np.median(errors))}
            row |= {"swaps": sum(each["swaps"] for each in chosen)}
            rows.append(row | {"seconds": float(np.mean([each["seconds"] for each in chosen]))})
    return rows
