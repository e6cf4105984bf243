# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the tables of docs/options.md from the table of options: `python tools/option_page.py`.

`tests/tools/test_option_page.py` fails if the page is out of date.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from zoomout_core.matching.option_table import ACCURACY, MATCHING, NEAREST, RESULT, Interface, Kind, Option
from zoomout_core.matching.presets import DETAIL, sizes_in_words

PAGE = Path(__file__).resolve().parent.parent / "docs" / "options.md"
BEGIN, END = "<!-- Written by tools/option_page.py. -->", "<!-- Up to here. -->"
SECTIONS = {
    "Start and evidence": MATCHING,
    "Detail": ACCURACY,
    "Clothes on a body": NEAREST,
    "Other candidates": RESULT,
}


def tables() -> str:
    """The generated part of the page."""
    sections = (f"## {title}\n\n{_options(options)}\n{_choices(options)}" for title, options in SECTIONS.items())
    return "\n\n".join(section.strip() for section in sections)


def page(text: str) -> str:
    """The page with its generated part replaced."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{tables()}\n\n{END}{after}"


def _options(options: Sequence[Option]) -> str:
    rows = (
        [*(_name(option, interface) for interface in Interface), _values(option), f"{option.help}."]
        for option in options
    )
    return _table([*(interface.value for interface in Interface), "Values", "Meaning"], rows)


def _choices(options: Sequence[Option]) -> str:
    found = ""
    for option in options:
        if option.choices:
            rows = (
                [
                    f"`{choice.name}`",
                    ", ".join(interface.value for interface in option.interfaces_of(choice)),
                    f"{choice.help}.",
                ]
                for choice in option.choices
            )
            found += f"\nValues of `{option.name}`:\n\n{_table(['Value', 'Offered by', 'Meaning'], rows)}\n"
        if option.name == "detail":
            rows = ([f"`{word}`", f"`{sizes_in_words(word)}`"] for word in DETAIL)
            found += f"\nIn Python, sizes replace `detail`:\n\n{_table(['Value', 'Arguments of `zo.match`'], rows)}\n"
    return found


def _name(option: Option, interface: Interface) -> str:
    if interface not in option.interfaces:
        return ""
    name = option.name_in(interface)
    return f"*{name}*" if interface is Interface.BLENDER else f"`{name}`"


def _values(option: Option) -> str:
    default = option.default
    if option.kind is Kind.FLAG:
        default = "on" if default else "off"
    return option.kind.value if default in (None, "") else f"{option.kind.value}; default {default}"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def main() -> None:
    """Update the page."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
