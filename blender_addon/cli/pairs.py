# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands `match`, `transfer`, `wrap` and `dress`."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from bpy.types import Context

import zoomout_core as zo

from ..jobs import Work, run
from ..properties.dress import DressOptions
from ..properties.match import MatchOptions
from ..properties.transfer import BindOptions, BlendOptions
from ..properties.wrap import WrapOptions
from ..scene.selection import worn_names
from ..services.binding.write import hide_sources
from ..services.dressing.dress import prepare_dress
from ..services.dressing.read import Dressing
from ..services.matching.collection_match import check_verdicts, match_collections_async
from ..services.matching.made_match import MatchUse
from ..services.matching.match import prepare_match
from ..services.targets import Write, each_target
from ..services.transfer import prepare_transfer
from ..services.wrap import Wrapping, check_one_target, prepare_wrap
from ..storage import stored_match
from .property_arguments import as_in_sidebar

Result = TypeVar("Result")

GIVE_FORCE = "To use this match anyway, give --force."


def match(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Match, and report on each target by name.

    Raises:
        MeshError: the collections cannot be matched; nothing was written.
    """
    if options.target_collection:
        return {name: _entry(*matched) for name, matched in _match_collections(context, options).items()}

    def work(target: str) -> Work[Write[stored_match.Match]]:
        return prepare_match(context, options.source, target, **_match_options(options))

    return _reports(dict.fromkeys(options.targets, options.source), work, _entry)


def transfer(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Transfer, and report on each target by name.

    Raises:
        MeshError: new names of groups are malformed, the collections cannot be matched, or their match is probably
            wrong; nothing was written.
    """
    settings = BlendOptions.settings(as_in_sidebar(options, BlendOptions))
    binding = BindOptions.how_to_bind(as_in_sidebar(options, BindOptions)) if options.bind else None
    if options.target_collection:
        matches = _match_collections(context, options)
        check_verdicts(matches, options.force)
        source_of = {name: source for name, (source, _) in matches.items()}
        matching: dict[str, Any] = {}
    else:
        source_of, matching = dict.fromkeys(options.targets, options.source), _match_options(options)
    use = _match_use(options)

    def work(target: str) -> Work[Write[dict[str, Any]]]:
        return prepare_transfer(context, source_of[target], target, options.data, settings, binding, use, **matching)

    reports = _reports(source_of, work, lambda _, report: dict(report))
    if options.hide_source:
        hide_sources(context, (report for report in reports.values() if "error" not in report))
    return reports


def wrap(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Wrap, and report on each target by name.

    Raises:
        MeshError: there are several targets to wrap the source onto.
    """
    wrapping = Wrapping(**WrapOptions.wrap_options(as_in_sidebar(options, WrapOptions)))
    check_one_target(wrapping, options.targets)

    def work(target: str) -> Work[Write[dict[str, Any]]]:
        use = _match_use(options)
        return prepare_wrap(context, options.source, target, wrapping, use, **_match_options(options))

    return _reports(dict.fromkeys(options.targets, options.source), work, lambda _, report: dict(report))


def dress(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Dress, and report on each target by name.

    Raises:
        MeshError: there is no collection of that name.
    """
    dressing = Dressing(**DressOptions.dress_options(as_in_sidebar(options, DressOptions)))
    of_collection = worn_names(context, options.source, "", options.collection) if options.collection else []
    names = [*options.things, *of_collection]

    def work(target: str) -> Work[Write[dict[str, Any]]]:
        use = _match_use(options)
        return prepare_dress(context, options.source, target, names, dressing, use, **_match_options(options))

    return _reports(dict.fromkeys(options.targets, options.source), work, lambda _, report: dict(report))


def _match_options(options: argparse.Namespace) -> dict[str, Any]:
    """Arguments of `match_objects`."""
    return MatchOptions.match_options(as_in_sidebar(options, MatchOptions))


def _match_use(options: argparse.Namespace) -> MatchUse:
    """How to use a match: whether to refuse one that is probably wrong."""
    return MatchUse(force=options.force, remedy=GIVE_FORCE)


def _match_collections(
    context: Context, options: argparse.Namespace
) -> dict[str, tuple[str, stored_match.StoredMatch]]:
    """Match the meshes of two collections; returns the source and the match of each target."""
    names = options.source_collection, options.target_collection
    return run(match_collections_async(context, *names, detail=options.detail))


def _entry(source: str, match: stored_match.Match) -> dict[str, Any]:
    """The report of a match."""
    return {
        "source": source,
        "others": list(match.others) if isinstance(match, stored_match.StoredMatch) else [],
        "vertices": len(match.confidence),
        "low_confidence": stored_match.low_confidence(match.confidence),
        "without_partner": stored_match.without_partner(match),
        "mean_confidence": float(match.confidence.mean()),
        "verdict": stored_match.pack_verdict(match),
        "certainty": match.certainty if isinstance(match, zo.MatchResult) else None,
        "notes": list(match.notes),
    }


def _reports(
    source_of: Mapping[str, str],
    work: Callable[[str], Work[Write[Result]]],
    entry: Callable[[str, Result], dict[str, Any]],
) -> dict[str, Any]:
    """The report on each target, or the reason why it failed, by name."""
    outcome = run(each_target(list(source_of), work))
    done = {name: entry(source_of[name], result) for name, result in outcome.done.items()}
    failed = {name: {"error": reason} for name, reason in outcome.failed.items()}
    return {name: (done | failed)[name] for name in source_of}
