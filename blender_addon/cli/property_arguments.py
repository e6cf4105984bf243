# SPDX-License-Identifier: GPL-3.0-or-later
"""Arguments of the command line for options of the sidebar, from their property definitions."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from zoomout_core.matching.presets import DETAIL

# Pipelines have time for levels of detail that the sidebar does not offer.
MORE_CHOICES = {"detail": tuple(DETAIL)}


def as_in_sidebar(options: argparse.Namespace, *groups: type) -> Any:
    """The options of some groups, with the values that Blender's properties would have."""
    values = {}
    for group in groups:
        for name, option in group.__annotations__.items():
            values[name] = getattr(options, name)
            if _kind(option) == "Enum":
                values[name] = values[name].upper()
            elif option.keywords.get("subtype") == "ANGLE":
                values[name] = math.radians(values[name])
    return SimpleNamespace(**values)


def add_options(parser: argparse.ArgumentParser, group: type, names: Iterable[str] = ()) -> None:
    """Add all or some options of a group of properties."""
    for name in names or group.__annotations__:
        flag = "--" + name.removeprefix("use_").replace("_", "-")
        flag, keywords = _argument(flag, name, group.__annotations__[name])
        parser.add_argument(flag, dest=name, **keywords)


def _argument(flag: str, name: str, option: Any) -> tuple[str, dict[str, Any]]:
    """The flag and the keywords by which argparse reads a Blender property."""
    definition, kind = option.keywords, _kind(option)
    default, explanation = definition.get("default"), definition["description"].replace("%", "%%")
    if kind == "Bool" and default:
        about = {"action": "store_false", "default": default, "help": f"turn off: {explanation}"}
        return flag.replace("--", "--no-", 1), about
    if kind == "Bool":
        return flag, {"action": "store_true", "default": default, "help": explanation}
    if kind == "Enum":
        choices = MORE_CHOICES.get(name) or tuple(identifier.lower() for identifier, *_ in definition["items"])
        return flag, {"choices": choices, "type": str.lower, "default": default.lower(), "help": explanation}
    if kind == "String":
        return flag, {"metavar": "TEXT", "default": "", "help": explanation}
    is_angle = definition.get("subtype") == "ANGLE"
    number = float if kind == "Float" else int
    convert = math.degrees if is_angle else number
    low, high = (None if definition.get(end) is None else convert(definition[end]) for end in ("min", "max"))
    return flag, {
        "type": number_type(int if kind == "Int" else float, low, high),
        "metavar": "N",
        "default": round(convert(default), 6),
        "help": f"{explanation}, in degrees" if is_angle else explanation,
    }


def path_name(text: str) -> str:
    """A path, which is not empty: pathlib would read an unset variable of a shell as the working folder."""
    if not text:
        raise argparse.ArgumentTypeError("it is empty: give a path")
    return text


def path(text: str) -> Path:
    """The same as a Path."""
    return Path(path_name(text))


def number_type(kind: type, minimum: float | None, maximum: float | None) -> Callable[[str], float]:
    """A parser of numbers in a range."""

    def read(text: str) -> float:
        number: float = kind(text)
        if not math.isfinite(number):
            raise argparse.ArgumentTypeError(f"{text} is not a finite number")
        if minimum is not None and number < minimum:
            raise argparse.ArgumentTypeError(f"{text} is less than {minimum:g}")
        if maximum is not None and number > maximum:
            raise argparse.ArgumentTypeError(f"{text} is more than {maximum:g}")
        return number

    read.__name__ = kind.__name__  # argparse uses it in the error where a text is not a number
    return read


def _kind(option: Any) -> str:
    """The type of an option's Blender property, such as "Enum"."""
    name: str = option.function.__name__
    return name.removesuffix("Property")
