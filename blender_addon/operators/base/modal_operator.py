# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators whose work is a coroutine: with a window it runs in slices and ESC cancels it, otherwise it runs at once.

They run in Object Mode, and restore the previous mode at the end, even after an error.
"""

from __future__ import annotations

import time
from typing import Any

import bpy
from bpy.types import Context, Event, Operator

import zoomout_core as zo
from zoomout_core.messages import Message, as_message, message
from zoomout_core.runtime.progress import Progress

from ... import services
from ...jobs import Job, run
from ...scene.redraw import redraw_sidebars
from ...translations import reported, translated
from ...viewport import preview
from . import activity, modes, prepare_ahead, running_operators
from .availability import is_available

# Seconds of work between two events; the piece of work then running may take up to 0.1 seconds more.
SLICE = 0.05
# Seconds between two redraws of the progress, which slow the work down, especially without a GPU.
REDRAWN = 0.2
# Events that pass through to the view, so that it can be rotated and zoomed during the work.
LOOKING = frozenset({"MOUSEMOVE", "MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TRACKPADPAN", "TRACKPADZOOM"})

# Time of the last redraw of the progress.
_drawn = 0.0


class ModalOperator(Operator):
    """The base of operators that take long."""

    async def work(self, context: Context) -> str:
        """Do the work and return a sentence for the user; it writes only after its last `await`."""
        raise NotImplementedError

    @property
    def remedy(self) -> Message:
        """The way to use a match that is probably wrong, which is stored now."""
        return message("To use this match anyway, press {button}.", button=as_message(self.bl_label))

    def report_failed(self, outcome: services.targets.Outcome[Any]) -> None:
        """Warn about each target that was left out.

        Raises:
            MeshError: all targets were left out.
        """
        outcome.check()
        for name, reason in outcome.failed.items():
            self.report({"WARNING"}, reported(message("'{name}' was left out: {reason}", name=name, reason=reason)))

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active object can receive data."""
        return is_available(cls, activity.AT_WORK if activity.running else services.preflight.obstacle(context))

    @property
    def adds_undo_steps(self) -> bool:
        """Whether the work may push undo steps of its own: work done in another mode is one step."""
        return self._left is None

    def execute(self, context: Context) -> set[str]:
        """Run the work at once."""
        prepare_ahead.stop()
        self._left = modes.leave(context, self)
        result = {"CANCELLED"}
        try:
            result = self._finish(run(self.work(context)))
        except zo.MeshError as error:
            result = self._fail(error)
        finally:
            modes.restore_after(context, self._left, self, result)
        return result

    def invoke(self, context: Context, event: Event) -> set[str]:
        """Start to work in slices, or run at once without a window that can receive a modal operator."""
        if bpy.app.background or not running_operators.can_begin(context.window):
            return self.execute(context)
        prepare_ahead.stop()
        self._left = modes.leave(context, self)
        self._job = Job(_load_and_work(self, context))
        _show_progress(context, self._job.progress)
        self._timer = context.window_manager.event_timer_add(0.01, window=context.window)
        running_operators.begin(context, self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Context, event: Event) -> set[str]:
        """Work for a slice at each tick of the timer; ESC cancels."""
        if event.type == "ESC":
            self._end(context)
            self.report({"INFO"}, reported("Cancelled; nothing was changed"))
            return modes.restore_after(context, self._left, self, {"CANCELLED"})
        if event.type != "TIMER":
            return {"PASS_THROUGH" if event.type in LOOKING else "RUNNING_MODAL"}
        try:
            if not self._job.advance(SLICE):
                _show_progress(context, self._job.progress)
                return {"RUNNING_MODAL"}
            result = self._finish(self._job.result)
        except zo.MeshError as error:
            result = self._fail(error)
        except BaseException:
            self.cancel(context)
            raise
        self._end(context)
        return modes.restore_after(context, self._left, self, result)

    def cancel(self, context: Context) -> None:
        """Clean up. Blender calls this when a file is loaded, the window closes, or a preceding dialog is cancelled."""
        if hasattr(self, "_job"):
            self._end(context)
            modes.restore_later(context, self._left)

    def _end(self, context: Context) -> None:
        running_operators.end(self)
        self._job.cancel()
        preview.end_preliminary()
        context.window_manager.event_timer_remove(self._timer)
        _show_progress(context, None)

    def _finish(self, message: str) -> set[str]:
        self.report({"INFO"}, reported(message))
        return {"FINISHED"}

    def _fail(self, error: zo.MeshError) -> set[str]:
        self.report({"ERROR"}, reported(str(error)))
        return {"CANCELLED"}


async def _load_and_work(operator: ModalOperator, context: Context) -> str:
    await services.load()
    return await operator.work(context)


def _show_progress(context: Context, progress: Progress | None) -> None:
    """Show the progress in status bar and sidebars, at most every `REDRAWN` seconds; None when the work ends."""
    global _drawn
    goes_on = activity.running is not None and progress is not None
    activity.running = progress
    if goes_on and time.monotonic() < _drawn + REDRAWN:
        return
    _drawn = time.monotonic()
    text = None
    if progress is not None:
        text = translated(
            message("{stage}: {share:.0%} (ESC cancels)", stage=as_message(progress.stage), share=progress.fraction)
        )
    context.workspace.status_text_set(text)
    redraw_sidebars()
