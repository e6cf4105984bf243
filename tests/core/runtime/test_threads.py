"""Stepped computations at once, and BLAS on one thread meanwhile."""

from __future__ import annotations

import threading
import time
from collections.abc import Generator, Iterator

import pytest
from creatures import creature
from mannequins import STEP, mannequin
from threadpoolctl import threadpool_info, threadpool_limits

import zoomout_core as zo
from zoomout_core.matching.components.skins import SKINS
from zoomout_core.runtime.stepping import drain
from zoomout_core.runtime.threads import (
    for_each,
    for_each_stepped,
    in_background,
    on_one_blas_thread,
    side_by_side,
    threads,
)
from zoomout_core.tuning import retuned


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    zo.set_threads(2)
    yield
    zo.set_threads(None)


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
    assert fractions[-1] == 1


def test_an_error_in_one_of_them_reaches_the_caller() -> None:
    def failing() -> Generator[float, None, None]:
        yield 0.0
        raise ValueError("no such thing")

    with pytest.raises(ValueError, match="no such thing"):
        drain(side_by_side(counting(5, "well"), failing()))


def test_a_long_step_does_not_keep_the_caller_waiting() -> None:
    go_on = threading.Event()
    steps = in_background(lambda: go_on.wait(timeout=10))
    assert [next(steps) for _ in range(3)] == [0, 0, 0]
    go_on.set()
    assert drain(steps) is True


def test_an_error_in_the_background_reaches_the_caller() -> None:
    with pytest.raises(ZeroDivisionError):
        drain(in_background(lambda: 1 // 0))


def test_steps_that_are_left_halfway_are_not_waited_for_and_closed_when_they_end() -> None:
    closed, go_on = [], threading.Event()

    def careful(wait: bool) -> Generator[float, None, None]:
        try:
            while True:
                yield 0.5
                if wait:
                    go_on.wait(timeout=10)
        finally:
            closed.append(True)

    both = side_by_side(careful(True), careful(False))
    next(both)
    next(both)
    both.close()
    go_on.set()
    end = time.monotonic() + 10
    while len(closed) < 2 and time.monotonic() < end:
        time.sleep(0.001)
    assert len(closed) == 2


def threads_of_blas() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@on_one_blas_thread
def looking() -> Generator[set[int], None, set[int]]:
    yield threads_of_blas()
    return threads_of_blas()


def test_blas_has_one_thread_until_all_computations_have_ended() -> None:
    with threadpool_limits(2, user_api="blas"):
        first, second = looking(), looking()
        assert next(first) == {1}
        assert next(second) == {1}
        assert drain(first) == {1}
        assert threads_of_blas() == {1}
        second.close()
        assert threads_of_blas() == {2}


def test_stepped_computations_for_each_item_run_two_at_a_time() -> None:
    meeting = threading.Barrier(2)
    items = ["first", "second", "third", "fourth"]
    assert drain(for_each_stepped(lambda item: counting(3, item.upper(), meeting), items)) == [
        "FIRST",
        "SECOND",
        "THIRD",
        "FOURTH",
    ]
    fractions = list(for_each_stepped(lambda item: counting(3, item), items[:3]))
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1


def most_at_work(count: int) -> int:
    """How many of many nested computations were at work at a time."""
    lock, at_work, most = threading.Lock(), 0, 0

    def work(_: int) -> None:
        nonlocal at_work, most
        with lock:
            at_work += 1
            most = max(most, at_work)
        time.sleep(0.01)
        with lock:
            at_work -= 1

    zo.set_threads(count)
    drain(for_each(lambda _: drain(for_each(work, range(6))), range(6)))
    return most


@pytest.mark.parametrize("count", [1, 2, 5])
def test_so_many_threads_are_at_work_at_a_time_however_computations_are_nested(count: int) -> None:
    assert most_at_work(count) == count


def test_the_environment_sets_the_number_of_threads_where_the_caller_does_not(monkeypatch) -> None:
    monkeypatch.setenv("ZOOMOUT_THREADS", "3")
    zo.set_threads(None)
    assert threads() == 3
    zo.set_threads(5)
    assert threads() == 5
    monkeypatch.setenv("ZOOMOUT_THREADS", "many")
    zo.set_threads(None)
    with pytest.raises(ValueError, match="ZOOMOUT_THREADS is 'many': give a whole number"):
        threads()
    monkeypatch.delenv("ZOOMOUT_THREADS")
    assert 1 <= threads() <= 8


@pytest.mark.parametrize("count", [0, -1, 2.5, True, "2"])
def test_numbers_of_threads_that_make_no_sense_are_refused(count: object) -> None:
    with pytest.raises(ValueError, match="whole number of 1 or more"):
        zo.set_threads(count)  # type: ignore[arg-type]


@pytest.mark.parametrize(("pair", "counts"), [("skins", (1, 2, 5, 8)), ("shells", (1, 8))])
def test_maps_do_not_depend_on_the_number_of_threads(pair: str, counts: tuple[int, ...]) -> None:
    if pair == "skins":
        source, target = creature(400, 0, 0.0).surface, creature(350, 1, 0.9).surface
    else:
        source, target = mannequin(None, 40, 1).surface, mannequin(STEP, 35, 2).surface
    found = []
    for count in counts:
        zo.set_threads(count)
        zo.forget_shapes()
        with retuned(SKINS, resolution=48):
            found.append(zo.match(source, target, k_final=30, samples=200))
    first, *others = found
    for other in others:
        assert (other.surface_map.triangle == first.surface_map.triangle).all()
        assert (other.surface_map.barycentric == first.surface_map.barycentric).all()
        assert other.certainty == first.certainty
