# SPDX-License-Identifier: GPL-3.0-or-later
"""The modal operator with simulated events, since the `bpy` module has no window."""

from contextlib import nullcontext
from types import SimpleNamespace

import bpy
import pytest

import zoomout_core as zo
from blender_addon import jobs, services
from blender_addon.operators.base import activity, running_operators
from blender_addon.operators.base.modal_operator import ModalOperator
from zoomout_core.runtime.progress import stage

TICK, ESCAPE, KEY, WHEEL = (SimpleNamespace(type=name) for name in ("TIMER", "ESC", "X", "WHEELUPMOUSE"))


class Window:
    """A replacement of the context: it counts timers, and records the text of the status bar."""

    def __init__(self):
        self.window_manager = self.workspace = self
        self.window = SimpleNamespace(modal_operators=[])
        self.timers, self.handlers, self.status, self.windows = [], 0, None, []
        self.active_object = None

    def event_timer_add(self, interval, window):
        self.timers.append(object())
        return self.timers[-1]

    def event_timer_remove(self, timer):
        self.timers.remove(timer)

    def modal_handler_add(self, operator):
        self.handlers += 1

    def status_text_set(self, text):
        self.status = text


class Work:
    """An operator with a number of pauses that writes at the end."""

    execute, invoke, modal, cancel, _end, _finish, _fail = (
        getattr(ModalOperator, name) for name in ("execute", "invoke", "modal", "cancel", "_end", "_finish", "_fail")
    )
    bl_label, bl_options = "Work", {"REGISTER", "UNDO"}

    def __init__(self, count=3, error=None):
        self.count, self.error, self.written, self.closed, self.reports = count, error, False, False, []

    async def work(self, context):
        try:
            for i in range(self.count):
                with stage("Working", i / self.count):
                    await jobs.pause()
            if self.error:
                raise self.error
            self.written = True
            return "Done"
        finally:
            self.closed = True

    def report(self, level, text):
        self.reports.append((*level, text))


@pytest.fixture
def window(monkeypatch):
    jobs.run(services.load())  # otherwise the first slice of work waits for it
    monkeypatch.setattr(
        "blender_addon.operators.base.modal_operator.bpy", SimpleNamespace(app=SimpleNamespace(background=False))
    )
    monkeypatch.setattr("blender_addon.operators.base.modal_operator.redraw_sidebars", lambda: None)
    monkeypatch.setattr("blender_addon.operators.base.modal_operator.SLICE", 0.0)  # one pause a tick
    monkeypatch.setattr("blender_addon.operators.base.modal_operator.REDRAWN", 0.0)
    monkeypatch.setattr(running_operators, "_running", [])
    yield Window()
    for work, _ in running_operators._running:
        work._job.cancel()


def run(work, window, events):
    results = [work.invoke(window, None)]
    results += [work.modal(window, event) for event in events]
    return results


def test_work_runs_in_slices_and_shows_progress(window):
    work = Work(count=3)
    assert run(work, window, [TICK, KEY, TICK]) == [{"RUNNING_MODAL"}] * 4
    assert window.status == "Working: 33% (ESC cancels)"
    assert (len(window.timers), window.handlers, work.written) == (1, 1, False)
    assert run_out(work, window) == {"FINISHED"}
    assert work.written
    assert work.reports == [("INFO", "Done")]
    assert (window.timers, window.status) == ([], None)


def test_progress_is_redrawn_occasionally_and_its_end_at_once(window, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        "blender_addon.operators.base.modal_operator.redraw_sidebars", lambda: drawn.append(activity.running)
    )
    monkeypatch.setattr("blender_addon.operators.base.modal_operator.REDRAWN", 1000.0)
    work = Work(count=5)
    run(work, window, [TICK] * 4)
    assert drawn == [zo.Progress(0.0, "Starting")]
    assert activity.running == zo.Progress(3 / 5, "Working")
    work.modal(window, ESCAPE)
    assert drawn[1:] == [None]


def test_view_stays_usable_and_sidebar_shows_progress(window):
    work = Work(count=3)
    assert run(work, window, [TICK, TICK, WHEEL])[-1] == {"PASS_THROUGH"}
    assert activity.running == zo.Progress(1 / 3, "Working")
    work.modal(window, ESCAPE)
    assert activity.running is None


def run_out(work, window):
    for _ in range(10):
        result = work.modal(window, TICK)
        if result != {"RUNNING_MODAL"}:
            return result
    raise AssertionError("the work does not end")


def test_escape_ends_the_work_before_anything_is_written(window):
    work = Work(count=3)
    assert run(work, window, [TICK, TICK, ESCAPE])[-1] == {"CANCELLED"}
    assert not work.written
    assert work.closed
    assert (window.timers, window.status) == ([], None)


def test_loading_a_file_ends_the_work(window):
    work = Work(count=3)
    run(work, window, [TICK])
    work.cancel(window)
    assert (work.written, work.closed, window.timers, window.status) == (False, True, [], None)


def test_cancelled_dialog_needs_no_cleanup(window):
    work = Work()
    work.cancel(window)
    assert (work.written, work.closed) == (False, False)


def test_disabling_the_extension_ends_the_work(window, monkeypatch):
    """Blender frees operators of an unregistered class without notice."""
    override = SimpleNamespace(temp_override=lambda window: nullcontext())
    monkeypatch.setattr("blender_addon.operators.base.running_operators.bpy", SimpleNamespace(context=override))
    work = Work(count=3)
    work.cancel = lambda context: ModalOperator.cancel(work, window)
    run(work, window, [TICK])
    running_operators.cancel_all()
    assert (work.written, work.closed, window.timers, window.status) == (False, True, [], None)
    assert activity.running is None
    running_operators.cancel_all()  # once is enough
    assert run(Work(), window, [TICK]) == [{"RUNNING_MODAL"}] * 2


def test_work_runs_at_once_if_no_window_accepts_operators(window, monkeypatch):
    """Adding another one would crash Blender: `modal_operators` then has a dangling entry."""
    kept = SimpleNamespace(as_pointer=lambda operator: operator)
    monkeypatch.setattr(
        "blender_addon.operators.base.running_operators.bpy", SimpleNamespace(types=SimpleNamespace(bpy_struct=kept))
    )
    window.window.modal_operators = [1234, 0]
    work = Work()
    assert work.invoke(window, None) == {"FINISHED"}
    assert (work.written, window.handlers, window.timers) == (True, 0, [])
    window.window = None
    assert Work().invoke(window, None) == {"FINISHED"}
    window.window = SimpleNamespace(modal_operators=[1234])
    assert run(Work(count=0), window, [TICK]) == [{"RUNNING_MODAL"}, {"FINISHED"}]


def test_an_error_is_one_report_and_leaves_no_timer(window):
    work = Work(count=1, error=zo.MeshError("The mesh is broken: mend it."))
    run(work, window, [])
    assert run_out(work, window) == {"CANCELLED"}
    assert work.reports == [("ERROR", "The mesh is broken: mend it.")]
    assert (window.timers, window.status) == ([], None)


def test_a_fault_in_the_program_leaves_no_timer_either(window):
    work = Work(count=1, error=ZeroDivisionError())
    run(work, window, [TICK])
    with pytest.raises(ZeroDivisionError):
        work.modal(window, TICK)
    assert (window.timers, window.status) == ([], None)


def test_without_a_window_the_work_runs_straight_through():
    assert bpy.app.background
    work, window = Work(), Window()
    assert work.invoke(window, None) == {"FINISHED"}
    assert (work.written, window.timers, window.handlers) == (True, [], 0)
