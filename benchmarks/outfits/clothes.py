# SPDX-License-Identifier: GPL-3.0-or-later
"""Garments that their author refitted to several bodies, with keys, bones and poses: the set `clothes`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.rigging.poses import pose_of_turns

Arrays = dict[str, np.ndarray]
# The bodies that garments are made for, and the prefix of a man's.
WOMAN, MAN = MADE_FOR = "woman", "man"
OF_MAN = "male_"
# The bones of upper arms, and those that the arms end at.
ARMS = ("upperarm01.L", "wrist.L"), ("upperarm01.R", "wrist.R")
# Extremes that limbs reach: degrees by which bones turn about the axes of the world at rest (x to the left of the body,
# y up, z to the front). Bones with a side turn on both sides in mirror image, unless both sides are given.
EXTREMES: dict[str, dict[str, tuple[float, float, float]]] = {
    "arms up": {"clavicle.L": (0, 0, 20), "upperarm01.L": (0, 0, 80)},
    "arms forward": {"upperarm01.L": (0, -80, 0)},
    "elbows": {"lowerarm01.L": (-100, 0, 0)},
    "knee up": {
        "upperleg01.L": (-80, 0, 0),
        "upperleg01.R": (0, 0, 0),
        "lowerleg01.L": (80, 0, 0),
        "lowerleg01.R": (0, 0, 0),
    },
    "legs apart": {"upperleg01.L": (0, 0, 40)},
    "sitting": {"upperleg01.L": (-90, 0, 0), "lowerleg01.L": (90, 0, 0)},
    "bent over": {f"spine0{number}": (15, 0, 0) for number in range(1, 6)},
}


@dataclass(frozen=True, eq=False)
class Bones:
    """The bones of a body at rest.

    Attributes:
        names: (b,) their names.
        parents: (b,) the number of each bone's parent, -1 for none.
        heads: (b, 3) the joints about which they turn.
        tails: (b, 3) their other ends.
    """

    names: tuple[str, ...]
    parents: Integers
    heads: Floats
    tails: Floats


@dataclass(frozen=True, eq=False)
class Body:
    """A body of one build and topology.

    Attributes:
        surface: the skin, in centimetres.
        weights: (n, b) weights of its bones.
        keys: (n, 3) offsets of its keys, by name.
        poses: for each pose of the set (b, 3, 4) transforms of its bones.
        bones: the bones at rest.
        extremes: transforms as in poses for each of `EXTREMES` whose bones it has.
    """

    surface: Surface
    weights: Floats
    keys: dict[str, Floats]
    poses: list[Floats]
    bones: Bones
    extremes: list[Floats] = field(default_factory=list)

    def in_pose(self, number: int, points: Floats, weights: Floats) -> Floats:
        """(n, 3) points with weights (n, b), in a pose, by linear blend skinning."""
        return move(points, weights, self.poses[number])


@dataclass(frozen=True, eq=False)
class Garment:
    """A garment on the body that it is made for, and on another one as its author refitted it.

    Attributes:
        surface: its shape on the first body.
        refitted: (n, 3) its vertices on the other body.
        weights: (n, b) weights of the body's bones; those of its own bones are added to the body's bone above.
        keys: (n, 3) offsets of the body's keys, by name.
        joints: (j, 3) heads of its own bones on the first body.
        true_joints: (j, 3) the same on the other body.
    """

    surface: Surface
    refitted: Floats
    weights: Floats
    keys: dict[str, Floats]
    joints: Floats
    true_joints: Floats


class Wardrobe:
    """The set in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._bodies = _load(folder / "bodies.npz")
        self._builds = self._bodies["builds"].tolist()
        self.is_strict = dict(zip(self._builds, self._bodies["build_strict"].tolist(), strict=True))
        self.key_is_strict = dict(
            zip(self._bodies["key_names"].tolist(), self._bodies["key_strict"].tolist(), strict=True)
        )
        self.topologies = self._bodies["topologies"].tolist()

    @property
    def builds(self) -> tuple[str, ...]:
        """The names of all builds."""
        return tuple(self._builds)

    def pairs(self) -> Iterator[tuple[str, str]]:
        """Builds with garments made for them, each with all others, strict ones first."""
        others = [build for build in self._builds if build not in MADE_FOR]
        for build in sorted(others, key=lambda build: not self.is_strict[build]):
            yield from ((made_for, build) for made_for in MADE_FOR if self._paths(made_for))

    def body(self, build: str, topology: str | None = None) -> Body:
        """A body of some build; in its base topology, unless another one is given."""
        data, prefix = self._bodies, f"{topology}_" if topology else ""
        number = self._builds.index(build)
        vertices = data[f"{prefix}vertices"][number].astype(np.float64)
        keys = dict(zip(self.key_is_strict, data[f"{prefix}keys"].astype(np.float64), strict=True))
        surface = _surface(vertices, data, prefix)
        weights = _weights(data, len(vertices), len(data["bone_names"]), prefix)
        heads = data["heads"][number].astype(np.float64)
        names = data["bone_names"].tolist()
        parents = np.array([names.index(name) if name else -1 for name in data["bone_parents"].tolist()])
        bones = Bones(tuple(names), parents, heads, data["tails"][number].astype(np.float64))
        poses = [self.pose(each, heads) for each in range(len(data["poses"]))]
        return Body(surface, weights, keys, poses, bones, list(_extremes(bones)))

    def t_pose(self, body: Body) -> Floats | None:
        """(b, 3, 4) transforms of a body's bones that raise its arms to the sides; None without arms."""
        names, heads = body.bones.names, body.bones.heads
        turns = np.zeros((len(names), 3))
        for shoulder, wrist in ARMS:
            if shoulder not in names:
                return None
            sideways, upwards, _ = heads[names.index(wrist)] - heads[names.index(shoulder)]
            turns[names.index(shoulder), 2] = -np.sign(sideways) * np.arctan2(upwards, abs(sideways))
        return pose_of_turns(turns, heads, body.bones.parents)

    def garments(self, made_for: str, build: str) -> dict[str, Garment]:
        """The garments made for a body, refitted to another build, by name."""
        return {path.stem: self._garment(path, made_for, build) for path in self._paths(made_for)}

    def _paths(self, made_for: str) -> list[Path]:
        """The files of the garments made for a body."""
        paths = sorted((self._folder / "garments").glob("*.npz"))
        return [path for path in paths if path.stem.startswith(OF_MAN) == (made_for == MAN)]

    def _garment(self, path: Path, made_for: str, build: str) -> Garment:
        data = _load(path)
        own = data["extra_names"].tolist() if "extra_names" in data else []
        bones = self._bodies["bone_names"].tolist()
        vertices, joints = (
            [data[name][self._builds.index(each)].astype(np.float64) for each in (made_for, build)]
            if name in data
            else [np.zeros((0, 3))] * 2
            for name in ("vertices", "extra_heads")
        )
        weights = _weights(data, len(vertices[0]), len(bones) + len(own))
        parents = data["extra_parents"].tolist() if own else []
        for number in reversed(range(len(own))):  # children follow their parents
            above = (bones + own).index(parents[number])
            weights[:, above] += weights[:, len(bones) + number]
        keys = dict(zip(data["key_names"].tolist(), data["keys"].astype(np.float64), strict=True))
        surface = _surface(vertices[0], data)
        return Garment(surface, vertices[1], weights[:, : len(bones)], keys, *joints)

    def pose(self, number: int, heads: Floats) -> Floats:
        """(b, 3, 4) transforms of bones in a pose, in which they rotate about their heads (b, 3) in world axes."""
        rotations = self._bodies["poses"][number]
        names = self._bodies["bone_names"].tolist()
        above = dict(zip(names, self._bodies["bone_parents"].tolist(), strict=True))
        found: dict[str, Floats] = {}

        def transform(name: str) -> Floats:
            if name not in found:
                number, parent = names.index(name), np.eye(3, 4) if not above[name] else transform(above[name])
                linear = parent[:, :3] @ rotations[number]
                place = parent[:, :3] @ heads[number] + parent[:, 3]
                found[name] = np.column_stack([linear, place - linear @ heads[number]])
            return found[name]

        return np.array([transform(name) for name in names])


def _extremes(bones: Bones) -> Iterator[Floats]:
    """(b, 3, 4) transforms of bones for each of `EXTREMES` whose bones there are."""
    for turned in EXTREMES.values():
        turns = np.zeros((len(bones.names), 3))
        mirrored = {f"{name[:-1]}R": (x, -y, -z) for name, (x, y, z) in turned.items() if name.endswith(".L")}
        every = {**mirrored, **turned}
        if set(every) <= set(bones.names):
            for name, turn in every.items():
                turns[bones.names.index(name)] = np.radians(turn)
            yield pose_of_turns(turns, bones.heads, bones.parents)


def move(points: Floats, weights: Floats, transforms: Floats) -> Floats:
    """(n, 3) points with weights (n, b), moved by transforms (b, 3, 4) of bones, by linear blend skinning."""
    return transform_points(blend_matrices(transforms, csr_array(weights)), points)


def _load(path: Path) -> Arrays:
    with np.load(path) as file:
        return dict(file)


def _surface(vertices: Floats, data: Arrays, prefix: str = "") -> Surface:
    start = np.concatenate([[0], np.cumsum(data[f"{prefix}face_sizes"].astype(np.int64))])
    return Surface.from_corners(vertices, data[f"{prefix}face_vertices"].astype(np.int64), start)


def _weights(data: Arrays, vertices: int, bones: int, prefix: str = "") -> Floats:
    weights = np.zeros((vertices, bones))
    weights[data[f"{prefix}weight_vertex"], data[f"{prefix}weight_bone"]] = data[f"{prefix}weight_value"]
    return weights
