# SPDX-License-Identifier: GPL-3.0-or-later
"""The types of filter parameters: checks of values from Python, and parsing of values from a script."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np

from zoomout_core.arrays import Floats


@dataclass(frozen=True)
class Type:
    """One type of parameter.

    Attributes:
        label: its name in `print_filter_parameter_list`, which is pymeshlab's.
        rich: its names in `.mlx` scripts.
        wanted: a description of valid values for the user.
        accepts: tests whether a value from Python has this type.
        read: parses a script's text; raises ValueError if that is not possible.
    """

    label: str
    rich: tuple[str, ...]
    wanted: str
    accepts: Callable[[Any], bool]
    read: Callable[[str], Any]


def _is_whole(value: Any) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _is_count(value: Any) -> bool:
    return _is_whole(value) and value >= 0


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _is_length(value: Any) -> bool:
    from pymeshlab import PercentageValue, PureValue

    return isinstance(value, PercentageValue | PureValue)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _are_names(value: Any) -> bool:
    return value is None or _is_text(value) or (isinstance(value, list | tuple) and all(map(_is_text, value)))


def _is_data(value: Any) -> bool:
    return value is None or not isinstance(value, bool | Real)


def _truth(text: str) -> bool:
    if text not in ("true", "false"):
        raise ValueError(text)
    return text == "true"


def _finite(text: str) -> float:
    if not math.isfinite(float(text)):
        raise ValueError(text)
    return float(text)


def _length(text: str) -> Any:
    """Parse a length: absolute, as in scripts saved by MeshLab, or such as "2%" of the bounding box's diagonal."""
    from pymeshlab import PercentageValue, PureValue

    return PercentageValue(_finite(text[:-1])) if text.endswith("%") else PureValue(_finite(text))


def absolute_length(length: Any, vertices: Floats) -> float:
    """Convert a PercentageValue of the bounding box's diagonal, or a PureValue, to the unit of vertices (n, 3)."""
    from pymeshlab import PercentageValue

    value = float(length.value())
    if isinstance(length, PercentageValue):
        value *= diagonal(vertices) / 100
    return value


def diagonal(vertices: Floats) -> float:
    """The length of the diagonal of the bounding box of vertices (n, 3)."""
    return float(np.linalg.norm(np.nanmax(vertices, axis=0) - np.nanmin(vertices, axis=0)))


MESH = Type("int", ("RichMesh",), "the id of a mesh", _is_whole, int)
WHOLE = Type("int", ("RichInt",), "a whole number", _is_whole, int)
COUNT = Type("int", ("RichInt",), "a whole number that is not negative", _is_count, int)
NUMBER = Type("float", ("RichFloat", "RichDynamicFloat"), "a number", _is_number, _finite)
SWITCH = Type("bool", ("RichBool",), "true or false", lambda value: isinstance(value, bool), _truth)
TEXT = Type("str", ("RichString",), "a text", _is_text, str)
NAMES = Type("str or list of str", ("RichString",), "a list of names, or a text separated by commas", _are_names, str)
CHOICE = Type("str", ("RichEnum", "RichString"), "one of its choices", _is_text, str)
LENGTH = Type(
    "PercentageValue", ("RichAbsPerc", "RichPercentage"), "a PercentageValue or a PureValue", _is_length, _length
)
# An array in Python, the name of a file with it in scripts.
DATA = Type(
    "array or file name", ("RichFileOpen", "RichOpenFile", "RichString"), "arrays, or the name of a file", _is_data, str
)

# Further types of native filters, which pymeshlab parses.
OTHER_RICH = {
    "RichColor",
    "RichMatrix44f",
    "RichMatrix44",
    "RichPosition",
    "RichDirection",
    "RichPoint3f",
    "RichPoint3",
}
OTHER_RICH |= {"RichShotf", "RichShot", "RichFileSave", "RichSaveFile"}
TYPES = (MESH, WHOLE, COUNT, NUMBER, SWITCH, TEXT, NAMES, CHOICE, LENGTH, DATA)
# Types by their name in scripts; RichString is a TEXT, and RichEnum a number, unless one of our filters differs.
RICH_TYPES = {name: type_ for type_ in reversed(TYPES) for name in type_.rich}


@dataclass(frozen=True)
class Parameter:
    """A parameter of a filter.

    Attributes:
        name: its name in Python and in scripts.
        type: the type of its values.
        default: its default; a LENGTH's may be a percentage of the diagonal.
        meaning: its description for the user.
        choices: the values of a CHOICE, in the order of their indices in scripts.
    """

    name: str
    type: Type
    default: Any
    meaning: str
    choices: tuple[str, ...] = ()

    def check(self, value: Any) -> Any:
        """Check a value from Python.

        Raises:
            ValueError: it has another type, or is none of the choices.
        """
        if not self.type.accepts(value) or (self.choices and value not in self.choices):
            raise ValueError(f"'{self.name}' is {value!r}: give {self.wanted}.")
        return value

    def read(self, text: str) -> Any:
        """Parse a value from a script; a choice may be a name or an index.

        Raises:
            ValueError: the text is not such a value.
        """
        if self.choices and text.isdecimal() and int(text) < len(self.choices):
            return self.choices[int(text)]
        try:
            return self.check(self.type.read(text))
        except (ValueError, OverflowError):
            raise ValueError(f"'{self.name}' is {text!r}: give {self.wanted}.") from None

    @property
    def wanted(self) -> str:
        """A description of valid values."""
        return " or ".join(self.choices) if self.choices else self.type.wanted
