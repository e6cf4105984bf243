# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs and initial maps that ZoomOut and other methods refine, with the paper's figures on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

import zoomout_core as zo
from benchmarks.datasets import TEMPLATE, PairOfMeshes, load_pair, pair_names
from benchmarks.paper.flips import with_flipped_edges
from benchmarks.paper.starts import (
    K_SIGNATURES,
    from_descriptors,
    from_landmarks,
    from_shot,
    from_signatures,
    landmarks_of,
)
from zoomout_core.arrays import Floats, Integers
from zoomout_core.mesh.surface import Surface

# Published initial maps, from wave kernel signatures with a term that preserves the orientation, or with one that
# reverses it. If a set has only the latter, the former are fitted: the mirrored ones of FAUST exchange only some limbs,
# from which almost no map recovers.
START, MIRRORED_START = "WKSini_direct", "WKSini_symm"
# Share of flipped edges.
FLIPPED = 0.125
# Kinds of meshes of one surface that are refined from one to the other: others have loose parts, or 14,000 vertices, of
# which BCICP and RHM take minutes a pair.
KINDS = ("dense", "iso")
# Melzi et al. 2019: mean errors and seconds on FAUST in its original meshes, from the same kind of initial maps; mean
# errors after random flips of edges, from two landmarks; and on FAUST and SCAPE resampled, from learned descriptors.
PUBLISHED: dict[str, tuple[float, float | None]] = {
    "initial": (67.3, None),
    "ICP": (54.0, 10.2),
    "Deblur": (61.9, 10.9),
    "PMF": (26.4, 736),
    "RHM": (41.9, 41.4),
    "BCICP": (21.6, 184),
    "ZoomOut": (15.8, 9.6),
    "ZoomOut*": (17.5, 1.1),
}
PUBLISHED_FLIPPED: dict[str, tuple[float, float | None]] = {
    "initial": (44.0, None),
    "ICP": (36.3, None),
    "Deblur": (38.6, None),
    "PMF": (25.9, None),
    "RHM": (33.3, None),
    "BCICP": (19.5, None),
    "ZoomOut": (13.3, None),
    "ZoomOut*": (14.5, None),
}
PUBLISHED_RESAMPLED: dict[str, tuple[float, float | None]] = {
    "initial": (46.5, None),
    "ICP": (29.3, None),
    "Deblur": (44.4, None),
    "PMF": (86.4, None),
    "RHM": (32.0, None),
    "BCICP": (26.0, None),
    "ZoomOut": (21.7, None),
    "ZoomOut*": (24.6, None),
}
# On SHREC'19.
SHREC19: dict[str, tuple[float, float | None]] = {
    "initial": (60.4, None),
    "ICP": (47.0, None),
    "Deblur": (55.4, None),
    "PMF": (51.8, None),
    "RHM": (42.6, None),
    "BCICP": (30.1, None),
    "ZoomOut*": (28.8, None),
}


class Setting(NamedTuple):
    """Pairs, and the source of their initial maps.

    Attributes:
        name: as in the tables.
        pairs: names of target and source.
        load: loads a pair by its names.
        begin: computes (n_t,) and (n_s,) the initial maps of a pair there and back; None if there is none.
        folder: folder of the published maps; None if there are none.
        published: the paper's mean errors and seconds on the same pairs.
    """

    name: str
    pairs: list[tuple[str, str]]
    load: Callable[[str, str], PairOfMeshes]
    begin: Callable[[PairOfMeshes], tuple[Integers | None, Integers | None]]
    folder: Path | None
    published: Mapping[str, tuple[float, float | None]]


def start_from_features(folder: Path, pair: PairOfMeshes) -> tuple[Integers, Integers]:
    of_source, of_target = (
        _features(folder / f"{name}.npy", surface)
        for name, surface in ((pair.source_name, pair.source), (pair.target_name, pair.target))
    )
    return (
        from_descriptors(pair.source, pair.target, of_source, of_target),
        from_descriptors(pair.target, pair.source, of_target, of_source),
    )


def _features(path: Path, surface: Surface) -> Floats:
    """(n, d) the features of a surface in a file."""
    found = np.load(path)
    if found.ndim != 2 or len(found) != len(surface.vertices):
        raise ValueError(
            f"{path} has an array of shape {found.shape}, but needs a row for each of {len(surface.vertices)} vertices."
        )
    return np.asarray(found, dtype=float)


def settings_of_set(folder: Path) -> Iterator[Setting]:
    """The settings in which a set is refined."""
    listed = pair_names(folder, None)
    load = partial(load_pair, folder)
    if (folder / TEMPLATE).is_file():
        kinds = [tuple(name.partition("_")[0] for name in names) for names in listed]
        mixed = [names for names, (a, b) in zip(listed, kinds, strict=True) if a != b and {a, b} <= set(KINDS)]
        yield Setting(f"{folder.name}, SHOT", mixed, load, _start_from_shot, None, PUBLISHED_RESAMPLED)
    elif (folder / f"map_{START}.npz").is_file():
        yield Setting(folder.name, listed, load, partial(published_maps, folder, START), folder, {})
    elif (folder / f"map_{MIRRORED_START}.npz").is_file():
        published = PUBLISHED if folder.name.startswith("faust") else {}
        yield Setting(folder.name, listed, load, _start_from_signatures, folder, published)
        name = f"{folder.name}, flipped edges, 2 landmarks"
        yield Setting(name, listed, partial(_flip, folder), start_from_landmarks, None, PUBLISHED_FLIPPED)


def _flip(folder: Path, target_name: str, source_name: str) -> PairOfMeshes:
    """Flip edges of a pair, differently on each shape."""
    pair = load_pair(folder, target_name, source_name)
    target, source = (with_flipped_edges(each, FLIPPED, seed) for seed, each in enumerate((pair.target, pair.source)))
    return replace(pair, target=target, source=source)


def published_maps(folder: Path | None, method: str, pair: PairOfMeshes) -> tuple[Integers | None, Integers | None]:
    """Published maps of a pair there and back, if the set has them."""
    path = folder and folder / f"map_{method}.npz"
    if path is None or not path.is_file():
        return None, None
    with np.load(path) as maps:
        there, back = f"{pair.target_name}__{pair.source_name}", f"{pair.source_name}__{pair.target_name}"
        return maps.get(there), maps.get(back)


def _start_from_signatures(pair: PairOfMeshes) -> tuple[Integers, Integers]:
    return from_signatures(pair.source, pair.target), from_signatures(pair.target, pair.source)


def start_from_landmarks(pair: PairOfMeshes) -> tuple[Integers, Integers]:
    source, target = (zo.eigenbasis(surface, K_SIGNATURES) for surface in (pair.source, pair.target))
    on_source, on_target = landmarks_of(pair)
    return (
        from_landmarks(source, target, on_source, on_target),
        from_landmarks(target, source, on_target, on_source),
    )


def _start_from_shot(pair: PairOfMeshes) -> tuple[Integers, Integers]:
    return from_shot(pair.source, pair.target), from_shot(pair.target, pair.source)
