# SPDX-License-Identifier: GPL-3.0-or-later
"""Reports of commands: sentences for a reader, or JSON for a program."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

import click
import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.cli.group import JSON
from zoomout_core.command_options import tell
from zoomout_core.matching.report.part_report import name_components, notes_on_parts, part_figures
from zoomout_core.matching.report.verdict import GREEN, LOW_CONFIDENCE
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.named_parts import NamedParts


def json_option(command: Any) -> Any:
    """Add an option to report as JSON to a command."""
    return click.option(JSON, "as_json", is_flag=True, help="Print the report as JSON.")(command)


def say(lines: Iterable[str], figures: Mapping[str, Any], as_json: bool) -> None:
    """Print the report of a command, as lines or as JSON."""
    if as_json:
        click.echo(json.dumps(figures, indent=1))
        return
    for line in lines:
        tell(line)


def match_figures(result: MatchResult, parts: NamedParts) -> dict[str, Any]:
    """Figures of a match for programs, with the shares of the source's parts."""
    result = name_components(result, parts)
    return {
        "verdict": result.verdict._asdict(),
        "certainty": result.certainty,
        "mean_confidence": float(result.confidence.mean()),
        "low_confidence": float((result.confidence < LOW_CONFIDENCE).mean()),
        "share_without_partner": result.share_without_partner,
        "source_share_without_partner": result.source_share_without_partner,
        "torn": result.target.share_of_area(result.torn),
        "filled": result.target.share_of_area(result.filled),
        "parts": part_figures(result, parts),
        "candidates": len(result.candidates),
    }


def match_notes(result: MatchResult, parts: NamedParts) -> list[str]:
    """Notes on a match, and on the source's parts."""
    return [*notes_on_parts(result, parts), *result.notes]


def match_lines(result: MatchResult, parts: NamedParts) -> list[str]:
    """The same figures in sentences, the verdict first."""
    result = name_components(result, parts)
    low = (result.confidence < LOW_CONFIDENCE).mean()
    return [
        result.verdict.line,
        *_ways_out(result),
        f"Mean confidence {result.confidence.mean():.2f}; {low:.1%} of the vertices are doubtful "
        f"(below {LOW_CONFIDENCE}).",
        f"Without a partner: {result.share_without_partner:.1%} of the target's area, "
        f"{result.source_share_without_partner:.1%} of the source's.",
    ]


def _ways_out(result: MatchResult) -> list[str]:
    """How to use another candidate, if a match is in doubt."""
    last = len(result.candidates) - 1
    if result.verdict.level == GREEN or not last:
        return []
    return [
        f"The other candidates are --candidate {'1' if last == 1 else f'1 to {last}'}; this one is {result.chosen}."
    ]


def spread_of(values: Floats) -> dict[str, float]:
    """The mean, the median and the 95th percentile of values (n,)."""
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "percentile_95": float(np.percentile(values, 95)),
    }


def spread_in_words(spread: Mapping[str, float]) -> str:
    """A spread in words, for a sentence."""
    words = {"percentile_95": "95th percentile"}
    return ", ".join(f"{words.get(name, name)} {value:.1f}" for name, value in spread.items())
