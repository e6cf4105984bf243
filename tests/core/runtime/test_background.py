# SPDX-License-Identifier: GPL-3.0-or-later
"""A background computation can be polled and cancelled without blocking its caller."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

import zoomout_core as zo
from zoomout_core.runtime.background import Background
from zoomout_core.runtime.progress import advance, stage
from zoomout_core.runtime.threads import side_by_side

# Timeout in seconds of a test that waits for a thread.
LONG = 10


class Work:
    """A computation of three steps; each waits for `go_on` and reports another tenth."""

    def __init__(self, ends_with: str | Exception = "done") -> None:
        self.may_go_on, self.reported, self.cancelled = (threading.Semaphore(0) for _ in range(3))
        self.ends_with = ends_with

    def __call__(self) -> str:
        try:
            with stage("Thinking"):
                for tenth in range(1, 4):
                    assert self.may_go_on.acquire(timeout=LONG)
                    advance(tenth / 10)
                    self.reported.release()
        except zo.Cancelled:
            self.cancelled.release()
            raise
        if isinstance(self.ends_with, Exception):
            raise self.ends_with
        return self.ends_with

    def go_on(self, times: int = 1) -> None:
        for _ in range(times):
            self.may_go_on.release()

    def has_reported(self) -> bool:
        return self.reported.acquire(timeout=LONG)


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    zo.set_threads(2)
    yield
    zo.set_threads(None)


def test_running_computation_can_be_polled() -> None:
    work = Work()
    running = Background(work)
    assert not running.wait(0)
    for tenth in range(1, 4):
        work.go_on()
        assert work.has_reported()
        assert running.progress == zo.Progress(tenth / 10, "Thinking")
    assert running.wait(LONG)
    assert running.result() == "done"
    assert running.result() == "done"


def test_progress_is_empty_before_the_first_report() -> None:
    go_on = threading.Event()
    running = Background(lambda: go_on.wait(timeout=LONG))
    assert running.progress == zo.Progress(0.0, "")
    go_on.set()
    assert running.result() is True


def test_caller_never_waits_even_to_cancel() -> None:
    work = Work()
    began = time.monotonic()
    running = Background(work)
    assert not running.wait(0)
    running.cancel()
    assert not running.wait(0.01)
    assert time.monotonic() - began < 1
    assert not work.cancelled.acquire(blocking=False)
    work.go_on()
    assert work.cancelled.acquire(timeout=LONG)
    with pytest.raises(zo.Cancelled):
        running.result()
    assert running.wait(0)


def test_cancelling_after_the_last_report_keeps_the_result() -> None:
    go_on = threading.Event()
    running = Background(lambda: go_on.wait(timeout=LONG))
    running.cancel()
    go_on.set()
    assert running.result() is True


def test_error_reaches_the_caller() -> None:
    work = Work(ValueError("no such thing"))
    running = Background(work)
    work.go_on(3)
    with pytest.raises(ValueError, match="no such thing"):
        running.result()
    assert running.wait(0)


def test_nested_computations_report_and_are_cancelled() -> None:
    works = Work("first"), Work("second")
    running = Background(lambda: side_by_side(*works))
    for work in works:
        work.go_on()
        assert work.has_reported()
    assert running.progress.fraction == pytest.approx(0.1)
    running.cancel()
    works[0].go_on()
    assert works[0].cancelled.acquire(timeout=LONG)
    with pytest.raises(zo.Cancelled):
        running.result()
    works[1].go_on()
    assert works[1].cancelled.acquire(timeout=LONG)


def test_listener_of_the_starting_block_receives_progress() -> None:
    heard: list[zo.Progress] = []
    work = Work()
    with zo.progress(heard.append), stage("Working", 0.5, 1.0):
        running = Background(work)
    work.go_on(3)
    assert running.result() == "done"
    assert [one.fraction for one in heard] == pytest.approx([0.5, 0.5, 0.55, 0.6, 0.65])
    assert [one.stage for one in heard] == ["Working"] + 4 * ["Thinking"]


def test_number_of_threads_limits_running_computations() -> None:
    zo.set_threads(1)
    first, second = Work("first"), Work("second")
    running = Background(first)
    first.go_on()
    assert first.has_reported()
    waiting = Background(second)
    second.go_on(3)
    assert not waiting.wait(0.05)
    assert waiting.progress == zo.Progress(0.0, "")
    first.go_on(2)
    assert (running.result(), waiting.result()) == ("first", "second")
