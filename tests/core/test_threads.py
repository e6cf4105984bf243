"""Two stepped computations at once, and BLAS on one thread meanwhile."""

from __future__ import annotations

import threading
from collections.abc import Generator

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from zoomout_core.progress import drain
from zoomout_core.threads import on_one_blas_thread, side_by_side


def counting(steps: int, result: str, meeting: threading.Barrier | None = None) -> Generator[float, None, str]:
    for step in range(steps):
        if meeting is not None:
            meeting.wait(timeout=10)  # breaks unless the other one is at work meanwhile
        yield step / steps
    return result


def test_both_run_at_the_same_time_and_return_in_their_order() -> None:
    meeting = threading.Barrier(2)
    assert drain(side_by_side(counting(3, "first", meeting), counting(3, "second", meeting))) == ("first", "second")


def test_the_longer_one_goes_on_alone() -> None:
    assert drain(side_by_side(counting(1, "short"), counting(9, "long"))) == ("short", "long")
    fractions = list(side_by_side(counting(1, "short"), counting(9, "long")))
    assert fractions == sorted(fractions)
    assert len(fractions) == 10


def test_an_error_in_one_of_them_reaches_the_caller() -> None:
    def failing() -> Generator[float, None, None]:
        yield 0.0
        raise ValueError("no such thing")

    with pytest.raises(ValueError, match="no such thing"):
        drain(side_by_side(counting(5, "well"), failing()))


def test_steps_that_are_left_halfway_can_be_closed() -> None:
    closed = []

    def careful() -> Generator[float, None, None]:
        try:
            while True:
                yield 0.5
        finally:
            closed.append(True)

    both = side_by_side(careful(), careful())
    next(both)
    both.close()
    assert len(closed) == 2


def threads_of_blas() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_blas_has_one_thread_within_a_step_and_the_callers_between() -> None:
    @on_one_blas_thread
    def looking() -> Generator[set[int], None, set[int]]:
        yield threads_of_blas()
        return threads_of_blas()

    with threadpool_limits(2, user_api="blas"):
        assert threads_of_blas() == {2}
        steps = looking()
        assert next(steps) == {1}
        assert threads_of_blas() == {2}
        with pytest.raises(StopIteration) as finished:
            next(steps)
        assert finished.value.value == {1}
        assert threads_of_blas() == {2}
