# SPDX-License-Identifier: GPL-3.0-or-later
"""Match two layers, or read the correspondence stored on one, and report on it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

import zoomout_core as zo
from meshlab_filter.layer import Layer
from meshlab_filter.stored import Correspondence, read_stored
from zoomout_core.matching.option_table import Interface
from zoomout_core.matching.presets import resolve_detail
from zoomout_core.matching.report.part_report import name_components, notes_on_parts, part_figures
from zoomout_core.mesh.named_parts import NamedParts
from zoomout_core.runtime.progress import portion
from zoomout_core.text_arguments import read_values

if TYPE_CHECKING:
    from pymeshlab import MeshSet

# The list and the parts of `remember_matches`.
_MATCHES: ContextVar[list[zo.MatchResult] | None] = ContextVar("_MATCHES", default=None)
_PARTS: ContextVar[NamedParts | None] = ContextVar("_PARTS", default=None)


def match_layers(source: Layer, target: Layer, candidate: int, **matching: Any) -> zo.MatchResult:
    """Match two layers with the parameters MATCHING."""
    with portion(0.0, 0.85):
        result = zo.match(source.shape, target.shape, **resolve_detail(**read_values(matching, Interface.MESHLAB)))
    if candidate:
        with portion(0.85, 1.0):
            result = result.use(candidate)
    return result


def find_correspondence(
    ms: MeshSet, source: Layer, target: Layer, targetmesh: int, correspondence: str, **matching: Any
) -> tuple[Correspondence | zo.MatchResult, dict[str, Any]]:
    """The correspondence of two layers, stored or computed (STORED_OR_NEW and MATCHING), and notes on it."""
    if correspondence:
        stored = read_stored(ms.mesh(targetmesh), correspondence, source)
        return stored, {"confidence": stored.confidence, "notes": []}
    found = match_layers(source, target, **matching)
    remembered = _MATCHES.get()
    if remembered is not None:
        remembered.append(found)
    return found, report_on(found, source)


@contextmanager
def remember_matches(found: list[zo.MatchResult], parts: NamedParts) -> Iterator[None]:
    """A context in which the results of matches are put into a list: a filter that fails afterwards returns none.

    Reports list the parts of the source with these names, which MeshLab does not keep.
    """
    before = _MATCHES.set(found), _PARTS.set(parts)
    try:
        yield
    finally:
        _MATCHES.reset(before[0])
        _PARTS.reset(before[1])


def report_on(result: zo.MatchResult, source: Layer) -> dict[str, Any]:
    """A filter's report on the correspondence that it computed from a layer."""
    parts = _PARTS.get() or source.parts
    return {
        "confidence": result.confidence,
        "has_partner": result.has_partner,
        "source_has_partner": result.source_has_partner,
        "share_without_partner": result.share_without_partner,
        "source_share_without_partner": result.source_share_without_partner,
        "verdict": name_components(result, parts).verdict._asdict(),
        "certainty": result.certainty,
        "candidates": [
            {"origin": found.origin, "reverses_orientation": found.reverses_orientation, **found.scores}
            for found in result.candidates
        ],
        "parts": part_figures(result, parts),
        "notes": [*notes_on_parts(result, parts), *result.notes],
    }
