"""How fine to match, in words: what every door into the core offers its users."""

from __future__ import annotations

# Arguments of `match` for each preset.
DETAIL: dict[str, dict[str, int | None]] = {
    "fast": {"k_final": 60, "samples": 500, "proxy_vertices": 2000},
    "balanced": {},
    "fine": {"k_final": 200, "samples": 1500, "proxy_vertices": 8000},
    "full": {"k_final": 200, "samples": 2000, "proxy_vertices": None},
}
