# SPDX-License-Identifier: GPL-3.0-or-later
"""Coroutines of the main thread whose computations run in threads, without a window."""

import gc
import threading
from functools import partial
from time import monotonic

import pytest
from turns import finish, turns

import zoomout_core as zo
from blender_addon.jobs import WAIT, Job, compute, pause, run
from zoomout_core.runtime.progress import advance, stage


async def double(number):
    with stage("Doubling", 0, 0.5):
        doubled = await compute(lambda: 2 * number)
    with stage("Writing", 0.5, 1):
        await pause()
    return doubled


@pytest.fixture
def gate():
    """An event that a computation waits for, opened at the end so that no thread blocks the tests."""
    event = threading.Event()
    yield event
    event.set()


def opened(gate):
    assert gate.wait(60)


def reporting(gate, reached):
    """A computation that reports progress until it is cancelled."""
    try:
        while not gate.is_set():
            advance(0.5)
    finally:
        reached.append(threading.current_thread())
        gate.set()


def test_job_returns_the_result_of_its_coroutine():
    assert run(double(4)) == finish(Job(double(4))) == 8


def test_run_computes_in_this_thread_and_jobs_in_another():
    async def where():
        return await compute(threading.current_thread), threading.current_thread()

    here = threading.current_thread()
    assert run(where()) == (here, here)
    computing, writing = finish(Job(where()))
    assert (computing == here, writing == here) == (False, True)


def test_advance_runs_until_time_is_up_or_next_pause():
    reached = []

    async def count():
        for number in range(1_000_000):
            reached.append(number)
            await pause()

    job = Job(count())
    assert not job.advance(0)
    assert reached == [0]
    job.advance(0.02)
    assert 100 < len(reached) < 1_000_000
    job.cancel()


def test_advance_does_not_wait_long_for_a_computation(gate):
    job = Job(compute(partial(opened, gate)))
    begin = monotonic()
    assert not job.advance(60)
    assert not job.advance(60)
    assert monotonic() - begin < 2 * WAIT + 1
    gate.set()
    finish(job)


def test_job_and_listener_receive_the_same_progress():
    seen, told = [], []
    with zo.progress(told.append):
        for one in turns(Job(double(4))):
            seen.append(one)
        run(double(4))
    assert seen == [zo.Progress(0.0, "Doubling"), zo.Progress(0.5, "Writing")]
    assert [one.stage for one in told] == ["Doubling", "Writing"] * 2


def test_progress_begins_with_starting():
    async def quiet():
        await pause()
        advance(0.5)
        await pause()

    job = Job(quiet())
    assert [job.progress, *turns(job)] == [zo.Progress(fraction, "Starting") for fraction in (0, 0, 0.5)]


@pytest.mark.parametrize("through", [run, lambda coroutine: finish(Job(coroutine))])
def test_an_error_of_a_computation_is_raised_where_it_is_awaited(through):
    async def divide(caught):
        try:
            return await compute(lambda: 1 / 0)
        except ZeroDivisionError:
            if not caught:
                raise
            return "caught"

    assert through(divide(True)) == "caught"
    with pytest.raises(ZeroDivisionError):
        through(divide(False))


def test_cancelled_job_does_not_wait_for_its_computation(gate):
    closed, reached = [], []

    async def work():
        try:
            with stage("Working"):
                await compute(partial(reporting, gate, reached))
        finally:
            closed.append(threading.current_thread())

    job = Job(work())
    job.advance(0)
    assert (closed, reached) == ([], [])
    job.cancel()
    assert closed == [threading.current_thread()]
    opened(gate)
    assert reached != closed
    assert job.progress.stage == "Working"
    job.cancel()  # once is enough


def test_a_job_can_be_cancelled_before_it_begins_and_after_it_has_ended(recwarn):
    job = Job(double(1))
    job.cancel()
    job = Job(double(1))
    finish(job)
    job.cancel()
    del job
    assert [one for one in recwarn if one.category is RuntimeWarning] == []


def test_a_job_that_is_dropped_is_cancelled_without_an_error(monkeypatch):
    closed, errors = [], []

    async def work():
        try:
            with stage("Working"):
                await pause()
        finally:
            closed.append(True)

    monkeypatch.setattr("sys.unraisablehook", errors.append)
    job = Job(work())
    job.advance(0)
    del job
    gc.collect()
    assert closed == [True]
    assert errors == []
