# SPDX-License-Identifier: GPL-3.0-or-later
"""Interrupts that are never lost."""

from __future__ import annotations

import _thread
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer
from types import FrameType

# The exit code after an interrupt by the user: 128 and the signal's number, as in shells.
INTERRUPTED = 130
# Seconds after which an interrupt is tried again.
SOON = 0.01
# Exit codes of commands that ended normally all the same, or reported the interrupt themselves.
ENDINGS = (None, 0, INTERRUPTED)


@contextmanager
def handle_interrupts() -> Iterator[None]:
    """A context of the main thread that an interrupt ends as a KeyboardInterrupt, whatever becomes of it within.

    Within a callback of a weak reference or a finalizer Python prints an exception, and goes on as if nothing was:
    there it is raised again. Compiled modules that are being imported make an ImportError of it, and whoever catches
    that one may end with an exit code of failure: what fails after an interrupt is a KeyboardInterrupt.
    """
    arrived = False

    def handler(signal_number: int, frame: FrameType | None, /) -> None:
        nonlocal arrived
        arrived = True
        signal.default_int_handler(signal_number, frame)

    def hook(unraisable: sys.UnraisableHookArgs, /) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            Timer(SOON, _thread.interrupt_main).start()  # at once it would be raised, and lost, in here
        else:
            unraisable_before(unraisable)

    unraisable_before, sys.unraisablehook = sys.unraisablehook, hook
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # nobody else's, nor deaf, as in background
    if ours:
        signal.signal(signal.SIGINT, handler)
    try:
        yield
    except BaseException as error:
        said = isinstance(error, KeyboardInterrupt) or (isinstance(error, SystemExit) and error.code in ENDINGS)
        if arrived and not said:
            raise KeyboardInterrupt from error
        raise
    finally:
        sys.unraisablehook = unraisable_before
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
