# SPDX-License-Identifier: GPL-3.0-or-later
"""Interrupts that are never lost."""

from __future__ import annotations

import _thread
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer
from types import FrameType, TracebackType

# The exit code after an interrupt by the user: 128 and the signal's number, as in shells.
INTERRUPTED = 130
# Seconds after which an interrupt is raised again.
SOON = 0.01
# Exit codes of commands that ended normally despite the interrupt, or reported it themselves.
ENDINGS = (None, 0, INTERRUPTED)


@contextmanager
def handle_interrupts() -> Iterator[None]:
    """A context of the main thread that always ends with a KeyboardInterrupt after an interrupt.

    Python only prints exceptions in callbacks of weak references and in finalizers: such an interrupt is raised again.
    Compiled modules that are being imported print it, which is suppressed, and turn it into an ImportError. Code that
    catches this may end with an exit code of failure: any failure after an interrupt becomes a KeyboardInterrupt.
    """
    arrived = False

    def handler(signal_number: int, frame: FrameType | None, /) -> None:
        nonlocal arrived
        arrived = True
        signal.default_int_handler(signal_number, frame)

    def hook(unraisable: sys.UnraisableHookArgs, /) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            Timer(SOON, _thread.interrupt_main).start()  # raised at once, it would be lost in here
        else:
            unraisable_before(unraisable)

    def print_others(kind: type[BaseException], error: BaseException, trace: TracebackType | None, /) -> None:
        if not issubclass(kind, KeyboardInterrupt):
            print_before(kind, error, trace)

    unraisable_before, sys.unraisablehook = sys.unraisablehook, hook
    print_before, sys.excepthook = sys.excepthook, print_others
    # Neither another handler nor ignored, as in background.
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, handler)
    try:
        yield
    except BaseException as error:
        is_reported = isinstance(error, KeyboardInterrupt) or (isinstance(error, SystemExit) and error.code in ENDINGS)
        if arrived and not is_reported:
            raise KeyboardInterrupt from error
        raise
    finally:
        sys.unraisablehook, sys.excepthook = unraisable_before, print_before
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
