# SPDX-License-Identifier: GPL-3.0-or-later
"""Sampled ZoomOut from 20 to 200 functions with given bases, compared with pyFMaps on the same pair in one run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from pyFM.refine.zoomout import zoomout_refine
from pyFM.spectral import FM_to_p2p

import zoomout_core as zo
from zoomout_core.maps.functional_map import functional_map_of
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.spectral.sampling import farthest_points

# Meshes of one class have the same vertex order, so the identity is the truth.
PAIRS = (("horse0", "horse6"), ("michael0", "michael10"))
K_INITIAL, K_FINAL, STEP, SAMPLES = 20, 200, 5, 1000
REPEATS = 3


def run(data: Path, pairs: int | None) -> list[dict[str, Any]]:
    """A row for each pair and library: median seconds of the refinement and the dense map, and the mean error.

    Both get the same bases, the same true map of size 20, and the same farthest-point samples; ours chooses
    them within its time. Errors are Euclidean between vertices, over the square root of the area.
    """
    folder = data / "tosca_full" if (data / "tosca_full").is_dir() else data
    rows = []
    for target_name, source_name in PAIRS[:pairs]:
        paths = [folder / f"{name}.off" for name in (target_name, source_name)]
        if not all(path.is_file() for path in paths):
            continue
        target, source = (read_surface(path) for path in paths)
        basis_target, basis_source = (zo.eigenbasis(surface, K_FINAL) for surface in (target, source))
        identity = np.arange(len(target.vertices))
        initial = functional_map_of(identity, basis_source, basis_target, K_INITIAL, K_INITIAL)
        samples = [farthest_points(basis.points, SAMPLES) for basis in (basis_source, basis_target)]

        def ours(basis_source=basis_source, basis_target=basis_target, initial=initial) -> np.ndarray:  # type: ignore[no-untyped-def]
            return zo.zoomout(basis_source, basis_target, initial, K_FINAL, STEP, SAMPLES).vertex

        def peer(basis_source=basis_source, basis_target=basis_target, initial=initial, samples=samples) -> np.ndarray:  # type: ignore[no-untyped-def]
            iterations = (K_FINAL - K_INITIAL) // STEP
            eigenvectors = basis_source.eigenvectors, basis_target.eigenvectors
            C = zoomout_refine(initial, *eigenvectors, nit=iterations, step=STEP, subsample=samples)
            return np.asarray(FM_to_p2p(C, *eigenvectors))

        for system, refine in (("zoomout_core", ours), ("pyFMaps", peer)):
            vertex, seconds = _time(refine)
            error = np.linalg.norm(source.vertices[vertex] - source.vertices, axis=1) / np.sqrt(source.area)
            rows.append(
                {
                    "pair": f"{target_name} {source_name}",
                    "vertices": len(identity),
                    "system": system,
                    "seconds": seconds,
                    "mean error": float(1000 * error.mean()),
                }
            )
    return rows


def _time(refine: Callable[[], np.ndarray]) -> tuple[np.ndarray, float]:
    seconds = []
    for _ in range(REPEATS):
        start = perf_counter()
        vertex = refine()
        seconds.append(perf_counter() - start)
    return vertex, float(np.median(seconds))
