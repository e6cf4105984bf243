# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of expression keys on a head, next to the true ones."""

from __future__ import annotations

import numpy as np

from benchmarks.faces.cases import JAW_OPEN, Case, Sides
from benchmarks.tables import Record
from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.mesh.triangles import edge_lengths, triangle_normals, unique_edges

BLINKS = ("eyeBlink_L", "eyeBlink_R")
# A key moves a part of the head if the true motion exceeds this share of the largest motion of all keys.
MOVES = 1e-3
# An edge is torn if it is longer than this multiple of its length under the true key.
TORN = 2.0
MILLIMETRES = 10.0  # per centimetre


def figures(case: Case, keys: Floats) -> Record:
    """Figures of keys (keys, n_t, 3) on the target.

    `error`: mean over the keys of the sum of the distances from the true offsets over the sum of the lengths of these;
    0 is right, and 1 as bad as no key. `skin`: the same on the skin. `worst`: the largest of these, and `key` its name.
    `lips`: how far the key that opens the jaw opens the lips, as a share of the truth. `blink`: by how many millimetres
    the lids stay farther apart than in truth, at most. `flipped` and `torn`: triangles that are turned over, and edges
    stretched, against the truth, over all keys. `overturned`: those of the flipped ones that face backwards against the
    rest shape while the true key leaves them facing forwards; most others are lips that the true keys push through each
    other, and turn over. `solids`: the largest distance in millimetres of a row of teeth or an
    eyeball from its true place. `bent`: the largest change of shape of these, beyond their true one.
    """
    errors = key_errors(keys, case.truth)
    skin = key_errors(keys[:, case.skin], case.truth[:, case.skin])
    moving = np.linalg.norm(case.truth[:, case.skin], axis=2).sum(axis=1)
    worst = int(errors.argmax())
    row: Record = {"error": float(errors.mean()), "median": float(np.median(errors))}
    row |= {"skin": float(skin[moving > MOVES * moving.max()].mean())}
    row |= {"worst": float(errors[worst]), "key": case.names[worst], "lips": None, "blink": None}
    millimetre = case.scale / MILLIMETRES
    if case.lips is not None:
        jaw = case.names.index(JAW_OPEN)
        row |= {"lips": opening(case, keys[jaw], case.lips) / opening(case, case.truth[jaw], case.lips)}
    if case.lids is not None:
        blinks = [case.names.index(name) for name in BLINKS]
        row |= {"blink": max(remaining_gap(case, keys[i], case.truth[i], case.lids) for i in blinks) / millimetre}
    damages = [damage(case, found, true) for found, true in zip(keys, case.truth, strict=True)]
    flipped, overturned, torn = (sum(each) for each in zip(*damages, strict=True))
    row |= {"flipped": flipped, "overturned": overturned, "torn": torn, "solids": None, "bent": None}
    if case.solids:
        off, bent = [], []
        for vertices in case.solids.values():
            rest = case.target.vertices[vertices]
            for found, true in zip(keys[:, vertices], case.truth[:, vertices], strict=True):
                off.append(float(np.linalg.norm(found - true, axis=1).mean()))
                bent.append(change_of_shape(rest, found) - change_of_shape(rest, true))
        row |= {"solids": max(off) / millimetre, "bent": max(bent) / millimetre}
    return row


def key_errors(keys: Floats, truth: Floats) -> Floats:
    """(keys,) sums of the distances between offsets (keys, n, 3), as shares of the sums of the true lengths."""
    lengths = np.linalg.norm(truth, axis=2).sum(axis=1)
    return np.asarray(np.linalg.norm(keys - truth, axis=2).sum(axis=1) / np.maximum(lengths, 1e-9))


def opening(case: Case, key: Floats, sides: Sides) -> float:
    """The mean increase of the distance between two sides by a key (n_t, 3)."""
    rest = case.target.vertices
    return _distance(rest + key, sides) - _distance(rest, sides)


def remaining_gap(case: Case, key: Floats, true: Floats, sides: Sides) -> float:
    """How much farther apart two sides are under a key (n_t, 3) than under the true one."""
    return _distance(case.target.vertices + key, sides) - _distance(case.target.vertices + true, sides)


def damage(case: Case, key: Floats, true: Floats) -> tuple[int, int, int]:
    """The triangles that a key (n_t, 3) flips, those that it turns over, and the edges that it tears; see `figures`."""
    moving = (key != 0).any(axis=1) | (true != 0).any(axis=1)
    triangles = case.target.triangles[moving[case.target.triangles].any(axis=1)]
    edges, _ = unique_edges(triangles)
    rest = case.target.vertices
    found, right, before = (triangle_normals(rest + offset, triangles) for offset in (key, true, np.zeros_like(true)))
    flipped = np.einsum("mx,mx->m", found, right) < 0
    overturned = flipped & (np.einsum("mx,mx->m", found, before) < 0) & (np.einsum("mx,mx->m", right, before) >= 0)
    stretched = edge_lengths(rest + key, edges) > TORN * np.maximum(
        edge_lengths(rest + true, edges), edge_lengths(rest, edges)
    )
    return int(flipped.sum()), int(overturned.sum()), int(stretched.sum())


def change_of_shape(rest: Floats, offsets: Floats) -> float:
    """The root of the mean squared distance of moved points (n, 3) from the best rigid motion of all."""
    moved = rest + offsets
    motion = procrustes(rest, moved, scales=(1, 1))
    return float(np.sqrt(((motion(rest) - moved) ** 2).sum(axis=1).mean()))


def _distance(vertices: Floats, sides: Sides) -> float:
    upper, lower = sides
    return float(np.linalg.norm(vertices[upper] - vertices[lower], axis=1).mean())
