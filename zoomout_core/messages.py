# SPDX-License-Identifier: GPL-3.0-or-later
"""Translatable sentences for the user, which keep their template and its values.

A template is English text with named fields, such as "'{name}' has only {count} vertices.". It is the key of a
translation, so it must be a literal in a call of `message`, `warning`, `plural` or `plural_warning`. A word that takes
another article or ending in other languages is not a field; each needs its own template. For this an f-string may fill
in a `{role}` such as "source" or "target" at once, and has doubled braces around fields.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from numbers import Integral, Real
from string import Formatter
from typing import Any

NO_MEMORY = "There is not enough memory: close other programs, use a coarser detail, or use meshes with fewer vertices."
# Maximum length of a format specification in a stored template: a longer one could request gigabytes of spaces.
MAX_FORMAT_LENGTH = 4
# Maximum number of characters of a path in a sentence; one that is too long for the system would fill the terminal.
MAX_NAME_LENGTH = 200
# JSON keys of a stored Message, and of a stored dictionary with Messages as keys.
MESSAGE, ITEMS = "zoomout_message", "zoomout_items"


class Message(str):
    """An English sentence with its template and values.

    Attributes:
        template: text with named fields.
        values: values of these fields. Messages among them are translated; other text, such as a name, is not.
        is_warning: whether the user should check or do something, rather than only know it.
    """

    template: str
    values: dict[str, Any]
    is_warning: bool

    def __new__(cls, template: str, values: dict[str, Any], is_warning: bool = False) -> Message:
        values = {name: _storable(value) for name, value in values.items()}
        made = super().__new__(cls, template.format(**values))
        made.template, made.values, made.is_warning = template, values, is_warning
        return made

    def __str__(self) -> str:
        """Itself, so that `str` of an exception is still a Message."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return Message, (self.template, self.values, self.is_warning)


def message_of(error: Exception) -> str:
    """The message of an error for the user; that of the system about a file is turned into a sentence."""
    if not isinstance(error, OSError) or error.errno is None:  # the errors of this project have no number
        return str(error)
    reason = error.strerror or type(error).__name__
    if error.filename is None:
        return f"A file could not be read or written ({reason}): check disk space and permissions."
    name = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes | os.PathLike) else str(error.filename)
    shown = name if len(name) <= MAX_NAME_LENGTH else f"{name[:MAX_NAME_LENGTH]}…"
    return f"{shown} could not be used ({reason}): check the path and its permissions."


def message(template: str, **values: Any) -> Message:
    """Make a Message: "{name}" in its template is replaced by the value `name`, optionally formatted: "{share:.0%}"."""
    return Message(template, values)


def warning(template: str, **values: Any) -> Message:
    """Make a Message as `message` does, about something that the user should check or do."""
    return Message(template, values, is_warning=True)


def is_warning(text: str) -> bool:
    """Whether text is a Message about something that the user should check or do."""
    return isinstance(text, Message) and text.is_warning


def note_lines(notes: Iterable[str]) -> list[str]:
    """Notes as command lines print them: warnings come first, and are marked like errors."""
    notes = list(notes)
    warnings = [message("Warning: {note}", note=note) for note in notes if is_warning(note)]
    return [*warnings, *(note for note in notes if not is_warning(note))]


def note_figures(notes: Iterable[str]) -> dict[str, list[str]]:
    """Notes for programs: all of them, and the warnings among them."""
    notes = list(notes)
    return {"notes": notes, "warnings": [note for note in notes if is_warning(note)]}


def plural(count: int, one: str, several: str, **values: Any) -> Message:
    """Choose the template for one, or that for another number; both may have the field `count`, and those of values."""
    return Message(one if count == 1 else several, {"count": count, **values})


def plural_warning(count: int, one: str, several: str, **values: Any) -> Message:
    """Make a Message as `plural` does, about something that the user should check or do."""
    return Message(one if count == 1 else several, {"count": count, **values}, is_warning=True)


def probability(value: float) -> Message:
    """An estimated probability as a percentage, never rounded to 0% or 100%, because no estimate is that reliable."""
    if value > 0.99:
        return message("over 99%")
    return message("under 1%") if value < 0.01 else message("{share:.0%}", share=value)


def as_message(text: str) -> Message:
    """Text as a Message: unchanged if it is one, else without values, for translation as a whole."""
    return text if isinstance(text, Message) else Message(text.replace("{", "{{").replace("}", "}}"), {})


def sentences(*parts: str) -> Message:
    """Join sentences, each of which is translated."""
    return enumeration(map(as_message, parts), " ")


def enumeration(items: Iterable[str], separator: str = ", ") -> Message:
    """Join items; Messages among them are translated, names are not."""
    values = {f"item{number}": item for number, item in enumerate(items)}
    return Message(separator.join(f"{{{name}}}" for name in values), values)


def to_json(value: Any) -> Any:
    """Convert a value for `json.dumps`; Messages keep their parts, also in lists, tuples and dictionaries."""
    if isinstance(value, Message):
        return {MESSAGE: [value.template, to_json(value.values), *([True] if value.is_warning else [])]}
    if isinstance(value, dict):
        if any(isinstance(key, Message) for key in value):
            return {ITEMS: [[to_json(key), to_json(each)] for key, each in value.items()]}
        return {key: to_json(each) for key, each in value.items()}
    return [to_json(each) for each in value] if isinstance(value, list | tuple) else value


def from_json(stored: Any) -> Any:
    """The inverse of `to_json`, with lists for tuples; strings of earlier versions stay unchanged.

    Raises:
        ValueError, TypeError, KeyError: a Message is damaged.
    """
    if isinstance(stored, list):
        return [from_json(each) for each in stored]
    if not isinstance(stored, dict):
        return stored
    if stored.keys() == {MESSAGE}:
        return _check(*from_json(stored[MESSAGE]))
    if stored.keys() == {ITEMS}:
        return dict(from_json(stored[ITEMS]))
    return {key: from_json(each) for key, each in stored.items()}


def _check(template: object, values: object, is_warning: object = False) -> Message:
    """Check a stored Message, which may be damaged or malicious."""
    if not isinstance(template, str) or not isinstance(values, dict) or not isinstance(is_warning, bool):
        raise ValueError("This is no message.")
    for _, field, form, conversion in Formatter().parse(template):
        known = field is None or (field in values and not conversion)
        if not known or len(form or "") > MAX_FORMAT_LENGTH or "{" in (form or ""):
            raise ValueError("This is the template of no message.")
    return Message(template, values, is_warning)


def _storable(value: Any) -> Any:
    """Convert to a value that JSON can store: a number, which templates may format, or text."""
    if isinstance(value, str | int | float):
        return value
    if isinstance(value, Integral):
        return int(value)
    return float(value) if isinstance(value, Real) else str(value)
