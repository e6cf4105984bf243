# SPDX-License-Identifier: GPL-3.0-or-later
"""An interrupt that arrives where Python cannot raise it."""

from __future__ import annotations

import signal
import sys
import time
import weakref
from collections.abc import Iterator

import pytest

from zoomout_core.runtime.interrupts import INTERRUPTED, handle_interrupts


class Thing:
    """An object that supports weak references."""


def interrupted(_: object) -> None:
    raise KeyboardInterrupt


def let_go_and_wait(things: list[Thing]) -> None:
    things.clear()
    for _ in range(1000):
        time.sleep(0.001)


def interrupted_and_ending_with(error: BaseException) -> None:
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        raise error from None


@pytest.fixture
def hearing() -> Iterator[None]:
    """Raise interrupts even if the tests run in the background, where the shell ignores them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("hearing")
def test_it_is_raised_as_soon_as_it_can_be() -> None:
    things = [Thing()]
    reference = weakref.ref(things[0], interrupted)
    before = sys.unraisablehook
    with pytest.raises(KeyboardInterrupt), handle_interrupts():
        let_go_and_wait(things)
    assert reference() is None
    assert sys.unraisablehook is before


@pytest.mark.usefixtures("hearing")
@pytest.mark.parametrize("made_of_it", [ImportError("initialization failed"), SystemExit(1)])
def test_it_stays_one_where_it_is_turned_into_a_failure(made_of_it: BaseException) -> None:
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), handle_interrupts():
        interrupted_and_ending_with(made_of_it)
    assert signal.getsignal(signal.SIGINT) is handler


@pytest.mark.usefixtures("hearing")
@pytest.mark.parametrize("code", [0, INTERRUPTED])
def test_what_is_done_all_the_same_or_was_said_stays_so(code: int) -> None:
    with pytest.raises(SystemExit) as ended, handle_interrupts():
        interrupted_and_ending_with(SystemExit(code))
    assert ended.value.code == code


@pytest.mark.usefixtures("hearing")
def test_failures_without_one_stay_as_they_are() -> None:
    with pytest.raises(ImportError), handle_interrupts():
        raise ImportError


def test_other_exceptions_are_told_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    told = []
    monkeypatch.setattr(sys, "unraisablehook", lambda unraisable: told.append(unraisable.exc_type))

    def failing(_: object) -> None:
        raise ValueError

    thing = Thing()
    reference = weakref.ref(thing, failing)
    with handle_interrupts():
        del thing
    assert reference() is None
    assert told == [ValueError]


def test_compiled_modules_do_not_print_it(monkeypatch: pytest.MonkeyPatch) -> None:
    told = []
    monkeypatch.setattr(sys, "excepthook", lambda kind, *_: told.append(kind))
    before = sys.excepthook
    with handle_interrupts():
        for error in (KeyboardInterrupt(), ValueError()):
            sys.excepthook(type(error), error, None)  # as PyErr_Print does, which numpy's import_array calls
    assert told == [ValueError]
    assert sys.excepthook is before
