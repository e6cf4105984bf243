# SPDX-License-Identifier: GPL-3.0-or-later
"""Dressed bodies, and other bodies to be dressed, with or without a true outfit to compare with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from benchmarks.characters.cases import CENTIMETRES
from benchmarks.outfits.clothes import Body, Garment, Wardrobe, move
from zoomout_core.arrays import Floats
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.surface import Surface

# Files with a known outfit on another body, and those that are used in both directions.
KNOWN = "dressed_whole_f", "dressed_whole_m", "dressed_cut_same_pose", "body_eyes_teeth"
BOTH_WAYS = KNOWN[:2]
# Bodies of other sets that are dressed with the outfits of `BOTH_WAYS` in turn, by folder.
OTHERS = ("faust_r/tr_reg_025", "faust_r/tr_reg_041", "shrec19_r/11", "shrec19_r/22")
BODY = "body"
# Parts inside the head, in cavities of the skin.
WITHIN = "high-poly", "teeth_base"
# Hair whose name does not show it.
HAIR = "long01", "afro01", "short03", "short04"
SAME, OTHER = "same outfit", "other body"
STRICT, LOOSE, REMESHED, RAISED = "strict build", "other build", "other topology", "T-pose"
KINDS = STRICT, LOOSE, REMESHED, RAISED, SAME, OTHER


@dataclass(frozen=True, eq=False)
class Case:
    """A body to be dressed.

    Attributes:
        kind: one of `KINDS`: "same outfit" if the true outfit is known, or "other body"; for the set `clothes` "strict
            build" if the author's refit is the only good answer, "other build" if it is one among several, or "other
            topology", or "T-pose" if a strict build has its arms raised.
        name: that of the outfit and the body.
        source: the dressed body.
        target: the body to be dressed.
        things: the worn objects, by name.
        centimetre: its length in units of the source.
        truth: (n, 3) the known positions of worn objects on the target.
        true_shape: (n_s, 3) the source's vertices on the target, if known.
        body: the target with its keys and poses, if known.
        weights: (n_s, b) skin weights of the source, if the body is known.
        heads: (b, 3) joints of the source, if the body is known.
        garments: keys, weights and bones of the things, if known.
    """

    kind: str
    name: str
    source: Surface
    target: Surface
    things: dict[str, Surface]
    centimetre: float
    truth: dict[str, Floats] = field(default_factory=dict)
    true_shape: Floats | None = None
    body: Body | None = None
    weights: Floats | None = None
    heads: Floats | None = None
    garments: dict[str, Garment] = field(default_factory=dict)


def cases(data: Path, max_count: int | None) -> Iterator[Case]:
    """The cases of a folder of sets, or the first ones of each kind.

    Args:
        data: with `clothes`, and `characters/outfits` with `faust_r` and `shrec19_r`, as far as they are there.
        max_count: maximum number of each kind; None for all.
    """
    if (data / "clothes").is_dir():
        yield from _refits(Wardrobe(data / "clothes"), max_count)
    if (data / "characters" / "outfits").is_dir():
        yield from _outfits(data, max_count)


def _refits(wardrobe: Wardrobe, max_count: int | None) -> Iterator[Case]:
    """Garments on builds, and on other topologies of strict builds."""
    strict, loose = (
        [pair for pair in wardrobe.pairs() if wardrobe.is_strict[pair[1]] == is_strict] for is_strict in (True, False)
    )
    for kind, pairs in ((STRICT, strict), (LOOSE, loose)):
        for made_for, build in pairs[:max_count]:
            yield _refit(wardrobe, kind, made_for, build)
    for (made_for, build), topology in list(zip(strict, wardrobe.topologies, strict=False))[:max_count]:
        yield _refit(wardrobe, REMESHED, made_for, build, topology)
    for made_for, build in strict[:max_count]:
        yield from _raise_arms(wardrobe, made_for, build)


def _raise_arms(wardrobe: Wardrobe, made_for: str, build: str) -> Iterator[Case]:
    """Garments on a build in a T-pose, if it has arms: the authors' refits are moved by their weights."""
    source, body = wardrobe.body(made_for), wardrobe.body(build)
    transforms = wardrobe.t_pose(body)
    if transforms is None:
        return
    none = np.zeros((0, 3))
    garments = {
        name: replace(
            each, refitted=move(each.refitted, each.weights, transforms), keys={}, joints=none, true_joints=none
        )
        for name, each in wardrobe.garments(made_for, build).items()
    }
    raised = move(body.surface.vertices, body.weights, transforms)
    yield Case(
        RAISED,
        f"{made_for} to {build}, T-pose",
        source.surface,
        body.surface.with_vertices(raised),
        {name: garment.surface for name, garment in garments.items()},
        1.0,
        {name: garment.refitted for name, garment in garments.items()},
        raised,
        garments=garments,
    )


def _refit(wardrobe: Wardrobe, kind: str, made_for: str, build: str, topology: str | None = None) -> Case:
    source, body, garments = wardrobe.body(made_for), wardrobe.body(build, topology), wardrobe.garments(made_for, build)
    return Case(
        kind,
        f"{made_for} to {build}{f', {topology}' if topology else ''}",
        source.surface,
        body.surface,
        {name: garment.surface for name, garment in garments.items()},
        1.0,
        {name: garment.refitted for name, garment in garments.items()},
        wardrobe.body(build).surface.vertices,
        body,
        source.weights,
        source.bones.heads,
        garments,
    )


def _outfits(data: Path, max_count: int | None) -> Iterator[Case]:
    """Dressed bodies, on bodies that wear the same outfit and on others."""
    folder = data / "characters" / "outfits"
    ways = [(name, turned) for name in KNOWN for turned in ((False, True) if name in BOTH_WAYS else (False,))]
    known = [(name, turned) for name, turned in ways if (folder / f"{name}.npz").is_file()]
    for name, turned in known[:max_count]:
        sides, unit = _sides(folder / f"{name}.npz")
        (source, worn), (target, there) = sides[::-1] if turned else sides
        things = {part: each for part, each in worn.items() if part in there and _alike(each, there[part])}
        truth = {part: there[part].vertices for part in things}
        yield Case(SAME, f"{name}{' turned' * turned}", source, target, things, unit, truth)
    wardrobe = [name for name in BOTH_WAYS if (folder / f"{name}.npz").is_file()]
    bodies = [data / f"{name}.off" for name in OTHERS if (data / f"{name}.off").is_file()]
    for number, path in enumerate(bodies[:max_count] if wardrobe else []):
        name = wardrobe[number % len(wardrobe)]
        ((source, things), _), unit = _sides(folder / f"{name}.npz")
        yield Case(OTHER, f"{name} on {path.stem}", source, read_surface(path), things, unit)


def _alike(one: Surface, other: Surface) -> bool:
    return len(one.vertices) == len(other.vertices)


def _sides(path: Path) -> tuple[list[tuple[Surface, dict[str, Surface]]], float]:
    """The body and the other parts of both source and target of a file, and the length of a centimetre."""
    with np.load(path) as file:
        arrays = dict(file)
    found = []
    for side in ("source", "target"):
        names = arrays[f"{side}_part_names"].tolist()
        parts = dict(zip(names, _parts(arrays, side, len(names)), strict=True))
        found.append((parts.pop(BODY), parts))
    return found, float(arrays["height"]) / CENTIMETRES


def _parts(arrays: dict[str, np.ndarray], side: str, count: int) -> Iterator[Surface]:
    vertices, part = arrays[f"{side}_vertices"].astype(np.float64), arrays[f"{side}_part"]
    start = np.concatenate([[0], np.cumsum(arrays[f"{side}_face_sizes"].astype(np.int64))])
    corner_vertex = arrays[f"{side}_face_vertices"].astype(np.int64)
    for number in range(count):
        inside = part == number
        faces = np.flatnonzero(inside[corner_vertex[start[:-1]]])
        corners = np.concatenate([corner_vertex[start[face] : start[face + 1]] for face in faces])
        first = np.concatenate([[0], np.cumsum(np.diff(start)[faces])])
        yield Surface.from_corners(vertices[inside], (np.cumsum(inside) - 1)[corners], first)
