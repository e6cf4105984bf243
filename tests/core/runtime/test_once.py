# SPDX-License-Identifier: GPL-3.0-or-later
"""Values that are computed once for an object, also by several threads."""

from __future__ import annotations

import functools
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

import zoomout_core
from zoomout_core.runtime.once import cached_property, once_per_argument
from zoomout_core.runtime.threads import side_by_side

# Timeout in seconds of a test that waits for another thread.
LONG = 10


class Shape:
    """An object with a value, which two threads compute at the same time."""

    def __init__(self, meeting: threading.Barrier) -> None:
        self.meeting, self.computed = meeting, 0

    @cached_property
    def value(self) -> object:
        """A new object."""
        self.computed += 1
        self.meeting.wait(timeout=LONG)  # breaks unless the other thread computes its value meanwhile
        return object()


@once_per_argument
def value_of(shape: Shape) -> object:
    shape.computed += 1
    shape.meeting.wait(timeout=LONG)
    return object()


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    zoomout_core.set_threads(2)
    yield
    zoomout_core.set_threads(None)


def test_values_of_two_objects_are_computed_at_the_same_time() -> None:
    meeting = threading.Barrier(2)
    one, other = Shape(meeting), Shape(meeting)
    first, second = side_by_side(lambda: one.value, lambda: other.value)
    assert first is one.value
    assert second is other.value
    assert one.computed == other.computed == 1


@pytest.mark.parametrize("get", [lambda shape: shape.value, value_of], ids=["property", "function"])
def test_threads_that_compute_a_value_at_the_same_time_get_the_same_one(get) -> None:  # type: ignore[no-untyped-def]
    shape = Shape(threading.Barrier(2))
    first, second = side_by_side(lambda: get(shape), lambda: get(shape))
    assert shape.computed == 2
    assert first is second is get(shape)


def test_cached_property_is_one_to_documentation_tools() -> None:
    assert isinstance(Shape.value, functools.cached_property)
    assert Shape.value.__doc__ == "A new object."


def test_no_module_uses_the_property_with_a_lock() -> None:
    core = Path(zoomout_core.__file__).parent
    uses = [
        path
        for path in core.rglob("*.py")
        if "functools import" in (text := path.read_text("utf-8"))
        and any("cached_property" in line for line in text.splitlines() if line.startswith("from functools import"))
    ]
    assert uses == []


def test_each_further_argument_has_its_own_value() -> None:
    computed: list[tuple[int, bool]] = []

    @once_per_argument
    def value(_: Shape, count: int, whole: bool = False) -> list[int]:
        computed.append((count, whole))
        return [count]

    one, other = (Shape(threading.Barrier(1)) for _ in range(2))
    assert value(one, 4) is value(one, 4) == [4]
    assert value(one, 5) == [5]
    assert value(one, 4, whole=True) is not value(one, 4)
    assert value(other, 4) is not value(one, 4)
    assert computed == [(4, False), (5, False), (4, True), (4, False)]
