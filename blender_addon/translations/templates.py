# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences composed of others and of values, found again in a table of templates.

A key of such a table is a sentence as it stands in the code, with `{}` for each value; where only some words can stand
there, as "source" and "target" whose articles differ in another language, it may have these. Its translation has as
many `{}`, or `{0}`, `{1}` where values change places.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

# A name ends at the first quotation mark that is not an apostrophe within it. What a sentence was continued from is as
# long as can be; a value within it has no semicolon, but before it, as what is added to a sentence.
NAME, NUMBER, BEGINNING = r"((?:(?!'[^\w]).)+?)", r"([\d.,]+%?)", "(.*)"
VALUE, END = "((?:; )?(?:(?!; ).)*?)", "(.*?)"
BETWEEN_SENTENCES = re.compile(r"((?<=[.?!]) (?=['A-Z0-9])|; (?=[A-Z]))")


class Template(NamedTuple):
    """A key with its translation.

    Attributes:
        pattern: whose groups are the values.
        longest: of what stands between them: a text without it need not be compared.
        parts: what stands between them.
        translation: into which the values are put.
    """

    pattern: re.Pattern[str]
    longest: str
    parts: list[str]
    translation: str

    def is_quoted(self, value: int) -> bool:
        """Whether a value is the name of an object or the like, which stays as it is."""
        return self.parts[value].endswith("'") and self.parts[value + 1].startswith("'")

    def is_label(self, value: int) -> bool:
        """Whether a value stands before a colon, as names of layers do, and nouns for several."""
        return value == 0 and not self.parts[0] and self.parts[1].startswith(": ")

    def _pattern_of(self, value: int) -> str:
        if self.is_quoted(value):
            return NAME
        if value + 2 == len(self.parts) and not self.parts[-1]:
            return END
        if value or self.parts[0]:
            return VALUE
        # Else "{} shapes" would be found in any unknown sentence that ends so.
        counts = self.parts[1].startswith(" ") and not self.parts[-1].endswith(".")
        return NUMBER if counts else BEGINNING

    @staticmethod
    def of(key: str, translation: str) -> Template:
        """A key of a table, made ready."""
        parts = key.split("{}")
        raw = Template(re.compile(""), max(parts, key=len), parts, translation)
        between = (raw._pattern_of(value) + re.escape(part) for value, part in enumerate(parts[1:]))
        return raw._replace(pattern=re.compile(re.escape(parts[0]) + "".join(between), re.DOTALL))


class Translator:
    """Translates what stands in tables, and what is composed of that; anything else stays as it is.

    Args:
        messages: labels and tooltips with their translations.
        sentences: sentences, templates and nouns with theirs.
    """

    def __init__(self, messages: Mapping[str, str], sentences: Mapping[str, str]) -> None:
        self._sentences = sentences
        self._beginnings = {key.partition(": ")[0] for key in sentences if ": " in key}
        self._table = {**messages, **sentences}
        # Those with the most words of their own first: they say more exactly what a text is.
        keys = sorted((key for key in self._table if "{}" in key), key=lambda key: -len(key.replace("{}", "")))
        self._templates = [Template.of(key, self._table[key]) for key in keys]

    def __call__(self, text: str) -> str:
        """A text in the other language, or as much of it as there is."""
        found = self._translate(text)
        if found is not None:
            return found
        parts = BETWEEN_SENTENCES.split(text)
        if len(parts) > 1:
            parts[::2] = map(self, parts[::2])
            return "".join(parts)
        for between in ("; ", ", "):
            if between in text:
                return between.join(map(self, text.split(between)))
        return text

    def _translate(self, text: str) -> str | None:
        """The translation of a whole text, or None."""
        if text in self._table:
            return self._table[text]
        if text.endswith(".") and text[:-1] in self._table:  # there is a full stop in one place, and none in another
            return f"{self._table[text[:-1]]}."
        return self._of_each(text) or self._translate_labelled(text) or self._compose(text)

    def _of_each(self, text: str) -> str | None:
        """Of sentences that each have one."""
        parts = BETWEEN_SENTENCES.split(text)
        found = [self._translate(sentence) for sentence in parts[::2]] if len(parts) > 1 else [None]
        if None in found:
            return None
        parts[::2] = map(str, found)
        return "".join(parts)

    def _compose(self, text: str) -> str | None:
        for known in self._templates:
            if known.longest in text and (match := known.pattern.fullmatch(text)):
                values = (self._value(known, number, value) for number, value in enumerate(match.groups()))
                return known.translation.format(*values)
        return None

    def _value(self, known: Template, number: int, value: str) -> str:
        if known.is_quoted(number):
            return value
        return self._translate_name(value) if known.is_label(number) else self(value)

    def _translate_name(self, name: str) -> str:
        """What stands before a colon: a noun, but never what a label says, for a layer may be called "Mask"."""
        return self._sentences.get(name, name)

    def _translate_labelled(self, text: str) -> str | None:
        """Of a sentence about something whose name stands before it, as that of a UV map."""
        name, colon, rest = text.partition(": ")
        found = self._translate(rest) if colon and "'" not in name and name not in self._beginnings else None
        return found and f"{self._translate_name(name)}: {found}"
