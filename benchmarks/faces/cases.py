# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs of heads with expression keys, and the true keys of the target."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.datasets import evenly
from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.mesh.surface import Surface

# Another topology of one head model, and heads of MakeHuman.
REMESHED, MAKEHUMAN = "remeshed", "MakeHuman"
# Regions of the head model that form its skin; the others are eyes, teeth, tongue, lashes and tears.
SKIN = ("face", "head_neck", "mouth_socket", "eye_socket_L", "eye_socket_R")
# Landmarks, of 68, on the upper lids, and those opposite on the lower lids.
UPPER_LIDS, LOWER_LIDS = (37, 38, 43, 44), (41, 40, 47, 46)
JAW_OPEN = "jawOpen"
Sides = tuple[Integers, Integers]


@dataclass(frozen=True, eq=False)
class Case:
    """A head with keys, and another head at rest.

    Attributes:
        kind: a set of pairs.
        name: the pair.
        source: the head with keys, in centimetres.
        target: the other head.
        names: of the keys.
        keys: (keys, n_s, 3) offsets of the source's vertices.
        truth: (keys, n_t, 3) true offsets of the target's vertices.
        skin: (n_t,) the vertices of the target's skin.
        scale: length on the target of a centimetre on the source.
        lips: vertices of the target on the upper lip, and those opposite on the lower lip; None if unknown.
        lids: the same for the eyelids.
        solids: the target's vertices of each row of teeth and of each eyeball.
        landmarks: (l,) vertices of the source, and (l, 3) their true places on the target; None if unknown.
    """

    kind: str
    name: str
    source: Surface
    target: Surface
    names: list[str]
    keys: Floats
    truth: Floats
    skin: Booleans
    scale: float = 1.0
    lips: Sides | None = None
    lids: Sides | None = None
    solids: Mapping[str, Integers] | None = None
    landmarks: tuple[Integers, Floats] | None = None

    @cached_property
    def columns(self) -> Floats:
        """(n_s, keys, 3) the keys as values of an attribute."""
        return np.ascontiguousarray(np.moveaxis(self.keys, 0, 1))


def cases(data: Path, pairs: int | None) -> Iterator[Case]:
    """The pairs in a folder with the set `faces`, or in the set itself; at most `pairs` of each kind."""
    folder = data / "faces" if (data / "faces").is_dir() else data
    model = _Model(folder / "ict.npz")
    for path in evenly(sorted((folder / "pairs").glob("*.npz")), pairs):
        yield model.case(path)
    for path in evenly(sorted((folder / "makehuman").glob("*.npz")), pairs):
        yield _makehuman(path)


class _Model:
    """A head model of one topology: persons, and keys that are the same offsets on each."""

    def __init__(self, path: Path) -> None:
        self.data = data = dict(np.load(path))
        self.names = [str(name) for name in data["key_names"]]
        self.faces = _faces(data["face_sizes"], data["face_vertices"])
        # The truth counts triangles in this order.
        fans = [(face[0], face[i], face[i + 1]) for face in self.faces for i in range(1, len(face) - 1)]
        self.triangles = np.array(fans, dtype=np.int64)
        self.keys = np.zeros((len(self.names), *data["neutral"].shape))
        ends = data["key_offset"]
        for key, first, end in zip(self.keys, ends[:-1], ends[1:], strict=True):
            key[data["key_vertex"][first:end]] = data["key_delta"][first:end]

    def case(self, path: Path) -> Case:
        stored = dict(np.load(path))
        motion = (stored["rotation"] * stored["scale"]).T
        corners = self.triangles[stored["truth_triangle"]]
        weights = stored["truth_barycentric"].astype(np.float64)
        nearest = corners[np.arange(len(corners)), weights.argmax(axis=1)]
        target = Surface(stored["target_vertices"].astype(np.float64), stored["target_triangles"].astype(np.int64))
        marks = self.data["landmarks68"].astype(np.int64)
        # The target's mouth may be ajar at rest.
        rest = self._person(stored["target"]) + float(stored["mouth"]) * self.keys[self.names.index(JAW_OPEN)]
        places = rest[marks] @ motion
        nearest_vertex = np.asarray(cKDTree(target.vertices).query(places)[1])
        lids = nearest_vertex[list(UPPER_LIDS)], nearest_vertex[list(LOWER_LIDS)]
        regions = [str(name) for name in self.data["region_names"]]
        solid = self.data["rigid"][nearest]
        solids = {str(name): np.flatnonzero(solid == i) for i, name in enumerate(self.data["rigid_names"])}
        return Case(
            REMESHED,
            path.stem,
            Surface(self._person(stored["source"]), self.faces),
            target,
            self.names,
            self.keys,
            np.einsum("mc,kmcx->kmx", weights, self.keys[:, corners]) @ motion,
            np.isin(self.data["region"][nearest], [regions.index(name) for name in SKIN]),
            float(stored["scale"]),
            (stored["lip_upper"], stored["lip_lower"]),
            lids,
            {name: vertices for name, vertices in solids.items() if len(vertices)},
            (marks, places),
        )

    def _person(self, number: Any) -> Floats:
        """(n, 3) a head at rest; -1 is the mean one."""
        chosen = self.data["neutral"] if number < 0 else self.data["identities"][number]
        return np.asarray(chosen, dtype=np.float64)


def _makehuman(path: Path) -> Case:
    stored = dict(np.load(path))
    source, target = (
        Surface(
            stored[f"{side}_vertices"].astype(np.float64),
            _faces(stored[f"{side}_face_sizes"], stored[f"{side}_face_vertices"]),
        )
        for side in ("source", "target")
    )
    names = [str(name) for name in stored["key_names"]]
    keys, truth = (stored[name].astype(np.float64) for name in ("source_keys", "truth_keys"))
    skin = np.ones(len(target.vertices), dtype=bool)
    return Case(MAKEHUMAN, path.stem, source, target, names, keys, truth, skin)


def _faces(sizes: Integers, corners: Integers) -> list[list[int]]:
    ends = np.cumsum(sizes.astype(np.int64))
    return [face.tolist() for face in np.split(corners.astype(np.int64), ends[:-1])]
