# SPDX-License-Identifier: GPL-3.0-or-later
"""Tuned numbers: each is defined once, in the frozen dataclass of its stage, as in `components/shells.py`.

A number that no benchmark has set is a commented constant of its module: a judgement, a block size, a rounding
tolerance or the size of a cache.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import field, fields
from importlib import import_module
from pkgutil import walk_packages
from typing import Any, ClassVar


class Tuning:
    """Base of a stage's numbers, which names the benchmark that set them and checks their ranges.

    A subclass is a frozen dataclass whose fields are `tuned`, with one instance in its module.

    Args of a subclass:
        set_by: the command of `python -m benchmarks` whose table set the numbers.
    """

    set_by: ClassVar[str]

    def __init_subclass__(cls, *, set_by: str, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.set_by = set_by

    def __post_init__(self) -> None:
        for each in fields(self):  # type: ignore[arg-type]
            low, high = each.metadata["valid"]
            if not all(low <= number <= high for number in _numbers(getattr(self, each.name))):
                raise ValueError(
                    f"{type(self).__name__}.{each.name} is {getattr(self, each.name)!r}: give {low} to {high} "
                    f"({each.metadata['unit']})."
                )


def tuned(value: Any, unit: str, low: float, high: float) -> Any:
    """A field of a stage's numbers; a comment beside it, or the class's docstring, describes it.

    Args:
        value: a number, or numbers in tuples.
        unit: unit of the number: "at unit area" for lengths relative to the square root of the area, "1" for none.
        low: the smallest sensible value.
        high: the largest sensible value.
    """
    return field(default=value, metadata={"unit": unit, "valid": (low, high)})


def stages() -> dict[str, Tuning]:
    """The stages of all subpackages, by the names of their modules and their own."""
    core = import_module("zoomout_core")
    modules = [each.name for each in walk_packages(core.__path__, f"{core.__name__}.") if each.name.count(".") > 1]
    return {
        f"{module}.{name}": value
        for module in modules
        for name, value in vars(import_module(module)).items()
        if isinstance(value, Tuning) and type(value).__module__ == module
    }


@contextmanager
def retune(stage: Tuning, **values: Any) -> Iterator[None]:
    """A context that changes some numbers of a stage, for ablations and tests, only in this process.

    Raises:
        ValueError: a number is out of its range.
    """
    before = {name: getattr(stage, name) for name in values}
    try:
        for name, value in values.items():
            object.__setattr__(stage, name, value)
        stage.__post_init__()
        yield
    finally:
        for name, value in before.items():
            object.__setattr__(stage, name, value)


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, Sequence):
        for each in value:
            yield from _numbers(each)
    else:
        yield value
