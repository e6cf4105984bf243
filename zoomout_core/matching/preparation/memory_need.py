# SPDX-License-Identifier: GPL-3.0-or-later
"""The memory that a match needs; a match that needs more than is free is refused before it begins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.preparation.analysis import ANALYSIS
from zoomout_core.matching.preparation.proxy import ProxyVertices, proxy_size
from zoomout_core.matching.presets import DETAIL
from zoomout_core.mesh.memory import NotEnoughMemoryError
from zoomout_core.messages import enumeration, message
from zoomout_core.runtime.memory import free_memory

# A linear model of the bytes that a match takes: a constant, bytes per vertex, and bytes per value at a vertex of a
# proxy. It is exact to a quarter for pairs of creatures of 5,000 to 300,000 vertices, at every detail. A proxy has its
# eigenfunctions, and distances and other data that count as MORE_FUNCTIONS further ones.
CONSTANT, PER_VERTEX, PER_VALUE, MORE_FUNCTIONS = 40 << 20, 800, 44, 300
GIB = 1 << 30
COARSER = "use detail '{detail}' (in Python proxy_vertices={vertices})"


def memory_need(vertices: Sequence[int], k_final: int, proxy_vertices: ProxyVertices) -> int:
    """Approximate bytes for analysing and matching meshes with these numbers of vertices."""
    of_proxies = sum(min(n, proxy_size(n, proxy_vertices) or n) for n in vertices)
    functions = max(k_final, ANALYSIS.min_functions) + MORE_FUNCTIONS
    return CONSTANT + PER_VERTEX * sum(vertices) + PER_VALUE * functions * of_proxies


def check_memory(vertices: Sequence[int], k_final: int, proxy_vertices: ProxyVertices) -> None:
    """Refuse a match of meshes of some numbers of vertices that does not fit into the free memory, if that is known.

    Raises:
        NotEnoughMemoryError: it does not fit; the message says which size would, and which detail.
    """
    need, free = memory_need(vertices, k_final, proxy_vertices), free_memory()
    if free is None or need <= free:
        return
    ways = []
    for name, numbers in reversed(DETAIL.items()):
        coarser = MatchOptions(**numbers)  # type: ignore[arg-type]
        coarser_need = memory_need(vertices, coarser.k_final, coarser.proxy_vertices)
        if coarser_need < need and coarser_need <= free:
            ways.append(message(COARSER, detail=name, vertices=repr(coarser.proxy_vertices)))
            break
    parts = np.linspace(0.99, 0.01, 99)
    sizes = ([int(part * n) for n in vertices] for part in parts)
    fitting = next((size for size in sizes if memory_need(size, k_final, proxy_vertices) <= free), None)
    if fitting is not None:
        ways.append(message("simplify them to {vertices} vertices", vertices=_counts(fitting)))
    raise NotEnoughMemoryError(
        "Meshes of {vertices} vertices need about {need:.1f} GiB of memory, but only {free:.1f} GiB are free: {ways}.",
        vertices=_counts(vertices),
        need=need / GIB,
        free=free / GIB,
        ways=enumeration([*ways, message("close other programs")], ", or "),
    )


def _counts(numbers: Sequence[int]) -> str:
    return " and ".join(f"{number:,}" for number in numbers)
