# SPDX-License-Identifier: GPL-3.0-or-later
"""Report on outfits: `report.json` for programs, and `report.html`, one page with pictures for any browser."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict
from typing import Any

from zoomout_core.collection.picture_page import picture_card, picture_page
from zoomout_core.collection.report import PAGE, REPORT
from zoomout_core.matching.report.verdict import AMBER, GREEN, LEVELS, RED
from zoomout_core.messages import Message, enumeration, message, note_figures, note_lines
from zoomout_core.outfits.batch import OutfitsResult
from zoomout_core.outfits.check import REST, SPREAD, SWING
from zoomout_core.outfits.dress_file import OutfitName, Worn, place_of_picture
from zoomout_core.runtime.outputs import atomic_write
from zoomout_core.translations import ENGLISH

# A share of cloth in each pose, and the number of avatars with a verdict of each level.
IN_POSES = {REST: "{share:.2%} (rest)", SWING: "{share:.2%} (swing)", SPREAD: "{share:.2%} (spread)"}
OF_LEVELS = {GREEN: "{count} green", AMBER: "{count} amber", RED: "{count} red"}


def figures_of_outfits(result: OutfitsResult) -> dict[str, Any]:
    """The fit of the outfits, as values that JSON can store; those to check come first."""
    rows = []
    for name, worn in _in_order(result):
        row = asdict(worn)
        for unused in ("key", "level", "sentence", "advice"):
            del row[unused]
        rows.append({**name._asdict(), "verdict": worn.verdict._asdict(), **row, **note_figures(worn.notes)})
    return {
        "matched_now": result.matched,
        "dressed_now": result.dressed,
        "verdicts": _count_levels(result),
        "outfits": rows,
        "failures": result.failures,
    }


def lines_of_outfits(result: OutfitsResult) -> list[str]:
    """The same in sentences."""
    lines: list[str] = [_summary(result)]
    lines += [f"{name}: {worn.verdict.line}" for name, worn in _in_order(result) if worn.level != LEVELS[0]]
    lines += [f"{name}: failed. {reason}" for name, reason in result.failures.items()]
    return lines


def write_reports(result: OutfitsResult, language: str = ENGLISH) -> None:
    """Write `report.json`, and `report.html` in a language, to the folder of the results.

    Raises:
        OutputError: they cannot be written.
    """
    with atomic_write(result.folder / REPORT) as part:
        part.write_text(f"{json.dumps(figures_of_outfits(result), indent=1)}\n", encoding="utf-8")
    with atomic_write(result.folder / PAGE) as part:
        part.write_text(page_of(result, language), encoding="utf-8", errors="backslashreplace")


def page_of(result: OutfitsResult, language: str = ENGLISH) -> str:
    """The HTML page in a language."""
    return picture_page(
        result.folder.absolute().name,
        _summary(result),
        message("All outfits, those to look at first"),
        message("Each avatar from the front, from the back, and in two poses. Cloth that came into the skin is red."),
        (_card(result, name, worn, language) for name, worn in _in_order(result)),
        result.failures,
        language,
    )


def _card(result: OutfitsResult, name: OutfitName, worn: Worn, language: str) -> str:
    """The picture of an outfit on an avatar, with its verdict and figures."""
    inside = (message(IN_POSES[pose], share=share) for pose, share in worn.inside.items())
    stretched = worn.stretched
    about = [
        worn.verdict.line,
        message(
            "Cloth in the skin: {shares}. Stretched edges: {share:.2%}.", shares=enumeration(inside), share=stretched
        ),
        f"{worn.output}: {', '.join(worn.objects)}.",
        *note_lines(worn.notes),
    ]
    title = message("{outfit} on {avatar}", **name._asdict())
    return picture_card(title, worn.level, (result.folder / place_of_picture(name)).read_bytes(), about, language)


def _summary(result: OutfitsResult) -> Message:
    """The number of avatars of each verdict."""
    if not result.worn:
        return message("No avatar was dressed.")
    levels = (message(OF_LEVELS[level], count=count) for level, count in _count_levels(result).items() if count)
    return message("Dressed avatars: {levels}.", levels=enumeration(levels))


def _in_order(result: OutfitsResult) -> list[tuple[OutfitName, Worn]]:
    """The worst verdicts first, then by name."""
    return sorted(result.worn.items(), key=lambda row: (-LEVELS.index(row[1].level), row[0]))


def _count_levels(result: OutfitsResult) -> dict[str, int]:
    levels = Counter(worn.level for worn in result.worn.values())
    return {level: levels[level] for level in LEVELS}
