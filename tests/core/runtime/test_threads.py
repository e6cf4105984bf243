# SPDX-License-Identifier: GPL-3.0-or-later
"""Concurrent computations: results, progress and errors, with BLAS limited to one thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from inspect import signature

import pytest
from creatures import creature
from mannequins import STEP, mannequin
from threadpoolctl import threadpool_info, threadpool_limits

import zoomout_core as zo
from zoomout_core.assets.given_levels import complete_levels
from zoomout_core.assets.lods import make_lods
from zoomout_core.assets.transfer_asset import transfer_asset
from zoomout_core.matching.components.hulls import HULLS
from zoomout_core.runtime.progress import advance, portion, stage
from zoomout_core.runtime.threads import (
    for_each,
    in_one_thread,
    on_one_blas_thread,
    one_blas_thread,
    side_by_side,
    take_over_blas,
    threads,
)
from zoomout_core.transfer import conform, transfer
from zoomout_core.transfer.dressing.body_keys import follow_keys
from zoomout_core.transfer.dressing.body_weights import follow_weights
from zoomout_core.transfer.dressing.dress import dress
from zoomout_core.transfer.rigging.rest_pose import find_pose
from zoomout_core.transfer.rigging.rig import move_rig
from zoomout_core.transfer.wrapping.wrap import wrap
from zoomout_core.tuning import retune

# Timeout in seconds of a test that waits for another thread.
LONG = 10


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    zo.set_threads(2)
    yield
    zo.set_threads(None)


def counting(steps: int, result: str, meeting: threading.Barrier | None = None) -> Callable[[], str]:
    """A computation of `steps` steps; a barrier synchronises each step with another computation."""

    def work() -> str:
        for step in range(steps):
            if meeting is not None:
                meeting.wait(timeout=LONG)  # breaks unless the other computation runs at the same time
            advance(step / steps)
        return result

    return work


def fractions_of(work: Callable[[], object]) -> list[float]:
    heard: list[zo.Progress] = []
    with zo.progress(heard.append):
        work()
    return [progress.fraction for progress in heard]


# --- results and progress -----------------------------------------------------------------------------------


def test_computations_run_concurrently_and_return_in_order() -> None:
    meeting = threading.Barrier(2)
    assert side_by_side(counting(3, "first", meeting), counting(3, "second", meeting)) == ("first", "second")


def test_in_one_thread_stays_in_the_calling_thread() -> None:
    here = threading.current_thread()
    with in_one_thread():
        assert threads() == 1
        assert side_by_side(threading.current_thread, threading.current_thread) == (here, here)
    assert threads() == 2


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_keep_the_order_of_the_items(count: int) -> None:
    zo.set_threads(count)

    def later_first(item: int) -> int:
        time.sleep(0.002 * (6 - item))
        return 10 * item

    assert for_each(later_first, range(6)) == [0, 10, 20, 30, 40, 50]
    assert for_each(later_first, []) == []


def test_two_items_are_processed_at_a_time() -> None:
    meeting = threading.Barrier(2)
    items = ["first", "second", "third", "fourth"]
    assert for_each(lambda item: counting(3, item.upper(), meeting)(), items) == ["FIRST", "SECOND", "THIRD", "FOURTH"]


@pytest.mark.parametrize("count", [1, 2])
def test_progress_is_the_mean_of_all_computations(count: int) -> None:
    zo.set_threads(count)
    assert side_by_side(counting(1, "short"), counting(9, "long")) == ("short", "long")
    fractions = fractions_of(lambda: side_by_side(counting(1, "short"), counting(9, "long")))
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1
    assert len(set(fractions)) > 5
    alone = fractions_of(lambda: for_each(lambda _: None, range(4)))
    assert alone == pytest.approx([0.25, 0.5, 0.75, 1.0])


def test_stalled_computation_keeps_the_mean_below_half() -> None:
    heard: list[zo.Progress] = []
    ended = threading.Event()

    def waiting() -> None:
        assert ended.wait(timeout=LONG)

    def working() -> None:
        for tenth in range(10):
            advance(tenth / 10)
        ended.set()

    with zo.progress(lambda progress: None if ended.is_set() else heard.append(progress)):
        side_by_side(waiting, working)
    assert max(progress.fraction for progress in heard) == pytest.approx(0.45)


@pytest.mark.parametrize("count", [1, 2])
def test_threads_report_to_the_block_that_starts_them(count: int) -> None:
    zo.set_threads(count)
    heard: list[zo.Progress] = []

    def work(number: int) -> None:
        with stage(f"Item {number}", 0.5, 1.0):
            advance(0.5)

    with zo.progress(heard.append), portion(0.4, 0.6):
        for_each(work, range(3))
    assert {progress.stage for progress in heard} == {"Item 0", "Item 1", "Item 2"}
    assert 0.4 < heard[0].fraction < heard[-1].fraction == pytest.approx(0.6)


def test_one_thread_processes_items_in_place_and_in_order() -> None:
    zo.set_threads(1)
    order: list[tuple[int, threading.Thread]] = []
    for_each(lambda item: order.append((item, threading.current_thread())), range(3))
    assert order == [(item, threading.current_thread()) for item in range(3)]


# --- errors -------------------------------------------------------------------------------------------------


def failing() -> None:
    raise ValueError("no such thing")


class Endless:
    """A computation that, once it is allowed to, reports until it is cancelled."""

    def __init__(self) -> None:
        self.begun, self.may_report, self.stopped = threading.Event(), threading.Event(), threading.Event()

    def __call__(self) -> None:
        self.begun.set()
        try:
            assert self.may_report.wait(timeout=LONG)
            while True:
                advance(0.5)
        except zo.Cancelled:
            self.stopped.set()
            raise


@pytest.mark.parametrize("error_comes_first", [True, False])
def test_error_reaches_the_caller_at_once_and_stops_the_others(
    error_comes_first: bool,
) -> None:
    other = Endless()

    def failing_meanwhile() -> None:
        assert other.begun.wait(timeout=LONG)
        failing()

    began = time.monotonic()
    with pytest.raises(ValueError, match="no such thing"):
        side_by_side(*(failing_meanwhile, other)[:: 1 if error_comes_first else -1])
    assert time.monotonic() - began < LONG / 2
    assert not other.stopped.is_set()
    other.may_report.set()
    assert other.stopped.wait(timeout=LONG)


@pytest.mark.parametrize(("count", "max_count"), [(1, 1), (2, 3)])
def test_no_items_start_after_an_error(count: int, max_count: int) -> None:
    begun: list[int] = []
    raised = threading.Event()

    def work(item: int) -> None:
        begun.append(item)
        if item == 0:
            failing()
        raised.wait(timeout=LONG)  # the thread of the first item may take one more before its error is noticed

    zo.set_threads(count)
    with pytest.raises(ValueError, match="no such thing"):
        for_each(work, range(6))
    raised.set()
    time.sleep(0.02)
    assert 1 <= len(begun) <= max_count


@pytest.mark.parametrize("count", [1, 2])
def test_computations_are_cancelled_by_a_listener(count: int) -> None:
    zo.set_threads(count)
    works = Endless(), Endless()
    for work in works:
        work.may_report.set()

    def cancel(_: zo.Progress) -> None:
        raise zo.Cancelled

    with pytest.raises(zo.Cancelled), zo.progress(cancel):
        side_by_side(*works)
    for work in works[:count]:
        assert not work.begun.is_set() or work.stopped.wait(timeout=LONG)
    # Later computations run normally.
    assert side_by_side(counting(3, "first"), counting(3, "second")) == ("first", "second")


def test_an_error_within_nested_computations_stops_them_all() -> None:
    zo.set_threads(3)
    others = Endless(), Endless()

    def failing_meanwhile() -> None:
        for other in others:
            assert other.begun.wait(timeout=LONG)
            other.may_report.set()
        failing()

    with pytest.raises(ValueError, match="no such thing"):
        side_by_side(lambda: side_by_side(failing_meanwhile, others[0]), others[1])
    assert all(other.stopped.wait(timeout=LONG) for other in others)


# --- BLAS ---------------------------------------------------------------------------------------------------


def threads_of_blas() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture
def two_blas_threads() -> Iterator[None]:
    """Give BLAS two threads, whatever the environment sets.

    Since threadpoolctl 3.8 only the thread that limited BLAS last may do so, and the limit of another is ignored. If
    BLAS kept two threads, all later tests of this process would take several times as long.
    """
    before = threads_of_blas()
    take_over_blas()
    limits = threadpool_limits(2, user_api="blas")
    assert threads_of_blas() == {2}
    yield
    take_over_blas()
    limits.restore_original_limits()
    assert threads_of_blas() == before


def test_thread_that_cannot_start_raises_memory_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", failing)
    with pytest.raises(MemoryError, match="new thread"):
        for_each(abs, [1, 2])


@pytest.mark.usefixtures("two_blas_threads")
def test_blas_has_one_thread_until_all_computations_have_ended() -> None:
    begun, may_end = ([threading.Event() for _ in range(2)] for _ in range(2))
    found: list[set[int]] = []

    @on_one_blas_thread
    def looking(number: int) -> None:
        begun[number].set()
        assert may_end[number].wait(timeout=LONG)
        found.append(threads_of_blas())

    at_work = [threading.Thread(target=looking, args=(number,)) for number in range(2)]
    for thread, event in zip(at_work, begun, strict=True):
        thread.start()
        assert event.wait(timeout=LONG)
    for thread, event in zip(at_work, may_end, strict=True):
        assert threads_of_blas() == {1}
        event.set()
        thread.join()
    assert found == [{1}, {1}]
    assert threads_of_blas() == {2}


@pytest.mark.usefixtures("two_blas_threads")
def test_blas_threads_are_restored_if_the_first_caller_leaves_first() -> None:
    begun, may_end = threading.Event(), threading.Event()

    @on_one_blas_thread
    def longer() -> None:
        begun.set()
        assert may_end.wait(timeout=LONG)

    other = threading.Thread(target=longer)

    @on_one_blas_thread
    def first() -> None:
        other.start()
        assert begun.wait(timeout=LONG)

    first()
    may_end.set()
    other.join()
    assert threads_of_blas() == {2}


@pytest.mark.usefixtures("two_blas_threads")
def test_blas_threads_are_restored_after_an_error() -> None:
    with pytest.raises(ValueError, match="no such thing"):
        on_one_blas_thread(failing)()
    assert threads_of_blas() == {2}


@pytest.mark.usefixtures("two_blas_threads")
def test_nested_computations_and_their_threads_have_one_blas_thread() -> None:
    found: list[set[int]] = []
    looking = on_one_blas_thread(lambda: found.append(threads_of_blas()))
    on_one_blas_thread(lambda: (side_by_side(looking, looking), looking()))()
    assert found == [{1}] * 3
    assert threads_of_blas() == {2}


# --- the number of threads ----------------------------------------------------------------------------------


def max_at_work(count: int) -> int:
    """Greatest number of nested computations that ran at the same time."""
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
    for_each(lambda _: for_each(work, range(6)), range(6))
    return most


@pytest.mark.parametrize("count", [1, 2, 5])
def test_nested_computations_use_the_set_number_of_threads(count: int) -> None:
    assert max_at_work(count) == count


def test_environment_sets_the_default_number_of_threads(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
def test_invalid_numbers_of_threads_are_refused(count: object) -> None:
    with pytest.raises(ValueError, match="whole number of 1 or more"):
        zo.set_threads(count)  # type: ignore[arg-type]


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(("pair", "counts"), [("skins", (1, 5)), ("shells", (1, 8))])
def test_maps_do_not_depend_on_the_number_of_threads(pair: str, counts: tuple[int, ...]) -> None:
    if pair == "skins":
        source, target = creature(400, 0, 0.0).surface, creature(350, 1, 0.9).surface
    else:
        source, target = mannequin(None, 40, 1).surface, mannequin(STEP, 35, 2).surface
    found = []
    for count in counts:
        zo.set_threads(count)
        zo.forget_shapes()
        with retune(HULLS, resolution=48):
            found.append(zo.match(source, target, k_final=30, samples=200))
    first, *others = found
    for other in others:
        assert (other.surface_map.triangle == first.surface_map.triangle).all()
        assert (other.surface_map.barycentric == first.surface_map.barycentric).all()
        assert other.certainty == first.certainty


class _EnteredError(Exception):
    """BLAS is about to be kept to one thread."""


@pytest.mark.parametrize(
    "function",
    [
        complete_levels,
        conform,
        dress,
        find_pose,
        follow_keys,
        follow_weights,
        make_lods,
        move_rig,
        transfer,
        transfer_asset,
        wrap,
    ],
    ids=lambda function: function.__name__,
)
def test_transfers_keep_blas_to_one_thread(function: Callable[..., object], monkeypatch: pytest.MonkeyPatch) -> None:
    def enter(_: object) -> None:
        raise _EnteredError

    monkeypatch.setattr(type(one_blas_thread), "__enter__", enter)
    needed = [each for each in signature(function).parameters.values() if each.default is each.empty]
    with pytest.raises(_EnteredError):
        function(*(None for each in needed if each.kind is not each.VAR_KEYWORD))
