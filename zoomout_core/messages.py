# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences for the user that can be translated, because they keep the template and the values that they consist of.

A template is English text with named fields, such as "'{name}' has only {count} vertices.". It is the key of a
translation, so it stands in the code as a literal in a call of `message` or `plural`. A word that takes another
article or ending in other languages is not a field, but one template each: in an f-string a `{role}` that is filled in
at once may be "source" or "target", and fields have doubled braces.
"""

from __future__ import annotations

from collections.abc import Iterable
from numbers import Integral, Real
from string import Formatter
from typing import Any

# Characters of a format specification in a stored template: a longer one could ask for gigabytes of spaces.
MAX_FORMAT_LENGTH = 4
# Keys of the JSON that stands for a Message, and for a dictionary whose keys are Messages.
MESSAGE, ITEMS = "zoomout_message", "zoomout_items"


class Message(str):
    """An English sentence, with what it was composed of.

    Attributes:
        template: text with named fields.
        values: of these fields. Messages among them are translated; other text, such as a name, is not.
    """

    template: str
    values: dict[str, Any]

    def __new__(cls, template: str, values: dict[str, Any]) -> Message:
        values = {name: _storable(value) for name, value in values.items()}
        made = super().__new__(cls, template.format(**values))
        made.template, made.values = template, values
        return made

    def __str__(self) -> str:
        """Itself, so that `str` of an exception is still a Message."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return Message, (self.template, self.values)


def message(template: str, **values: Any) -> Message:
    """A Message: "{name}" in its template stands for the value `name`, and may have a format as in "{share:.0%}"."""
    return Message(template, values)


def plural(count: int, one: str, several: str) -> Message:
    """The template for one, or that for another number, which may have the field `count`."""
    return Message(one if count == 1 else several, {"count": count})


def as_message(text: str) -> Message:
    """Text as a Message: as it is, or a sentence or noun without values, to be translated as a whole."""
    return text if isinstance(text, Message) else Message(text.replace("{", "{{").replace("}", "}}"), {})


def sentences(*parts: str) -> Message:
    """Sentences one after another, each of which is translated."""
    return enumeration(map(as_message, parts), " ")


def enumeration(items: Iterable[str], separator: str = ", ") -> Message:
    """Items one after another, of which Messages are translated, and names are not."""
    values = {f"item{number}": item for number, item in enumerate(items)}
    return Message(separator.join(f"{{{name}}}" for name in values), values)


def to_json(value: Any) -> Any:
    """A value for `json.dumps`; Messages, within lists, tuples and dictionaries as well, keep their parts."""
    if isinstance(value, Message):
        return {MESSAGE: [value.template, to_json(value.values)]}
    if isinstance(value, dict):
        if any(isinstance(key, Message) for key in value):
            return {ITEMS: [[to_json(key), to_json(each)] for key, each in value.items()]}
        return {key: to_json(each) for key, each in value.items()}
    return [to_json(each) for each in value] if isinstance(value, list | tuple) else value


def from_json(stored: Any) -> Any:
    """What `to_json` was given, with lists for tuples; strings of earlier versions stay as they are.

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


def _check(template: object, values: object) -> Message:
    """A stored Message, which may have been damaged, or made to do damage."""
    if not isinstance(template, str) or not isinstance(values, dict):
        raise ValueError("This is no message.")
    for _, field, form, conversion in Formatter().parse(template):
        known = field is None or (field in values and not conversion)
        if not known or len(form or "") > MAX_FORMAT_LENGTH or "{" in (form or ""):
            raise ValueError("This is the template of no message.")
    return Message(template, values)


def _storable(value: Any) -> Any:
    """A value that JSON can hold: numbers, which templates may format, and text."""
    if isinstance(value, str | int | float):
        return value
    if isinstance(value, Integral):
        return int(value)
    return float(value) if isinstance(value, Real) else str(value)
