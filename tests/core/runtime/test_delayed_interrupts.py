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


def raise_interrupt(_: object) -> None:
    raise KeyboardInterrupt


def release_and_wait(things: list[Thing]) -> None:
    things.clear()
    for _ in range(1000):
        time.sleep(0.001)


def raise_after_interrupt(error: BaseException) -> None:
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        raise error from None


@pytest.fixture
def interrupts_enabled() -> Iterator[None]:
    """Raise interrupts even if the tests run in the background, where the shell ignores them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts_enabled")
def test_interrupt_is_raised_as_soon_as_possible() -> None:
    things = [Thing()]
    reference = weakref.ref(things[0], raise_interrupt)
    before = sys.unraisablehook
    with pytest.raises(KeyboardInterrupt), handle_interrupts():
        release_and_wait(things)
    assert reference() is None
    assert sys.unraisablehook is before


@pytest.mark.usefixtures("interrupts_enabled")
@pytest.mark.parametrize("made_of_it", [ImportError("initialization failed"), SystemExit(1)])
def test_interrupt_turned_into_a_failure_stays_an_interrupt(made_of_it: BaseException) -> None:
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), handle_interrupts():
        raise_after_interrupt(made_of_it)
    assert signal.getsignal(signal.SIGINT) is handler


@pytest.mark.usefixtures("interrupts_enabled")
@pytest.mark.parametrize("code", [0, INTERRUPTED])
def test_success_and_reported_interrupts_keep_their_exit_status(code: int) -> None:
    with pytest.raises(SystemExit) as ended, handle_interrupts():
        raise_after_interrupt(SystemExit(code))
    assert ended.value.code == code


@pytest.mark.usefixtures("interrupts_enabled")
def test_failures_without_an_interrupt_are_unchanged() -> None:
    with pytest.raises(ImportError), handle_interrupts():
        raise ImportError


def test_other_unraisable_exceptions_are_still_reported(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_interrupts_in_compiled_modules_are_not_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    told = []
    monkeypatch.setattr(sys, "excepthook", lambda kind, *_: told.append(kind))
    before = sys.excepthook
    with handle_interrupts():
        for error in (KeyboardInterrupt(), ValueError()):
            sys.excepthook(type(error), error, None)  # as PyErr_Print does, which numpy's import_array calls
    assert told == [ValueError]
    assert sys.excepthook is before
