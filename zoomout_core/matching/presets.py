"""How fine to match, in words: the same for the command line, Blender and MeshLab."""

from __future__ import annotations

# Arguments of `match` for each preset: eigenfunctions, samples, vertices. They are part of the public interface.
DETAIL: dict[str, dict[str, int | None]] = {
    "fast": {"k_final": 60, "samples": 500, "proxy_vertices": 2000},
    "balanced": {},
    "fine": {"k_final": 200, "samples": 1500, "proxy_vertices": 8000},
    "full": {"k_final": 200, "samples": 2000, "proxy_vertices": None},
}
