# SPDX-License-Identifier: GPL-3.0-or-later
"""Reports of commands: sentences for a reader, or JSON for a program."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

import click
import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.command_options import tell
from zoomout_core.matching.result import MatchResult

# Confidence below which a vertex counts as doubtful.
LOW = 0.5


def json_option(command: Any) -> Any:
    """Add an option to report as JSON to a command."""
    return click.option("--json", "as_json", is_flag=True, help="Print the report as JSON.")(command)


def say(lines: Iterable[str], figures: Mapping[str, Any], as_json: bool) -> None:
    """Print the report of a command, as lines or as JSON."""
    if as_json:
        click.echo(json.dumps(figures, indent=1))
        return
    for line in lines:
        tell(line)


def match_figures(result: MatchResult) -> dict[str, Any]:
    """Figures of a match for programs."""
    return {
        "verdict": result.verdict._asdict(),
        "certainty": result.certainty,
        "mean_confidence": float(result.confidence.mean()),
        "low_confidence": float((result.confidence < LOW).mean()),
        "share_without_partner": result.share_without_partner,
        "source_share_without_partner": result.source_share_without_partner,
        "torn": result.target.share_of_area(result.torn),
        "filled": result.target.share_of_area(result.filled),
        "parts": part_figures(result),
        "candidates": len(result.candidates),
    }


def part_figures(result: MatchResult) -> list[dict[str, float]]:
    """For each component of the source the visible share of the source, and the share of the target that receives."""
    return [
        {"part": number, "visible": float(visible), "arrived": float(arrived)}
        for number, (visible, arrived) in enumerate(zip(result.pair.shares, result.arrived, strict=True))
    ]


def match_lines(result: MatchResult) -> list[str]:
    """The same figures in sentences."""
    low = (result.confidence < LOW).mean()
    return [
        result.verdict.line,
        f"Mean confidence {result.confidence.mean():.2f}; {low:.1%} of the vertices are doubtful (below {LOW}).",
        f"Without a partner: {result.share_without_partner:.1%} of the target's area, "
        f"{result.source_share_without_partner:.1%} of the source's.",
    ]


def spread_of(values: Floats) -> dict[str, float]:
    """The mean, the median and the 95th percentile of some values."""
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "95th percentile": float(np.percentile(values, 95)),
    }


def spread_in_words(spread: Mapping[str, float]) -> str:
    """A spread in words, for a sentence."""
    return ", ".join(f"{name} {value:.1f}" for name, value in spread.items())
