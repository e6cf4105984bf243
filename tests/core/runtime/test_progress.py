# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress of nested computations; listeners receive it and can cancel the computation."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from creatures import creature
from reports import fractions_of, reports_of

import zoomout_core as zo
from zoomout_core.runtime.progress import advance, listening, portion, renaming, show_outlines, stage


def round_progress(progress: zo.Progress) -> tuple[float, str]:
    return round(progress.fraction, 9), progress.stage


def test_portions_map_progress_into_the_enclosing_portion() -> None:
    def work() -> None:
        advance(0.1)
        with portion(0.2, 0.6):
            advance(0.5)
            with portion(0.5, 1.0):
                advance(0.0)
                advance(0.5)
            advance(1.0)
        advance(0.8)

    assert fractions_of(work) == pytest.approx([0.1, 0.4, 0.4, 0.5, 0.6, 0.8])


def test_innermost_title_wins_and_untitled_reports_inherit_it() -> None:
    def work() -> None:
        advance(0.0)
        with stage("Outer", 0.1, 0.9):
            advance(0.25)
            with stage("Inner", 0.5, 0.75):
                advance(1.0)
                with portion(0.0, 1.0):
                    advance(1.0)
            advance(0.75)
        advance(0.95)

    _, reports = reports_of(work)
    assert [round_progress(one) for one in reports] == [
        (0.0, ""),
        (0.1, "Outer"),
        (0.3, "Outer"),
        (0.5, "Inner"),
        (0.7, "Inner"),
        (0.7, "Inner"),
        (0.7, "Outer"),
        (0.95, "Outer"),
    ]


def test_stages_report_when_they_begin_but_portions_do_not() -> None:
    heard: list[zo.Progress] = []
    with zo.progress(heard.append):
        with portion(0.1, 0.2):
            pass
        assert heard == []
        with stage("Thinking", 0.3, 0.4):
            assert heard == [zo.Progress(0.3, "Thinking")]


def test_renaming_changes_titles_but_not_empty_ones() -> None:
    heard: list[zo.Progress] = []
    with zo.progress(heard.append), renaming(str.upper):
        advance(0.1)
        with stage("Thinking", 0.2, 0.4):
            advance(0.5)
    assert [round_progress(one) for one in heard] == [(0.1, ""), (0.2, "THINKING"), (0.3, "THINKING")]


def test_reported_fractions_never_fall_or_exceed_one() -> None:
    heard: list[zo.Progress] = []
    with zo.progress(heard.append):
        for fraction in (0.2, 0.1, 0.5, 1.2, 0.9):
            advance(fraction)
    assert [one.fraction for one in heard] == [0.2, 0.2, 0.5, 1.0, 1.0]


def test_each_listener_receives_progress_of_its_own_block() -> None:
    outer: list[zo.Progress] = []
    inner: list[zo.Progress] = []
    with zo.progress(outer.append):
        with stage("First", 0.0, 0.5), zo.progress(inner.append):
            advance(0.5)
        with stage("Second", 0.5, 1.0), listening(None):
            advance(1.0)
    assert [round_progress(one) for one in inner] == [(0.5, "")]
    assert [round_progress(one) for one in outer] == [(0.0, "First"), (0.25, "First"), (0.5, "Second"), (1.0, "Second")]


def test_outlines_reach_all_listeners_and_stay_until_replaced() -> None:
    outer: list[zo.Progress] = []
    inner: list[zo.Progress] = []
    first, second = ((np.arange(2), np.arange(2)),), ((np.arange(3), np.arange(3)),)
    with zo.progress(outer.append), zo.progress(inner.append), stage("Comparing", 0.5, 1.0):
        show_outlines(lambda: first)
        advance(0.5)
        show_outlines(lambda: second)
    for heard in (outer, inner):
        assert [one.outlines for one in heard] == [(), first, first, second]
        assert [round_progress(one) for one in heard[1:]] == [
            (0.5, "Comparing"),
            (0.75, "Comparing"),
            (0.75, "Comparing"),
        ]


def test_outlines_are_computed_only_for_listeners() -> None:
    computed: list[int] = []
    show_outlines(lambda: (computed.append(1), ())[1])
    assert not computed
    with zo.progress(lambda _: None):
        show_outlines(lambda: (computed.append(1), ())[1])
    assert computed == [1]


def test_listener_can_cancel_when_outlines_arrive() -> None:
    def stop(latest: zo.Progress) -> None:
        if latest.outlines:
            raise zo.Cancelled

    with pytest.raises(zo.Cancelled), zo.progress(stop):
        show_outlines(lambda: ((np.arange(2), np.arange(2)),))


def test_blocks_end_on_errors_and_work_without_a_listener() -> None:
    heard: list[zo.Progress] = []
    with pytest.raises(ValueError, match="no such thing"), zo.progress(heard.append), stage("Thinking", 0.5, 1.0):
        raise ValueError("no such thing")
    with stage("Unheard"):
        advance(0.5)
    assert heard == [zo.Progress(0.5, "Thinking")]


def test_other_threads_do_not_report() -> None:
    heard: list[zo.Progress] = []
    with zo.progress(heard.append):
        other = threading.Thread(target=advance, args=(0.5,))
        other.start()
        other.join()
    assert heard == []


def test_cancelling_is_not_caught_as_an_exception() -> None:
    def work() -> str:
        try:
            advance(0.5)
        except Exception:
            return "caught"
        return "done"

    def cancel(_: zo.Progress) -> None:
        raise zo.Cancelled

    with pytest.raises(zo.Cancelled), zo.progress(cancel):
        work()


@pytest.mark.parametrize("error", [zo.Cancelled, KeyError])
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("at", ["Reading the meshes", "Analyzing the shapes", "Guessing", "Refining"])
def test_errors_of_a_listener_end_the_match_and_reach_the_caller(
    error: type[BaseException], threads: int, at: str
) -> None:
    source, target = creature(220).surface, creature(200, seed=1).surface
    heard: list[zo.Progress] = []

    def listen(progress: zo.Progress) -> None:
        heard.append(progress)
        if progress.stage == at:
            raise error

    zo.set_threads(threads)
    zo.forget_shapes()
    try:
        with pytest.raises(error):
            zo.match(source, target, initial="proximity", k_final=20, samples=60, progress=listen)
    finally:
        zo.set_threads(None)
    assert at in {one.stage for one in heard}
    assert "Extending to all vertices" not in {one.stage for one in heard}
