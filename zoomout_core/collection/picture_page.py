# SPDX-License-Identifier: GPL-3.0-or-later
"""A page of pictures with verdicts, in one file for any browser: the report of a batch."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from string import Template

from zoomout_core.messages import message
from zoomout_core.translations import ENGLISH, in_language

TEMPLATE = Template((Path(__file__).parent / "picture_page.html").read_text(encoding="utf-8"))


def picture_page(
    title: str,
    summary: str,
    heading: str,
    about: str,
    cards: Iterable[str],
    failures: Mapping[str, str],
    language: str = ENGLISH,
) -> str:
    """The HTML of a page.

    Args:
        title: its title.
        summary: a sentence about all results.
        heading: heading above the pictures.
        about: a sentence about the pictures.
        cards: the pictures, see `picture_card`.
        failures: what failed and why, by name.
        language: language of the page, into which all texts but the title are translated.
    """
    failed = "".join(f"<p><b>{escape(name)}</b>: {_html(why, language)}</p>" for name, why in failures.items())
    return TEMPLATE.substitute(
        language=language,
        title=escape(title),
        summary=f"<p>{_html(summary, language)}</p>",
        heading=_html(heading, language),
        about=_html(about, language),
        cards="".join(cards),
        failures=f"<h2>{_html(message('Failed'), language)}</h2>{failed}" * bool(failed),
    )


def picture_card(name: str, level: str, png: bytes, lines: Iterable[str], language: str = ENGLISH) -> str:
    """The HTML of a picture, in the colour of the level of its verdict, with sentences below, see `picture_page`."""
    data, title = b64encode(png).decode(), _html(name, language)
    return (
        f'<figure class="{level}"><img loading="lazy" alt="{title}" src="data:image/png;base64,{data}">'
        f"<figcaption><b>{title}</b>{''.join(f'<small>{_html(line, language)}</small>' for line in lines)}"
        "</figcaption></figure>"
    )


def _html(text: str, language: str) -> str:
    """The HTML of a text, translated."""
    return escape(in_language(text, language))
