# SPDX-License-Identifier: GPL-3.0-or-later
"""A page of pictures with verdicts, in one file for any browser: the report of a batch."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from string import Template

TEMPLATE = Template((Path(__file__).parent / "picture_page.html").read_text(encoding="utf-8"))


def picture_page(
    title: str, summary: str, heading: str, about: str, cards: Iterable[str], failures: Mapping[str, str]
) -> str:
    """The HTML of a page.

    Args:
        title: its title.
        summary: a sentence about all results.
        heading: heading above the pictures.
        about: a sentence on what they show.
        cards: the pictures, see `picture_card`.
        failures: what failed and why, by name.
    """
    failed = "".join(f"<p><b>{escape(name)}</b>: {escape(why)}</p>" for name, why in failures.items())
    return TEMPLATE.substitute(
        title=escape(title),
        summary=f"<p>{escape(summary)}</p>",
        heading=escape(heading),
        about=escape(about),
        cards="".join(cards),
        failures=f"<h2>Failed</h2>{failed}" * bool(failed),
    )


def picture_card(name: str, level: str, png: bytes, lines: Iterable[str]) -> str:
    """The HTML of a picture, in the colour of the level of its verdict, with sentences below."""
    data = b64encode(png).decode()
    return (
        f'<figure class="{level}"><img loading="lazy" alt="{escape(name)}" src="data:image/png;base64,{data}">'
        f"<figcaption><b>{escape(name)}</b>{''.join(f'<small>{escape(line)}</small>' for line in lines)}"
        "</figcaption></figure>"
    )
