# SPDX-License-Identifier: GPL-3.0-or-later
"""How fine to match, in words: the same for the command line, Blender and MeshLab."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from zoomout_core.matching.options import SMALLEST_FINAL, MatchOptions

# Arguments of `match` for each preset: eigenfunctions, samples, vertices. They are part of the public interface.
DETAIL: dict[str, dict[str, int | None]] = {
    "fast": {"k_final": 60, "samples": 500, "proxy_vertices": 2000},
    "balanced": {},
    "fine": {"k_final": 200, "samples": 1500, "proxy_vertices": 8000},
    "full": {"k_final": 200, "samples": 2000, "proxy_vertices": None},
}


def sizes_in_words(detail: str) -> str:
    """The arguments of `match` for a level of detail."""
    sizes = {field.name: field.default for field in fields(MatchOptions)} | DETAIL[detail]
    return ", ".join(f"{name}={sizes[name]!r}" for name in DETAIL["fast"])


def resolve_detail(detail: str = "balanced", k_final: int = 0, **options: Any) -> dict[str, Any]:
    """Arguments of `match` for the options of its interfaces, which have a level of detail for most sizes.

    Args:
        detail: one of `DETAIL`.
        k_final: size of the final functional map; 0 for the size that belongs to `detail`.
        options: other arguments of `match`, which override those of `detail`.
    """
    if detail not in DETAIL:
        raise ValueError(f"detail is {detail!r}: choose one of {', '.join(DETAIL)}.")
    sizes = dict(DETAIL[detail])
    if k_final:  # `match` reports one that is not a number
        sizes["k_final"] = max(k_final, SMALLEST_FINAL) if isinstance(k_final, int) else k_final
    return sizes | options
